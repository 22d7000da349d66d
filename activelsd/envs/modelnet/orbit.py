"""Moves on the orbit around an object, found by name among those of this and of other packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd import registry
from activelsd.envs.modelnet.cameras import Rig
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError


class OrbitMove(NamedTuple):
    """A step from camera to camera: around the object, up or down, or both.

    On a ring of N cameras an angle is the nearest whole number of them, at least one. The ring closes; the
    highest and the lowest elevation block.
    """

    around: float = 0  # degrees, counter-clockwise seen from above
    up: int = 0  # elevations
    beside: int = 0  # cameras, counter-clockwise, whatever angle lies between

    def leads_to(self, camera: int, rig: Rig) -> int:
        """The camera that the step leads to, -1 if it is blocked."""
        to = camera
        if self.beside:
            to = rig.beside(to, self.beside)
        if self.around and to >= 0:
            to = rig.around(to, self.around)
        if self.up and to >= 0:
            to = rig.above(to, self.up)
        return to


ORBIT_CW, ORBIT_CCW = OrbitMove(beside=-1), OrbitMove(beside=1)
ORBIT_CW_60, ORBIT_CCW_60 = OrbitMove(around=-60), OrbitMove(around=60)
ORBIT_CW_90, ORBIT_CCW_90 = OrbitMove(around=-90), OrbitMove(around=90)
ORBIT_OPPOSITE = OrbitMove(around=180)
ORBIT_UP, ORBIT_DOWN = OrbitMove(up=1), OrbitMove(up=-1)


def move_tables(names: Sequence[str], rigs: Sequence[Rig]) -> dict[Rig, NDArray[np.int32]]:
    """For each different rig int32 (cameras, n): the camera that each move leads to, -1 where it is blocked.

    Raises:
        ConfigError: a move is unknown, or needs more elevations than any rig has.
    """
    moves = []
    different = dict.fromkeys(rigs)
    for name in names:
        move = registry.orbit_moves.get(name)
        if not isinstance(move, OrbitMove):
            raise registry.orbit_moves.broken(name, "is no OrbitMove")
        if move.up and not any(rig.climbs for rig in different):
            raise ConfigError(
                f"'{name}' needs more than one elevation; ask for some, as in env.elevations=[0,30]."
            )
        moves.append(move)
    return {
        rig: np.array(
            [[move.leads_to(camera, rig) for move in moves] for camera in range(len(rig.cameras))], np.int32
        ).reshape(len(rig.cameras), len(moves))
        for rig in different
    }


def with_moves(
    graph: ViewGraph, moves: Sequence[str] | Mapping[str, Sequence[str]], rigs: Sequence[Rig]
) -> ViewGraph:
    """The graph of objects with these moves, by branch or all `navigate`, and the cameras' directions.

    Args:
        graph: every scene is an object.
        moves: their names.
        rigs: the cameras of every scene, in the order of its views.
    """
    names = tuple(chain.from_iterable(moves.values())) if isinstance(moves, Mapping) else tuple(moves)
    tables = move_tables(names, rigs)
    stand = {rig: np.array(rig.cameras, np.float32) for rig in tables}
    directions = np.concatenate([stand[rig] for rig in rigs])
    table, first = np.empty((len(graph.scene_of), len(names)), np.int32), 0
    for rig in rigs:
        own = tables[rig]
        table[first : first + len(own)] = np.where(own >= 0, own + first, -1)
        first += len(own)
    assert first == len(table)
    graph = replace(graph, moves=table, move_names=names, move_branches=None, directions=directions)
    return graph.with_moves(moves)
