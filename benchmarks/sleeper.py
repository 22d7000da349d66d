"""A world whose steps only sleep, like those of a simulator that computes in another process."""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.viewgraph import ViewGraph

ID = "sleeper:activelsd-benchmarks/Sleeper-v0"
"""The Gymnasium id, prefixed with the module that registers it, this one."""

VIEWS, CLASSES, SIZE = 12, 16, 64


class Sleeper(ViewGraphEnv):
    """Rings of random views; every step takes at least `seconds`."""

    def __init__(self, *, seconds: float = 0.02) -> None:
        super().__init__(graph(), PRESETS["V4"], frames=1)
        self._seconds = seconds

    def step(self, action: np.int64 | int) -> Any:
        """Sleeps, then steps as the base does."""
        time.sleep(self._seconds)
        return super().step(action)


gymnasium.register("activelsd-benchmarks/Sleeper-v0", entry_point="sleeper:Sleeper")


def graph() -> ViewGraph:
    """A graph with one object per class and twelve views each; the frames are noise."""
    views = np.arange(CLASSES * VIEWS)
    ring, angle = views // VIEWS * VIEWS, views % VIEWS
    names = tuple(f"object_{i}" for i in range(CLASSES))
    return ViewGraph(
        frames=np.random.default_rng(0).integers(0, 256, (len(views), SIZE, SIZE), dtype=np.uint8),
        moves=np.stack([ring + (angle + turn) % VIEWS for turn in (1, -1)], 1).astype(np.int32),
        move_names=("cw", "ccw"),
        classes=tuple(f"class_{i}" for i in range(CLASSES)),
        targets=names,
        labels=np.arange(CLASSES),
        scenes=names,
        scene_of=(views // VIEWS).astype(np.int32),
        view_names=tuple(str(a) for a in angle),
        start_view=views.astype(np.int32),
        start_target=(views // VIEWS).astype(np.int32),
        start_split=np.zeros(len(views), np.uint8),
    )
