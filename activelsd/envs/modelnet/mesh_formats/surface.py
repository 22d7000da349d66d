"""What every parser returns: points and the polygons between them, before they are checked and cut."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Surface(NamedTuple):
    """Polygons of any number of corners; fewer than three are points and lines, which show nothing."""

    points: NDArray[np.float64]  # (N, 3) x, y, z as in the file
    corners: NDArray[np.float64] | NDArray[np.int64]  # (K,) indices into points, polygon after polygon
    sizes: NDArray[np.int64]  # (M,) corners of each polygon; their sum is K

    @classmethod
    def of_triangles(cls, points: NDArray[np.float64], triangles: NDArray[np.int64]) -> Surface:
        """The surface of triangles (M, 3)."""
        return cls(points, triangles.ravel(), np.full(len(triangles), 3))


def ranges(starts: NDArray[np.int64], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers start, start + 1, … of every range, one range after another."""
    ends = np.cumsum(sizes)
    shifts = starts - (ends - sizes)
    return np.repeat(shifts, sizes) + np.arange(ends[-1] if len(ends) else 0)
