"""Trajectories of agents, and rollouts made of many of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from activelsd.policy.heads import Epsilon
from activelsd.policy.memories import State
from activelsd.train.rollout import Rollout


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """L steps of the R environments of an agent."""

    steps: dict[str, NDArray[Any]]  # each (L, R, ...), by name: observations, actions and their outcome
    state: State  # of the memory before the first step, each (R, ...)
    bootstrap: NDArray[np.float32]  # (R,) value of the state after the last step


def batch(
    trajectories: Sequence[Trajectory],
    parts: Sequence[str],
    answers: slice,
    epsilon: Epsilon,
    device: torch.device,
) -> tuple[Rollout, NDArray[np.int64]]:
    """The rollout of trajectories side by side, and the versions (L, B) of the weights that played them.

    Args:
        trajectories: of one length.
        parts: names of the observation's parts.
        answers: the actions that name a class.
        epsilon: about the exploration with which they were played.
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
        state={
            name: torch.cat([trajectory.state[name] for trajectory in trajectories])
            for name in trajectories[0].state
        },
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
