"""What the trainer asks of whoever plays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.rollout import Rollout


class Actors(Protocol):
    """Play with the network as it is, and hand over what was played.

    Attributes:
        places: of several worlds, the columns of a rollout that each has; of one world, nothing.
    """

    @property
    def places(self) -> Mapping[str, slice]:
        """See above."""

    def collect(self, epsilon: Epsilon) -> Rollout:
        """The next rollout, played with about this much random exploration.

        A call says that the last rollout was learned from: policy lag is counted in calls.
        """

    def measures(self) -> dict[str, float]:
        """What is worth logging of the time since the last call, by name."""

    def state(self) -> dict[str, Tensor]:
        """What playing goes on from, for a checkpoint."""

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""

    def close(self) -> None:
        """End whatever was started; the actors play no more."""


MakeActors = Callable[[LSDNet, int], Actors]
"""Makes actors that play with a network, from a seed."""
