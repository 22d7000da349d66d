"""The lattice of an agent's places and view directions in a simulated room, as integers.

Steps of 0.25 m at 45 degrees leave a simulator's grid, and the poses it returns are noisy. So places are
lattice cells over its reachable positions, directions are indices, and poses are always computed from both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.thor.settings import MOVES
from activelsd.errors import DataError

HEADINGS = 8
"""Headings in steps of 45 degrees, clockwise seen from above; the first is along z."""

_STEPS = {"forward": 0, "right": 2, "backward": 4, "left": 6}  # headings clockwise from the agent's
_TURNS = {"rotate_cw": 1, "rotate_ccw": -1}
_TILTS = {"look_up": -1, "look_down": 1}
_ALONG = np.array([(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)])
"""Column (x) and row (z) offsets of a step in each heading."""


_RECORDED = [0, 2, 3, 1, 4]
"""The fields of `Pose` in the order of a `ViewGraph`'s poses."""


class Pose(NamedTuple):
    """An agent's position in metres and view direction in degrees."""

    x: float
    y: float
    z: float
    rotation: float  # clockwise from z
    horizon: float  # down

    @classmethod
    def recorded(cls, row: NDArray[np.float32]) -> Pose:
        """The pose in a row (5,) of a `ViewGraph`'s poses."""
        x, z, rotation, y, horizon = row.tolist()
        return cls(x, y, z, rotation, horizon)


class Lattice(NamedTuple):
    """N cells with 8 headings and H horizons each: V = 8 N H views.

    Views are numbered by cell, then heading, then horizon from the highest view to the lowest.
    """

    cells: NDArray[np.int64]  # (N, 2) column and row
    origin: tuple[float, float, float]  # metres: x of column 0, the agent's y, z of row 0
    step: float  # metres
    horizons: tuple[float, ...]  # H, degrees down, ascending

    @property
    def views(self) -> int:
        """The number of views, V."""
        return len(self.cells) * HEADINGS * len(self.horizons)

    def pose(self, view: int) -> Pose:
        """The agent's pose in a view.

        It is rounded to single precision, as in a `ViewGraph`, so that a recorded pose gives the same image.
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
        """(V, 5) x, z, rotation, y and horizon of every view, as in a `ViewGraph`."""
        poses = np.array([self.pose(view) for view in range(self.views)], np.float32)
        return poses[:, _RECORDED]

    def only(self, kept: NDArray[np.bool_]) -> Lattice:
        """The lattice with only the cells for which `kept`, bool (N,), is True."""
        return self._replace(cells=self.cells[kept])

    def moves(self) -> NDArray[np.int32]:
        """(V, 8) view that each of `MOVES` leads to, -1 if it is blocked.

        A diagonal step needs both adjacent cells; turns wrap around, tilts end at the last horizon.
        """
        n, tilts = len(self.cells), len(self.horizons)
        cell, heading, horizon = np.unravel_index(np.arange(self.views), (n, HEADINGS, tilts))
        beside = self._neighbours()[cell]
        moves = np.full((self.views, len(MOVES)), -1, np.int32)

        def connect(
            name: str, to: NDArray[np.int64], heading: NDArray[np.int64], horizon: NDArray[np.int64]
        ) -> None:
            possible = (to >= 0) & (horizon >= 0) & (horizon < tilts)
            view = (to * HEADINGS + heading % HEADINGS) * tilts + horizon
            moves[possible, MOVES.index(name)] = view[possible]

        for name, turned in _STEPS.items():
            direction = (heading + turned) % HEADINGS
            connect(name, np.take_along_axis(beside, direction[:, None], 1)[:, 0], heading, horizon)
        for name, by in _TURNS.items():
            connect(name, cell, heading + by, horizon)
        for name, by in _TILTS.items():
            connect(name, cell, heading, horizon + by)
        return moves

    def _neighbours(self) -> NDArray[np.int64]:
        """(N, 8) index of the cell one step away in each heading, -1 for none."""
        low = self.cells.min(0) - 1
        number = np.full(self.cells.max(0) - low + 2, -1)
        number[tuple((self.cells - low).T)] = np.arange(len(self.cells))
        around = number[tuple((self.cells - low).T[:, :, None] + _ALONG.T[:, None, :])]
        free = around >= 0
        # Odd headings are diagonal: the headings on both sides must be free too.
        free[:, 1::2] &= free[:, 0::2] & np.roll(free[:, 0::2], -1, axis=1)
        return np.where(free, around, -1)


def lattice_of(
    positions: Iterable[Mapping[str, float]], *, step: float, horizons: Iterable[float]
) -> Lattice:
    """The lattice over a simulator's reachable positions.

    Args:
        positions: result of GetReachablePositions, `x`, `y`, `z` in metres; noise of a few millimetres is
            rounded away.
        step: distance between cells in metres.
        horizons: tilts in degrees down.

    Raises:
        DataError: there is no position.
    """
    points = np.array([(place["x"], place["y"], place["z"]) for place in positions], np.float64)
    if not len(points):
        raise DataError("The scene has no position that the agent can reach; leave that scene out.")
    floor = points[:, [0, 2]]
    low = floor.min(0)
    cells = np.unique(np.rint((floor - low) / step).astype(np.int64), axis=0)
    # Positions are exact to a millimetre; finer digits differ between starts of the simulator.
    (x, z), y = np.round(low, 3).tolist(), round(float(np.median(points[:, 1])), 3)
    return Lattice(cells, (x, y, z), step, tuple(sorted(horizons)))
