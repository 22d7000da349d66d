"""What was played, step by step, until it is long enough to learn from; and many of that as a rollout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.train.actors.ga3c.slots import Layout
from activelsd.train.rollout import Rollout

_ASKED = ("first", "label", "views")
"""What a slot holds of the step it asks about, beside what the network sees."""

_GIVEN = ("reward", "terminated", "truncated")
"""What it holds of the step before."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """L steps of the R environments of an agent."""

    steps: dict[str, NDArray[Any]]  # each (L, R, ...): a slot's arrays, `behaviour`, `version`, `dropout`
    state: Tensor  # (R, width) memory before the first step
    bootstrap: NDArray[np.float32]  # (R,) value of the state after the last step

    @property
    def envs(self) -> int:
        """R."""
        return len(self.bootstrap)


class Recorder:
    """Writes the trajectory of one agent; its predictor calls it once per answer."""

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


def batch(
    trajectories: Sequence[Trajectory],
    parts: Sequence[str],
    answers: slice,
    epsilon: Epsilon,
    device: torch.device,
) -> tuple[Rollout, NDArray[np.int64]]:
    """Trajectories side by side, and the versions (L, B) of the weights that they were played with.

    Args:
        trajectories: of one length.
        parts: names of the observation's parts.
        answers: the actions that name a class.
        epsilon: the exploration they were played with, near enough.
        device: where the rollout goes.
    """
    whole = {
        name: np.concatenate([trajectory.steps[name] for trajectory in trajectories], 1)
        for name in trajectories[0].steps
    }
    version = whole.pop("version")
    steps = {name: torch.from_numpy(array).to(device) for name, array in whole.items()}
    bootstrap = np.concatenate([trajectory.bootstrap for trajectory in trajectories])
    rollout = Rollout(
        observation={name: steps[name] for name in parts},
        first=steps["first"],
        mask=steps["mask"],
        labels=steps["label"],
        state=torch.cat([trajectory.state for trajectory in trajectories]),
        actions=steps["action"],
        epsilon=epsilon,
        rewards=steps["reward"],
        terminated=steps["terminated"],
        truncated=steps["truncated"],
        right=steps["action"] - answers.start == steps["label"],
        views=steps["views"],
        bootstrap=torch.from_numpy(bootstrap).to(device),
        behaviour=steps["behaviour"],
    )
    return rollout, version
