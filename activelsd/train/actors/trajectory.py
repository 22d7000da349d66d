"""What an agent played, long enough to learn from, and many of that as a rollout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.train.rollout import Rollout


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """L steps of the R environments of an agent."""

    steps: dict[str, NDArray[Any]]  # each (L, R, ...): what was seen, done and came of it, by name
    state: Tensor  # (R, width) memory before the first step
    bootstrap: NDArray[np.float32]  # (R,) value of the state after the last step


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
        nearer=steps.get("nearer"),
    )
    return rollout, version
