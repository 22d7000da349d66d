"""Where agents and predictors meet: shared memory with a place for the newest step of every environment.

The memory has no name, so nothing of it stays when the last process that maps it is gone, however it ended.
Agent and predictor never touch a place at once: what an agent has asked about rests until it is answered.
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
    "first": "bool",  # what is seen is an episode's first view
    "label": "int64",  # the right class of the episode in sight
    "views": "int64",  # views seen of it
    "reward": "float32",  # of the last action, as are the three that follow
    "terminated": "bool",
    "truncated": "bool",
    "cut": "bool",  # the episode ended because the world failed
    "action": "int64",  # the answer: what to do now
}
"""Scalars of an environment's newest step, and their types."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How much room there is, in plain values that JSON holds."""

    agents: int
    lanes: int  # of each agent; it steps one while the others' answers are awaited
    envs: int  # of each lane
    actions: int
    observation: Mapping[str, tuple[tuple[int, ...], str]]  # shape and dtype of each part

    @classmethod
    def of(cls, space: gymnasium.spaces.Dict, *, agents: int, lanes: int, envs: int, actions: int) -> Layout:
        """Room for the observations of a space."""
        parts = {name: (box.shape or (), str(box.dtype)) for name, box in space.items()}
        return cls(agents=agents, lanes=lanes, envs=envs, actions=actions, observation=parts)

    @property
    def rows(self) -> int:
        """Lanes of all agents; an agent's stand together."""
        return self.agents * self.lanes

    def row(self, agent: int, lane: int) -> int:
        """Where an agent's lane stands."""
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
        layout: what there is room for.
        file: descriptor of the memory, for a process that is to map it too.
        arrays: by name.
    """

    def __init__(self, layout: Layout, file: int | None = None) -> None:
        """Map a memory made elsewhere, or make one."""
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
        """Let go of the memory."""
        self.arrays.clear()
        os.close(self.file)


def _nameless(size: int) -> int:
    if hasattr(os, "memfd_create"):
        # Not bounded by the size of /dev/shm either, of which containers have 64 MB.
        file = os.memfd_create("activelsd")
    else:
        with tempfile.TemporaryFile() as temporary:
            file = os.dup(temporary.fileno())
    os.ftruncate(file, size)
    return file
