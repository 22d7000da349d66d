"""The A3C loss (paper equations 1 to 3) as functions of tensors, with an entropy bonus per level."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.policy.heads import ActionDistribution


class Weights(NamedTuple):
    """Weights of the value loss and of the entropy bonuses; the policy loss has weight 1."""

    value: float
    entropy_branch: float | Tensor
    entropy_leaf: float | Tensor


class Losses(NamedTuple):
    """A3C's losses, each a scalar averaged over the rollout, and the weighted sum with all other terms."""

    total: Tensor
    policy: Tensor
    value: Tensor
    entropy_branch: Tensor
    entropy_leaf: Tensor


def n_step_returns(rewards: Tensor, ended: Tensor, bootstrap: Tensor, gamma: float) -> Tensor:
    """R_t = r_t + gamma R_{t+1}; R is 0 after an episode's end and `bootstrap` after the last step.

    Args:
        rewards: (L, B).
        ended: (L, B) bool.
        bootstrap: (B,).
        gamma: discount per step.
    """
    returns, after = torch.empty_like(rewards), bootstrap
    for t in range(len(rewards) - 1, -1, -1):
        after = rewards[t] + gamma * after.masked_fill(ended[t], 0.0)
        returns[t] = after
    return returns


def a3c_losses(
    distribution: ActionDistribution,
    value: Tensor,
    actions: Tensor,
    returns: Tensor,
    weights: Weights,
    advantages: Tensor | None = None,
) -> Losses:
    """Losses over L x B steps.

    The sign of equation 2 is turned, so that every loss is minimised: -log pi(a) (R - V), with (R - V) held
    constant; equation 3: half the squared error of the value. Entropies are bonuses. `advantages` (L, B)
    replace (R - V) if they are corrected for another policy's actions.
    """
    if advantages is None:
        advantages = returns - value.detach()
    policy = -(distribution.log_prob(actions) * advantages).mean()
    value_loss = 0.5 * (returns - value).square().mean()
    entropy = distribution.entropy()
    branch, leaf = entropy.branch.mean(), entropy.leaf.mean()
    total = (
        policy + weights.value * value_loss - weights.entropy_branch * branch - weights.entropy_leaf * leaf
    )
    return Losses(total, policy, value_loss, branch, leaf)
