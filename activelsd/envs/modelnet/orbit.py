"""Moves on the orbit around an object, by name; add one with `ORBIT_MOVES["name"] = OrbitMove(...)`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, did_you_mean

AZIMUTHS = 12


class OrbitMove(NamedTuple):
    """A step on the grid of cameras: around by a multiple of 30 degrees, up or down by whole elevations."""

    around: int = 0  # degrees, counter-clockwise seen from above
    up: int = 0  # elevations


ORBIT_MOVES: dict[str, OrbitMove] = {
    "orbit_cw": OrbitMove(around=-30),
    "orbit_ccw": OrbitMove(around=30),
    "orbit_cw_60": OrbitMove(around=-60),
    "orbit_ccw_60": OrbitMove(around=60),
    "orbit_cw_90": OrbitMove(around=-90),
    "orbit_ccw_90": OrbitMove(around=90),
    "orbit_opposite": OrbitMove(around=180),
    "orbit_up": OrbitMove(up=1),
    "orbit_down": OrbitMove(up=-1),
}
"""Every move a ModelNet world knows. The ring closes; the highest and lowest elevation block."""


def ring_table(names: Sequence[str], elevations: int) -> NDArray[np.int32]:
    """int32 (elevations * 12, n): the view each move leads to on one object's grid, -1 where blocked.

    Raises:
        ConfigError: a move is unknown, or needs more than one elevation.
    """
    table = np.full((elevations * AZIMUTHS, len(names)), -1, np.int32)
    elevation, azimuth = np.divmod(np.arange(len(table)), AZIMUTHS)
    for column, name in enumerate(names):
        if name not in ORBIT_MOVES:
            hint = did_you_mean(name, ORBIT_MOVES)
            raise ConfigError(f"The ModelNet world has no move '{name}'; {hint}")
        move = ORBIT_MOVES[name]
        if move.up and elevations == 1:
            raise ConfigError(
                f"'{name}' needs more than one elevation; ask for some, as in env.elevations=[0,30]."
            )
        if move.around % 30:
            raise ConfigError(f"'{name}' goes {move.around} degrees around; cameras stand every 30 degrees.")
        level = elevation + move.up
        to = level * AZIMUTHS + (azimuth + move.around // 30) % AZIMUTHS
        table[:, column] = np.where((level >= 0) & (level < elevations), to, -1)
    return table


def with_moves(graph: ViewGraph, names: Sequence[str]) -> ViewGraph:
    """The graph of objects with these moves: every scene is one grid of views, elevation after elevation."""
    views = len(graph.scene_of) // len(graph.scenes)
    ring = ring_table(names, views // AZIMUTHS)
    first = (np.arange(len(graph.scenes)) * views).astype(np.int32)[:, None, None]
    moves = np.where(ring >= 0, ring + first, -1).reshape(len(graph.scene_of), len(names))
    return replace(graph, moves=moves.astype(np.int32), move_names=tuple(names))
