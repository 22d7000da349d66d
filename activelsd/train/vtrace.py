"""V-trace: returns corrected for actions that an older policy drew.

Espeholt et al. 2018, IMPALA, https://arxiv.org/abs/1802.01561, section 4.1.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class VTrace(NamedTuple):
    """Targets of the value and advantages of the policy."""

    vs: Tensor  # (L, B) v_s, the value targets
    advantages: Tensor  # (L, B) rho_s (r_s + gamma v_{s+1} - V(x_s))


@torch.no_grad()
def vtrace(
    log_ratios: Tensor,
    rewards: Tensor,
    ended: Tensor,
    values: Tensor,
    bootstrap: Tensor,
    gamma: float,
    *,
    rho_clip: float = 1.0,
    c_clip: float = 1.0,
) -> VTrace:
    """Equation 1 by its recursion (remark 1), and the policy gradient's advantage.

    If the policy is unchanged, every ratio is 1, v_s is the n-step return and the advantage is A3C's.

    Args:
        log_ratios: (L, B) log pi(a|x) - log mu(a|x), of the policy being trained and the one that acted.
        rewards: (L, B).
        ended: (L, B) bool; no value follows an ended episode.
        values: (L, B) V(x_s).
        bootstrap: (B,) value of the state after the last step.
        gamma: discount per step.
        rho_clip: rho-bar, the largest ratio in a temporal difference and in the policy gradient.
        c_clip: c-bar, the largest ratio in the correction passed on to the step before.
    """
    ratios = log_ratios.exp()
    rhos, cs = ratios.clamp(max=rho_clip), ratios.clamp(max=c_clip)
    discounts = gamma * (~ended).to(values.dtype)
    following = torch.cat([values[1:], bootstrap[None]])
    deltas = rhos * (rewards + discounts * following - values)

    corrections, passed_on = torch.empty_like(values), torch.zeros_like(bootstrap)
    for s in range(len(values) - 1, -1, -1):
        passed_on = deltas[s] + discounts[s] * cs[s] * passed_on
        corrections[s] = passed_on
    vs = values + corrections
    vs_following = torch.cat([vs[1:], bootstrap[None]])
    return VTrace(vs, rhos * (rewards + discounts * vs_following - values))
