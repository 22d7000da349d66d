"""The floor grid of an agent: points that are at least its radius away from walls and objects."""

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
"""Offsets to the neighbours, counter-clockwise from +x; the even ones are along the axes."""


class FloorGrid(NamedTuple):
    """Grid points that can be reached from one another, numbered row by row."""

    step: float  # metres
    cells: NDArray[np.int32]  # (N, 2) column and row
    points: NDArray[np.float64]  # (N, 2) x and y in the room, metres
    neighbours: NDArray[np.int32]  # (N, 8) index of the neighbour in each of DIRECTIONS, -1 for none


def draw_floor_grid(room: Room, *, step: float, radius: float) -> FloorGrid:
    """The largest part of the grid that is connected by moves along the axes.

    A point is free if a disc of the given radius fits there; a move is free if the disc fits all along it.

    Raises:
        DataError: no point is free.
    """
    plan = room.plan
    columns, rows = int(plan.width // step) + 1, int(plan.depth // step) + 1
    offset = np.array([(plan.width % step) / 2, (plan.depth % step) / 2])  # centres the grid
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    points = cells * step + offset
    free = clear(room, points, points, radius)
    cells, points = cells[free], points[free]
    if len(cells) == 0:
        raise DataError(
            f"An agent of {radius} m radius has no free place in the room of {plan.width:.1f} by"
            f" {plan.depth:.1f} m; make the agent smaller or put fewer things into the room."
        )
    neighbours = _neighbours(room, cells, points, radius)
    kept = _largest(neighbours)
    numbers = np.full(len(cells) + 1, -1, np.int32)  # the last item maps -1 to -1
    numbers[np.flatnonzero(kept)] = np.arange(kept.sum())
    return FloorGrid(step, cells[kept].astype(np.int32), points[kept], numbers[neighbours[kept]])


def clear(
    room: Room, starts: NDArray[np.float64], ends: NDArray[np.float64], radius: float
) -> NDArray[np.bool_]:
    """(P,) whether a disc can move from starts (P, 2) to ends (P, 2) without touching a wall or an object."""
    limit = np.array([room.plan.width, room.plan.depth]) - radius
    points = np.stack([starts, ends])
    free = np.asarray(((points >= radius) & (points <= limit)).all(axis=(0, 2)))
    for footprint in room.footprints:
        free &= clearance(footprint, starts, ends) >= radius
    return free


def _neighbours(
    room: Room, cells: NDArray[np.int64], points: NDArray[np.float64], radius: float
) -> NDArray[np.int32]:
    """(N, 8) indices of the cells that a step can reach, -1 for none."""
    numbers = np.full(cells.max(axis=0) + 3, -1, np.int32)  # with an empty margin on all sides
    numbers[cells[:, 0] + 1, cells[:, 1] + 1] = np.arange(len(cells))
    neighbours = np.full((len(cells), len(DIRECTIONS)), -1, np.int32)
    for i, (dx, dy) in enumerate(DIRECTIONS):
        there = numbers[cells[:, 0] + 1 + dx, cells[:, 1] + 1 + dy]
        here = np.flatnonzero(there >= 0)
        free = clear(room, points[here], points[there[here]], radius)
        neighbours[here[free], i] = there[here[free]]
    return neighbours


def _largest(neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(N,) whether a point is in the largest part that is connected by steps along the axes."""
    along = neighbours[:, ::2]
    here, direction = np.nonzero(along >= 0)
    n = len(neighbours)
    links = coo_array((np.ones(len(here), np.uint8), (here, along[here, direction])), shape=(n, n))
    _, part = connected_components(links, directed=False)
    kept: NDArray[np.bool_] = part == np.bincount(part).argmax()
    return kept
