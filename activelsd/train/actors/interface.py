"""The interface between the trainer and the actors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.rollout import Rollout


class Actors(Protocol):
    """Plays with the network as it is, and hands over rollouts.

    Attributes:
        places: the columns of a rollout that each world has, by name; empty for a single world.
    """

    @property
    def places(self) -> Mapping[str, slice]:
        """See above."""

    def collect(self, epsilon: Epsilon) -> Rollout:
        """The next rollout, played with about this much random exploration.

        Policy lag is counted in calls: each means that the last rollout was learned from.
        """

    def measures(self) -> dict[str, float]:
        """Metrics of the time since the last call, by name."""

    def state(self) -> dict[str, Tensor]:
        """The state from which playing continues, for a checkpoint."""

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""

    def close(self) -> None:
        """End whatever was started; the actors cannot be used again."""


MakeActors = Callable[[LSDNet, int], Actors]
"""Makes actors that play with a network, from a seed."""
