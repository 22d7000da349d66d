"""The A3C loss (paper equations 1 to 3) as functions of tensors, with an entropy bonus per level."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from activelsd.policy.heads import ActionDistribution


class Weights(NamedTuple):
    """What each term counts for."""

    value: float
    entropy_branch: float | Tensor
    entropy_leaf: float | Tensor
    supervised: float
    guided: float = 0.0


class Losses(NamedTuple):
    """The terms, each a scalar averaged over the rollout, and their weighted sum."""

    total: Tensor
    policy: Tensor
    value: Tensor
    entropy_branch: Tensor
    entropy_leaf: Tensor
    supervised: Tensor
    guided: Tensor


def n_step_returns(rewards: Tensor, ended: Tensor, bootstrap: Tensor, gamma: float) -> Tensor:
    """R_t = r_t + gamma R_{t+1}, where R of an ended episode is 0 and after the last step is `bootstrap`.

    Args:
        rewards: (L, B).
        ended: (L, B) bool.
        bootstrap: (B,).
        gamma: discount per step.
    """
    returns = torch.empty_like(rewards)
    following = bootstrap
    for t in range(len(rewards) - 1, -1, -1):
        following = rewards[t] + gamma * following.masked_fill(ended[t], 0.0)
        returns[t] = following
    return returns


def a3c_losses(
    distribution: ActionDistribution,
    value: Tensor,
    actions: Tensor,
    returns: Tensor,
    labels: Tensor,
    weights: Weights,
    advantages: Tensor | None = None,
    nearer: Tensor | None = None,
) -> Losses:
    """Losses over L x B steps.

    Equation 2's sign is turned, so that all terms are minimised: -log pi(a) (R - V), with (R - V) held fixed;
    equation 3: half the squared error of the value. Entropies are bonuses. The supervised term is the
    cross-entropy of the class branch with the label, which is at hand during training. `advantages` (L, B)
    take the place of (R - V) where they are corrected for another policy's actions. The guided term is that
    of the moves with any that is `nearer`, bool (L, B, moves), where one is legal.
    """
    if advantages is None:
        advantages = returns - value.detach()
    policy = -(distribution.log_prob(actions) * advantages).mean()
    value_loss = 0.5 * (returns - value).square().mean()
    entropy = distribution.entropy()
    branch, leaf = entropy.branch.mean(), entropy.leaf.mean()
    supervised = functional.nll_loss(distribution.class_log_probs().flatten(0, -2), labels.flatten())
    guided = (
        torch.zeros_like(supervised) if nearer is None else _guided(distribution.move_log_probs(), nearer)
    )
    total = (
        policy
        + weights.value * value_loss
        - weights.entropy_branch * branch
        - weights.entropy_leaf * leaf
        + weights.supervised * supervised
        + weights.guided * guided
    )
    return Losses(total, policy, value_loss, branch, leaf, supervised, guided)


def _guided(log_p: Tensor, nearer: Tensor) -> Tensor:
    """-log of the probability of any move that is nearer, 0 where none is; the mean over all steps."""
    right = nearer & ~log_p.isneginf()
    some = right.any(-1, keepdim=True)
    # The inner fill keeps the sum away from nothing: its gradient there would be NaN though it is not used.
    likely = log_p.masked_fill(~right, -torch.inf).masked_fill(~some, 0.0).logsumexp(-1)
    return -torch.where(some.squeeze(-1), likely, 0.0).mean()
