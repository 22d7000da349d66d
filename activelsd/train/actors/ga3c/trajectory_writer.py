"""Writes a lane's trajectory step by step, as its requests are answered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.policy.memories import State
from activelsd.train.actors.ga3c.slots import Layout
from activelsd.train.actors.trajectory import Trajectory

_REQUEST = ("first", "label", "views")
"""Fields of a slot about the step that needs an action, beside the observation."""

_OUTCOME = ("reward", "terminated", "truncated")
"""Fields of a slot about the step before."""


class TrajectoryWriter:
    """Writes the trajectories of a lane; whichever predictor answers calls it once per answer."""

    def __init__(self, layout: Layout, length: int, dropped: int = 0) -> None:
        """Write trajectories of `length` steps; `dropped` is the number of dropout's factors, if any."""
        one = {name: (shape[1:], dtype) for name, (shape, dtype) in layout.fields().items()}
        one["behaviour"], one["version"] = one["reward"], one["action"]
        if "features" in one:  # the network has seen one of the variants (R, K, W, F)
            shape, dtype = one["features"]
            one["features"] = (*shape[:2], shape[3]), dtype
        if dropped:
            one["dropout"] = (layout.envs, dropped), np.dtype("float32")
        self._fields, self._length = one, length
        self._begin()

    def _begin(self) -> None:
        # New arrays each time: full ones belong to the learner.
        self._steps = {
            name: np.empty((self._length, *shape), dtype) for name, (shape, dtype) in self._fields.items()
        }
        self._done = 0
        self._state: State | None = None

    def drop(self) -> int:
        """Drop the unfinished trajectory; returns how many environment steps it held."""
        lost = max(self._done - 1, 0) * int(self._steps["reward"].shape[1])  # the last action was not taken
        self._begin()
        return lost

    def add(
        self,
        slot: Mapping[str, NDArray[Any]],
        state: State,
        seen: Mapping[str, NDArray[Any]],
        *,
        value: NDArray[np.float32],
        version: int,
    ) -> Trajectory | None:
        """Add a step's request and answer, and with it the outcome of the step before.

        Args:
            slot: the agent's arrays (R, ...).
            state: of the memory before the answer, each (R, ...).
            seen: (R, ...) what the network saw and chose: the observation, `mask`, `action`, its
                log-probability `behaviour`, and `dropout` if there is any.
            value: (R,) of the observation.
            version: of the weights, in updates.

        Returns:
            The trajectory that ended before this step, if one did.
        """
        full = None
        if self._done:
            for name in _OUTCOME:
                self._steps[name][self._done - 1] = slot[name]
        if self._done == self._length:
            assert self._state is not None
            full = Trajectory(steps=self._steps, state=self._state, bootstrap=value)
            self._begin()
        if not self._done:
            self._state = state
        for name in _REQUEST:
            self._steps[name][self._done] = slot[name]
        for name, array in seen.items():
            self._steps[name][self._done] = array
        self._steps["version"][self._done] = version
        self._done += 1
        return full
