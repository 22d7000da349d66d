"""A lane's trajectory, written step by step as its questions are answered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from activelsd.train.actors.ga3c.slots import Layout
from activelsd.train.actors.trajectory import Trajectory

_ASKED = ("first", "label", "views")
"""What a slot holds of the step it asks about, beside what the network sees."""

_GIVEN = ("reward", "terminated", "truncated")
"""What it holds of the step before."""


class TrajectoryWriter:
    """Writes the trajectories of a lane; whichever predictor answers calls it once per answer."""

    def __init__(self, layout: Layout, length: int, dropped: int = 0) -> None:
        """Trajectories of a length, with the factors of so many features if any are left out."""
        one = {name: (shape[1:], dtype) for name, (shape, dtype) in layout.fields().items()}
        one["behaviour"], one["version"] = one["reward"], one["action"]
        if dropped:
            one["dropout"] = (layout.envs, dropped), np.dtype("float32")
        self._fields, self._length = one, length
        self._begin()

    def _begin(self) -> None:
        # New arrays each time: those that are full are the learner's.
        self._steps = {
            name: np.empty((self._length, *shape), dtype) for name, (shape, dtype) in self._fields.items()
        }
        self._done = 0
        self._state: Tensor | None = None

    def drop(self) -> int:
        """Forget the unfinished trajectory; how many environment steps it held."""
        lost = max(self._done - 1, 0) * int(self._steps["reward"].shape[1])  # the last was not taken
        self._begin()
        return lost

    def add(
        self,
        slot: Mapping[str, NDArray[Any]],
        state: Tensor,
        seen: Mapping[str, NDArray[Any]],
        *,
        value: NDArray[np.float32],
        version: int,
    ) -> Trajectory | None:
        """Take a step's question and answer, and with it what the step before led to.

        Args:
            slot: the agent's arrays (R, ...).
            state: (R, width) the memory that the question was answered with.
            seen: (R, ...) what the network saw and chose: the observation's parts, `mask`, `action`, its
                log-probability `behaviour`, and `dropout` if there is any.
            value: (R,) of what is seen.
            version: of the weights, in updates.

        Returns:
            The trajectory that ended before this step, if one did.
        """
        full = None
        if self._done:
            for name in _GIVEN:
                self._steps[name][self._done - 1] = slot[name]
        if self._done == self._length:
            assert self._state is not None
            full = Trajectory(steps=self._steps, state=self._state, bootstrap=value)
            self._begin()
        if not self._done:
            self._state = state
        for name in _ASKED:
            self._steps[name][self._done] = slot[name]
        for name, array in seen.items():
            self._steps[name][self._done] = array
        self._steps["version"][self._done] = version
        self._done += 1
        return full
