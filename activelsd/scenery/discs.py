"""Draws a point cloud as a mesh: a small disc at every point, in the plane of the surface there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from activelsd.errors import DataError
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rays import dot

NEIGHBOURS = 12
"""Neighbours of a point that its plane is fitted to."""

SMOOTHINGS = 4
"""How often the normals of neighbours in nearly the same plane are averaged."""

SAME_PLANE = 0.3
"""Sine of the largest angle between the line to such a neighbour and the plane of either point."""

RADIUS = slice(2, 6)
"""The radius of a disc is the mean distance to these neighbours of its point: the third to the sixth."""

LARGEST = 1.6
"""The largest radius, in medians of the object's: a stray point does not become a plate."""

SIDES = 5

_BLOCK = 1 << 15
"""Points that planes are fitted to at a time: all neighbours of a large cloud need much memory."""

DECIMALS = 9
"""Points that agree in so many decimals of the object's size are one."""


def disc_mesh(points: NDArray[np.float64], normals: NDArray[np.float64] | None = None) -> Mesh:
    """The discs of a point cloud; none of them reaches beyond the box around the points.

    Args:
        points: (N, 3) finite points on a surface, in any unit and about any origin.
        normals: (N, 3) unit normals of either sign; None: those of planes through the neighbours.

    Returns:
        Pentagons, cut into triangles, of a cloud that is centred and 1 long.

    Raises:
        DataError: there are too few points to fit planes to.
    """
    points, first = distinct(points)
    distances, near = cKDTree(points).query(points, NEIGHBOURS + 1)
    distances, near = distances[:, 1:], near[:, 1:]  # without the point itself
    radii = distances[:, RADIUS].mean(axis=1)
    radii = np.minimum(radii, LARGEST * np.median(radii))
    return _pentagons(points, _fitted(points, near) if normals is None else normals[first], radii)


def distinct(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """The different points of a cloud, centred and 1 long, in order, and the first row (N,) of each.

    Raises:
        DataError: there are too few to fit planes to.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low).max() or 1.0
    rounded = np.round((points - (low + (high - low) / 2)) / size, DECIMALS)
    different, first = np.unique(rounded, axis=0, return_index=True)
    if len(different) <= NEIGHBOURS:
        raise DataError(
            f"There are {len(different)} different points, and {NEIGHBOURS + 1} are needed to draw a surface;"
            " leave it out."
        )
    return different, first


def _fitted(points: NDArray[np.float64], near: NDArray[np.intp]) -> NDArray[np.float64]:
    """Unit normals (N, 3) of planes through the neighbours `near` (N, K) of points (N, 3), smoothed."""
    blocks = [slice(at, at + _BLOCK) for at in range(0, len(points), _BLOCK)]
    normals = np.concatenate([_planes(points[near[block]]) for block in blocks])
    for _ in range(SMOOTHINGS):
        normals = np.concatenate(
            [
                _smoothed(normals[block], normals[near[block]], points[near[block]] - points[block, None])
                for block in blocks
            ]
        )
    return normals


def _planes(around: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals (N, 3) of planes through K points each (N, K, 3)."""
    offsets = around - around.mean(axis=1, keepdims=True)
    normals: NDArray[np.float64] = np.linalg.eigh(offsets.transpose(0, 2, 1) @ offsets)[1][:, :, 0]
    return normals


def _smoothed(
    normals: NDArray[np.float64], others: NDArray[np.float64], lines: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Means (N, 3) of normals and those of neighbours (N, K, 3) in nearly the same plane, along `lines`."""
    own, limit = normals[:, None], SAME_PLANE * np.sqrt(dot(lines, lines))
    level = (np.abs(dot(lines, own)) <= limit) & (np.abs(dot(lines, others)) <= limit)
    signs = np.where(level, np.where(dot(others, own) < 0, -1.0, 1.0), 0.0)
    total = normals + (signs[..., None] * others).sum(axis=1)
    unit: NDArray[np.float64] = total / np.sqrt(dot(total, total))[:, None]
    return unit


def _pentagons(points: NDArray[np.float64], normals: NDArray[np.float64], radii: NDArray[np.float64]) -> Mesh:
    """A regular polygon around each point (N, 3), cut to the box of all points."""
    steepest = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, steepest)
    across *= (radii / np.sqrt(dot(across, across)))[:, None]
    up = np.cross(normals, across)
    angles = np.arange(SIDES)[:, None] * (2 * math.pi / SIDES)
    corners = points[:, None] + np.cos(angles) * across[:, None] + np.sin(angles) * up[:, None]
    corners = corners.clip(points.min(axis=0), points.max(axis=0)).reshape(-1, 3)
    fan = [(0, i, i + 1) for i in range(1, SIDES - 1)]
    faces = np.arange(len(points))[:, None, None] * SIDES + np.array(fan)
    return Mesh(corners.astype(np.float32), faces.reshape(-1, 3).astype(np.int32))
