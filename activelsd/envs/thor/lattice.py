"""Where an agent can stand in a simulated room and which way it can look, in whole numbers.

Steps of 0.25 m taken at 45 degrees leave a simulator's grid, and poses come back noisy. So places are cells
of a grid over its reachable positions, directions are counted, and poses are worked out anew every time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

HEADINGS = 8
"""Directions of 45 degrees, clockwise seen from above, the first along z."""

MOVES = (
    "forward", "backward", "left", "right", "rotate_cw", "rotate_ccw", "look_up", "look_down"
)  # fmt: skip

_STEPS = {"forward": 0, "right": 2, "backward": 4, "left": 6}  # headings clockwise of the agent's own
_TURNS = {"rotate_cw": 1, "rotate_ccw": -1}
_TILTS = {"look_up": -1, "look_down": 1}
_ALONG = np.array([(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)])
"""Columns (x) and rows (z) that a step in each heading passes."""


_RECORDED = [0, 2, 3, 1, 4]
"""The order in which a `ViewGraph` keeps a pose's numbers."""


class Pose(NamedTuple):
    """Where an agent stands, in metres, and looks, in degrees."""

    x: float
    y: float
    z: float
    rotation: float  # clockwise from z
    horizon: float  # down

    @classmethod
    def recorded(cls, row: NDArray[np.float32]) -> Pose:
        """The pose that a row (5,) of a `ViewGraph`'s poses tells."""
        x, z, rotation, y, horizon = row.tolist()
        return cls(x, y, z, rotation, horizon)


class Lattice(NamedTuple):
    """N cells, in each of which the agent looks in 8 headings at H horizons: V = 8 N H views.

    Views are numbered cell by cell, in a cell heading by heading, in a heading from the highest look down.
    """

    cells: NDArray[np.int64]  # (N, 2) column and row
    origin: tuple[float, float, float]  # metres: where column 0 and row 0 are, and the agent's height
    step: float  # metres
    horizons: tuple[float, ...]  # H, degrees down, rising

    @property
    def views(self) -> int:
        """V."""
        return len(self.cells) * HEADINGS * len(self.horizons)

    def pose(self, view: int) -> Pose:
        """Where the agent stands and looks in a view.

        In single precision, as a `ViewGraph` keeps it: who goes there by a recording sees the same.
        """
        place, horizon = divmod(view, len(self.horizons))
        cell, heading = divmod(place, HEADINGS)
        column, row = self.cells[cell].tolist()
        x, y, z = self.origin
        pose = (
            x + column * self.step,
            y,
            z + row * self.step,
            360 / HEADINGS * heading,
            self.horizons[horizon],
        )
        return Pose(*np.array(pose, np.float32).tolist())

    def poses(self) -> NDArray[np.float32]:
        """(V, 5) x, z, rotation, y and horizon of every view, as a `ViewGraph` has them."""
        poses = np.array([self.pose(view) for view in range(self.views)], np.float32)
        return poses[:, _RECORDED]

    def only(self, kept: NDArray[np.bool_]) -> Lattice:
        """The lattice of those of its cells, bool (N,)."""
        return self._replace(cells=self.cells[kept])

    def moves(self) -> NDArray[np.int32]:
        """(V, 8) view that each of `MOVES` leads to, -1 where it is blocked.

        A diagonal step needs both cells beside its way; a turn goes round, a tilt ends at the last horizon.
        """
        n, tilts = len(self.cells), len(self.horizons)
        cell, heading, horizon = np.unravel_index(np.arange(self.views), (n, HEADINGS, tilts))
        beside = self._neighbours()[cell]
        moves = np.full((self.views, len(MOVES)), -1, np.int32)

        def lead(
            name: str, to: NDArray[np.int64], heading: NDArray[np.int64], horizon: NDArray[np.int64]
        ) -> None:
            there = (to >= 0) & (horizon >= 0) & (horizon < tilts)
            view = (to * HEADINGS + heading % HEADINGS) * tilts + horizon
            moves[there, MOVES.index(name)] = view[there]

        for name, turned in _STEPS.items():
            way = (heading + turned) % HEADINGS
            lead(name, np.take_along_axis(beside, way[:, None], 1)[:, 0], heading, horizon)
        for name, by in _TURNS.items():
            lead(name, cell, heading + by, horizon)
        for name, by in _TILTS.items():
            lead(name, cell, heading, horizon + by)
        return moves

    def _neighbours(self) -> NDArray[np.int64]:
        """(N, 8) number of the cell a step away in each heading, -1 for none."""
        low = self.cells.min(0) - 1
        number = np.full(self.cells.max(0) - low + 2, -1)
        number[tuple((self.cells - low).T)] = np.arange(len(self.cells))
        around = number[tuple((self.cells - low).T[:, :, None] + _ALONG.T[:, None, :])]
        free = around >= 0
        # Odd headings are diagonal: the ways on either side must be free too.
        free[:, 1::2] &= free[:, 0::2] & np.roll(free[:, 0::2], -1, axis=1)
        return np.where(free, around, -1)


def lattice_of(
    positions: Iterable[Mapping[str, float]], *, step: float, horizons: Iterable[float]
) -> Lattice:
    """The lattice over a simulator's reachable positions.

    Args:
        positions: as GetReachablePositions returns them, metres by `x`, `y`, `z`; noise of some millimetres
            is snapped away.
        step: between cells, metres.
        horizons: degrees down.

    Raises:
        DataError: there is no position.
    """
    found = np.array([(place["x"], place["y"], place["z"]) for place in positions], np.float64)
    if not len(found):
        raise DataError(
            "The simulator's room has no position that its agent can reach; leave that scene out."
        )
    level = found[:, [0, 2]]
    low = level.min(0)
    cells = np.unique(np.rint((level - low) / step).astype(np.int64), axis=0)
    # Millimetres are as exact as positions come; what is less would differ from one start to the next.
    (x, z), y = np.round(low, 3).tolist(), round(float(np.median(found[:, 1])), 3)
    return Lattice(cells, (x, y, z), step, tuple(sorted(horizons)))
