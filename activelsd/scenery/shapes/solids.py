"""Solids that the embedded shapes consist of (boxes, lathes, tubes, prisms), and transforms to place them.

Convention: x is width, y is depth with the front towards -y, z is up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from activelsd.scenery.meshes import Mesh

_BOX_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
_BOX_FACES = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ],
    dtype=np.int32,
)  # fmt: skip


def box(low: ArrayLike, high: ArrayLike) -> Mesh:
    """The box between two opposite corners (x, y, z)."""
    bottom = np.asarray(low, dtype=np.float32)
    return Mesh(bottom + _BOX_CORNERS * (np.asarray(high, dtype=np.float32) - bottom), _BOX_FACES)


def slab(width: float, depth: float, height: float, *, at: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """A box whose bottom is centred at the point `at`."""
    x, y, z = np.asarray(at, dtype=np.float64)
    return box((x - width / 2, y - depth / 2, z), (x + width / 2, y + depth / 2, z + height))


def lathe(profile: Sequence[tuple[float, float]], segments: int = 24) -> Mesh:
    """The surface of revolution about z of a profile of (radius, height) points; radius 0 closes it."""
    outline = np.asarray(profile, dtype=np.float32)
    angles = np.arange(segments) * (2 * math.pi / segments)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)
    rings = np.empty((len(outline), segments, 3), dtype=np.float32)
    rings[:, :, :2] = outline[:, None, :1] * ring
    rings[:, :, 2] = outline[:, 1:]
    return Mesh(rings.reshape(-1, 3), _quads(len(outline), segments))


def cylinder(radius: float, low: float, high: float, *, segments: int = 16, top: float | None = None) -> Mesh:
    """A closed upright cylinder, or a truncated cone if `top` gives another radius for the upper end."""
    upper = radius if top is None else top
    return lathe(((0.0, low), (radius, low), (upper, high), (0.0, high)), segments)


def tube(path: ArrayLike, radius: float, sides: int = 6) -> Mesh:
    """A round tube along the points (P, 3) of a planar path; its ends are open."""
    points = np.asarray(path, dtype=np.float64)
    along = np.gradient(points, axis=0)
    along /= np.sqrt(np.square(along).sum(axis=1, keepdims=True))
    bend = np.cross(along[0], along[len(along) // 2])  # normal of the path's plane
    if np.abs(bend).max() < 1e-6:
        bend = np.cross(along[0], (0.0, 0.0, 1.0) if abs(along[0, 2]) < 0.9 else (1.0, 0.0, 0.0))
    bend /= np.sqrt(np.square(bend).sum())
    across = np.cross(along, bend)
    angles = np.arange(sides) * (2 * math.pi / sides)
    circle = np.cos(angles)[:, None] * bend + np.sin(angles)[:, None] * across[:, None]
    rings = (points[:, None] + radius * circle).astype(np.float32)
    return Mesh(rings.reshape(-1, 3), _quads(len(points), sides))


def prism(outline: ArrayLike, x0: float, x1: float) -> Mesh:
    """A convex outline (P, 2) of (y, z) points extruded from x0 to x1, with closed ends."""
    points = np.asarray(outline, dtype=np.float32)
    n = len(points)
    ends = [np.column_stack([np.full(n, x, dtype=np.float32), points]) for x in (x0, x1)]
    fan = np.array([(0, i, i + 1) for i in range(1, n - 1)], dtype=np.int32)
    return Mesh(np.concatenate(ends), np.concatenate([_quads(2, n), fan, fan + n]))


def arc(start: float, end: float, points: int) -> NDArray[np.float64]:
    """Points (points, 2) on the unit circle from angle `start` to `end`, in degrees."""
    angles = np.radians(np.linspace(start, end, points))
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def join(parts: Iterable[Mesh]) -> Mesh:
    """Joins all parts into one mesh."""
    meshes = list(parts)
    firsts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    faces = [mesh.faces + np.int32(first) for mesh, first in zip(meshes, firsts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def shift(mesh: Mesh, by: ArrayLike) -> Mesh:
    """Translates a mesh by (x, y, z)."""
    return Mesh(mesh.vertices + np.asarray(by, dtype=np.float32), mesh.faces)


def turn(mesh: Mesh, degrees: float, *, axis: str = "z", about: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """Rotates a mesh counter-clockwise about an axis ('x', 'y' or 'z') through the point `about`."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    sin, cos = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    centre = np.asarray(about, dtype=np.float64)
    old = mesh.vertices - centre
    new = old.copy()
    new[:, i] = cos * old[:, i] - sin * old[:, j]
    new[:, j] = sin * old[:, i] + cos * old[:, j]
    return Mesh((new + centre).astype(np.float32), mesh.faces)


def _quads(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles for each cell of a vertex grid whose last column is connected to its first."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    faces = np.stack([a, b, d, a, d, c], axis=-1)
    return faces.reshape(-1, 3).astype(np.int32)
