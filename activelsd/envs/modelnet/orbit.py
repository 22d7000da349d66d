"""Moves on the orbit around an object, found by name among those of this and of other packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd import registry
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError

AZIMUTHS = 12


class OrbitMove(NamedTuple):
    """A step on the grid of cameras: around by a multiple of 30 degrees, up or down by whole elevations.

    The ring closes; the highest and the lowest elevation block.
    """

    around: int = 0  # degrees, counter-clockwise seen from above
    up: int = 0  # elevations


ORBIT_CW, ORBIT_CCW = OrbitMove(around=-30), OrbitMove(around=30)
ORBIT_CW_60, ORBIT_CCW_60 = OrbitMove(around=-60), OrbitMove(around=60)
ORBIT_CW_90, ORBIT_CCW_90 = OrbitMove(around=-90), OrbitMove(around=90)
ORBIT_OPPOSITE = OrbitMove(around=180)
ORBIT_UP, ORBIT_DOWN = OrbitMove(up=1), OrbitMove(up=-1)


def ring_table(names: Sequence[str], elevations: int) -> NDArray[np.int32]:
    """int32 (elevations * 12, n): the view each move leads to on one object's grid, -1 where blocked.

    Raises:
        ConfigError: a move is unknown, or needs more than one elevation.
    """
    table = np.full((elevations * AZIMUTHS, len(names)), -1, np.int32)
    elevation, azimuth = np.divmod(np.arange(len(table)), AZIMUTHS)
    for column, name in enumerate(names):
        move = registry.orbit_moves.get(name)
        if not isinstance(move, OrbitMove):
            raise registry.orbit_moves.broken(name, "is no OrbitMove")
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


def with_moves(graph: ViewGraph, moves: Sequence[str] | Mapping[str, Sequence[str]]) -> ViewGraph:
    """The graph of objects with these moves, by branch or all `navigate`.

    Every scene is one grid of views, elevation after elevation.
    """
    names = tuple(chain.from_iterable(moves.values())) if isinstance(moves, Mapping) else tuple(moves)
    views = len(graph.scene_of) // len(graph.scenes)
    ring = ring_table(names, views // AZIMUTHS)
    first = (np.arange(len(graph.scenes)) * views).astype(np.int32)[:, None, None]
    table = np.where(ring >= 0, ring + first, -1).reshape(len(graph.scene_of), len(names))
    graph = replace(graph, moves=table.astype(np.int32), move_names=names, move_branches=None)
    return graph.with_moves(moves)
