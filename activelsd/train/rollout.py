"""What goes from acting to learning: L steps of B episodes as tensors."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import Output


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """L x B steps.

    `output` holds the acting pass with its graph where the weights have not changed since:
    on-policy, the acting forward is the learning forward, and running it twice would be waste.
    """

    observation: dict[str, Tensor]  # each (L, B, ...)
    first: Tensor  # (L, B) bool, an episode's first view
    mask: Tensor  # (L, B, n) bool, the legal actions
    labels: Tensor  # (L, B) int64, the right class
    state: Tensor  # (B, width) memory before the first step
    actions: Tensor  # (L, B) int64
    epsilon: Epsilon  # that the actions were drawn with
    rewards: Tensor  # (L, B) float32
    terminated: Tensor  # (L, B) bool
    truncated: Tensor  # (L, B) bool
    right: Tensor  # (L, B) bool, the action named the right class
    views: Tensor  # (L, B) int64, views seen when the action was taken
    bootstrap: Tensor  # (B,) float32, value of the state after the last step
    # (L, B) float32, log-probability each action was drawn with; None where the weights are the same still
    behaviour: Tensor | None = None
    nearer: Tensor | None = None  # (L, B, n) bool, moves on the shortest way to a good look; None: not asked
    output: Output | None = None  # of the acting pass, (L, B, ...), with its graph
