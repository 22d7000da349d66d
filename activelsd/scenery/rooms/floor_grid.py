"""Where an agent can stand and step: grid points of the floor clear of walls and things by its radius."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from activelsd.errors import DataError
from activelsd.scenery.rooms.footprints import clearance
from activelsd.scenery.rooms.layout import Room

DIRECTIONS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""Steps to the neighbours, counter-clockwise from +x; the even ones go along the axes."""


class FloorGrid(NamedTuple):
    """The points that can be reached from one another, numbered row by row."""

    step: float  # metres
    cells: NDArray[np.int32]  # (N, 2) column and row
    points: NDArray[np.float64]  # (N, 2) x and y in the room, metres
    neighbours: NDArray[np.int32]  # (N, 8) number of the point that way by DIRECTIONS, -1 for none


def draw_floor_grid(room: Room, *, step: float, radius: float) -> FloorGrid:
    """The largest part of the grid that an agent can walk along the axes.

    A point is free if a disc of the radius fits there, a move if it fits all along the way.

    Raises:
        DataError: no point is free.
    """
    plan = room.plan
    columns, rows = int(plan.width // step) + 1, int(plan.depth // step) + 1
    offset = np.array([(plan.width % step) / 2, (plan.depth % step) / 2])  # as many at either end
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    points = cells * step + offset
    free = clear(room, points, points, radius)
    cells, points = cells[free], points[free]
    if len(cells) == 0:
        raise DataError(
            f"An agent of {radius} m radius can stand nowhere in the room of"
            f" {plan.width:.1f} by {plan.depth:.1f} m; make it smaller or the room emptier."
        )
    neighbours = _neighbours(room, cells, points, radius)
    kept = _largest(neighbours)
    numbers = np.full(len(cells) + 1, -1, np.int32)  # the last for -1
    numbers[np.flatnonzero(kept)] = np.arange(kept.sum())
    return FloorGrid(step, cells[kept].astype(np.int32), points[kept], numbers[neighbours[kept]])


def clear(
    room: Room, starts: NDArray[np.float64], ends: NDArray[np.float64], radius: float
) -> NDArray[np.bool_]:
    """Whether (P,) a disc of the radius meets no wall and no thing from starts (P, 2) to ends (P, 2)."""
    most = np.array([room.plan.width, room.plan.depth]) - radius
    ways = np.stack([starts, ends])
    free = np.asarray(((ways >= radius) & (ways <= most)).all(axis=(0, 2)))
    for footprint in room.footprints:
        free &= clearance(footprint, starts, ends) >= radius
    return free


def _neighbours(
    room: Room, cells: NDArray[np.int64], points: NDArray[np.float64], radius: float
) -> NDArray[np.int32]:
    """Numbers (N, 8) of the cells that can be stepped to, -1 for none."""
    numbers = np.full(cells.max(axis=0) + 3, -1, np.int32)  # a margin of nothing all round
    numbers[cells[:, 0] + 1, cells[:, 1] + 1] = np.arange(len(cells))
    neighbours = np.full((len(cells), len(DIRECTIONS)), -1, np.int32)
    for i, (dx, dy) in enumerate(DIRECTIONS):
        there = numbers[cells[:, 0] + 1 + dx, cells[:, 1] + 1 + dy]
        here = np.flatnonzero(there >= 0)
        free = clear(room, points[here], points[there[here]], radius)
        neighbours[here[free], i] = there[here[free]]
    return neighbours


def _largest(neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which points (N,) belong to the largest part connected by steps along the axes."""
    along = neighbours[:, ::2]
    here, way = np.nonzero(along >= 0)
    n = len(neighbours)
    links = coo_array((np.ones(len(here), np.uint8), (here, along[here, way])), shape=(n, n))
    _, part = connected_components(links, directed=False)
    kept: NDArray[np.bool_] = part == np.bincount(part).argmax()
    return kept
