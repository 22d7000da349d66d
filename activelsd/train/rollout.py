"""What actors hand to the learner: L steps of B episodes as tensors."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import Output
from activelsd.policy.memories import State


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """L x B steps.

    `output` holds the acting pass with its graph if the weights have not changed since: on-policy, the
    acting pass is the learning pass, and running it twice would be waste.
    """

    observation: dict[str, Tensor]  # each (L, B, ...)
    first: Tensor  # (L, B) bool, an episode's first view
    mask: Tensor  # (L, B, n) bool, the legal actions
    labels: Tensor  # (L, B) int64, the right class
    state: State  # of the memory before the first step, each (B, ...)
    actions: Tensor  # (L, B) int64
    epsilon: Epsilon  # with which the actions were drawn
    rewards: Tensor  # (L, B) float32
    terminated: Tensor  # (L, B) bool
    truncated: Tensor  # (L, B) bool
    right: Tensor  # (L, B) bool, the action named the right class
    views: Tensor  # (L, B) int64, views seen when the action was taken
    bootstrap: Tensor  # (B,) float32, value of the state after the last step
    # (L, B) float32, log-probability with which each action was drawn; None if weights have not changed since
    behaviour: Tensor | None = None
    nearer: Tensor | None = None  # (L, B, n) bool, moves on the shortest way to a good look; None: unknown
    output: Output | None = None  # of the acting pass, (L, B, ...), with its graph

    def columns(self, place: slice) -> Rollout:
        """The rollout of some of its episodes; views of the same tensors."""
        own: dict[str, Any] = {}
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if name == "bootstrap":
                own[name] = value[place]
            elif name == "observation":
                own[name] = {part: one[:, place] for part, one in value.items()}
            elif name == "state":
                own[name] = {part: one[place] for part, one in value.items()}
            elif name == "output" and value is not None:
                parts = (value.logits[:, place], value.value[:, place], value.features[:, place])
                own[name] = Output(*parts, {part: one[place] for part, one in value.state.items()})
            elif name != "epsilon" and value is not None:
                own[name] = value[:, place]
        return replace(self, **own)
