"""Rectangles on the floor: an object's outline from above, overlap tests and distances."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Rect(NamedTuple):
    """A rectangle with centre (x, y) and half sides `half_x`, `half_y` in metres, rotated by `yaw`."""

    x: float
    y: float
    half_x: float
    half_y: float
    yaw: float  # degrees, counter-clockwise

    def grown(self, by: float) -> Rect:
        """The rectangle extended by `by` metres on every side."""
        return self._replace(half_x=self.half_x + by, half_y=self.half_y + by)

    def local(self, points: ArrayLike) -> NDArray[np.float64]:
        """Floor points (..., 2) in the rectangle's own axes, relative to its centre."""
        sin, cos = math.sin(math.radians(self.yaw)), math.cos(math.radians(self.yaw))
        dx, dy = np.moveaxis(np.asarray(points, np.float64) - (self.x, self.y), -1, 0)
        return np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=-1)

    def corners(self) -> NDArray[np.float64]:
        """The corners (4, 2) in order."""
        return self.points(np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]))

    def points(self, shares: NDArray[np.float64]) -> NDArray[np.float64]:
        """Floor points (P, 2) at fractions (P, 2) of the half sides, -1..1."""
        sin, cos = math.sin(math.radians(self.yaw)), math.cos(math.radians(self.yaw))
        u, v = shares[:, 0] * self.half_x, shares[:, 1] * self.half_y
        return np.stack([self.x + cos * u - sin * v, self.y + sin * u + cos * v], axis=1)


def overlap(a: Rect, b: Rect) -> bool:
    """Whether two rectangles share any area (separating axes)."""
    for own, other in ((a, b), (b, a)):
        corners = own.local(other.corners())
        half = np.array([own.half_x, own.half_y])
        if (corners.min(axis=0) >= half).any() or (corners.max(axis=0) <= -half).any():
            return False
    return True


def clearance(rect: Rect, starts: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (P,) of a rectangle from the segments from starts (P, 2) to ends (P, 2); 0 if they touch."""
    a, b = rect.local(starts), rect.local(ends)
    half = np.array([rect.half_x, rect.half_y])
    nearest = np.minimum(_outside(a, half), _outside(b, half))
    for corner in (half, -half, half * (1, -1), half * (-1, 1)):
        nearest = np.minimum(nearest, _to_segment(corner, a, b))
    return np.where(_crosses(a, b, half), 0.0, nearest)


def _outside(points: NDArray[np.float64], half: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (P,) of points (P, 2) from the rectangle at the origin with these half sides."""
    beyond = np.maximum(np.abs(points) - half, 0.0)
    distance: NDArray[np.float64] = np.hypot(beyond[:, 0], beyond[:, 1])
    return distance


def _to_segment(
    point: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    along = b - a
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((point - a) * along).sum(axis=1) / length, 0.0, 1.0)
    gap = a + share[:, None] * along - point
    distance: NDArray[np.float64] = np.hypot(gap[:, 0], gap[:, 1])
    return distance


def _crosses(a: NDArray[np.float64], b: NDArray[np.float64], half: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether segments have a point strictly inside the rectangle at the origin (slab clipping)."""
    along = b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-half - a) / along, (half - a) / along
    parallel = np.abs(along) < 1e-12
    inside = np.abs(a) < half
    enter = np.where(parallel, np.where(inside, -np.inf, np.inf), np.minimum(one, two))
    leave = np.where(parallel, np.where(inside, np.inf, -np.inf), np.maximum(one, two))
    first, last = np.maximum(enter.max(axis=1), 0.0), np.minimum(leave.min(axis=1), 1.0)
    crossing: NDArray[np.bool_] = first < last
    return crossing
