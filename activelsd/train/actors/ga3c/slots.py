"""Memory that agents and predictors share, with a slot for the newest step of every environment.

The memory has no name, so it is freed when the last process that maps it is gone, however that ended. Agent
and predictor never use a slot at the same time: after its request, an agent leaves it alone until the answer.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

_ALIGNED = 64  # bytes of a cache line, so that no two arrays share one

STEP = {
    "first": "bool",  # the observation is an episode's first view
    "label": "int64",  # the right class of the episode
    "views": "int64",  # views seen in the episode
    "reward": "float32",  # of the last action, as are the next three
    "terminated": "bool",
    "truncated": "bool",
    "cut": "bool",  # the episode was ended because the world failed
    "action": "int64",  # the answer: the action to take
}
"""Scalars of an environment's newest step, with their types."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Numbers and shapes of the slots, in plain values that JSON holds."""

    agents: int
    lanes: int  # of each agent, which steps one while it waits for the others' answers
    envs: int  # of each lane
    actions: int
    observation: Mapping[str, tuple[tuple[int, ...], str]]  # shape and dtype of each part

    @classmethod
    def of(cls, space: gymnasium.spaces.Dict, *, agents: int, lanes: int, envs: int, actions: int) -> Layout:
        """The layout for the observations of a space."""
        parts = {name: (box.shape or (), str(box.dtype)) for name, box in space.items()}
        return cls(agents=agents, lanes=lanes, envs=envs, actions=actions, observation=parts)

    @property
    def rows(self) -> int:
        """Number of lanes of all agents; the lanes of an agent are consecutive rows."""
        return self.agents * self.lanes

    def row(self, agent: int, lane: int) -> int:
        """The row of an agent's lane."""
        return agent * self.lanes + lane

    def fields(self) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Shape and dtype of every array, each (rows, envs, ...)."""
        one = {name: ((), dtype) for name, dtype in STEP.items()}
        parts = {**self.observation, "mask": ((self.actions,), "bool"), **one}
        return {
            name: ((self.rows, self.envs, *shape), np.dtype(dtype)) for name, (shape, dtype) in parts.items()
        }


class Slots:
    """Arrays (rows, envs, ...) by the names of `Layout.fields`, in memory that processes share.

    Attributes:
        layout: numbers and shapes.
        file: descriptor of the memory, for another process to map.
        arrays: by name.
    """

    def __init__(self, layout: Layout, file: int | None = None) -> None:
        """Map the memory of another process, or allocate one."""
        self.layout = layout
        fields = layout.fields()
        sizes = [prod(shape) * dtype.itemsize for shape, dtype in fields.values()]
        starts = np.cumsum([0] + [-(-size // _ALIGNED) * _ALIGNED for size in sizes]).tolist()
        self.file = _nameless(starts[-1]) if file is None else file
        memory = mmap.mmap(self.file, starts[-1])
        self.arrays: dict[str, NDArray[Any]] = {
            name: np.frombuffer(memory, dtype, prod(shape), start).reshape(shape)
            for (name, (shape, dtype)), start in zip(fields.items(), starts, strict=False)
        }

    def close(self) -> None:
        """Release the memory."""
        self.arrays.clear()
        os.close(self.file)


def _nameless(size: int) -> int:
    if hasattr(os, "memfd_create"):
        # It is not limited by the size of /dev/shm, which is 64 MB in containers.
        file = os.memfd_create("activelsd")
    else:
        with tempfile.TemporaryFile() as temporary:
            file = os.dup(temporary.fileno())
    os.ftruncate(file, size)
    return file
