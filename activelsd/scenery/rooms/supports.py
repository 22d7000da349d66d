"""Surfaces that objects can stand on: horizontal faces of furniture that are free and within reach."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.scenery.rays import scene_of
from activelsd.scenery.rooms.footprints import Rect
from activelsd.scenery.rooms.models import Model

LOWEST, HIGHEST = 0.08, 1.35
"""Lowest and highest surface used, in metres above the floor."""

_LEAST_AREA = 0.01  # m²
_LEVEL = 0.98  # least z of the unit normal of a horizontal face
_TOUCH = 0.0015  # largest gap in metres between a surface and an object's bottom
_PITCH = 0.015  # metres between the rays that test the surface


class Spot(NamedTuple):
    """A point on a horizontal face, in the model's coordinates."""

    x: float
    y: float
    z: float


class Supports:
    """The horizontal surfaces of one model."""

    def __init__(self, model: Model) -> None:
        """Finds the surfaces."""
        self._corners = model.mesh.vertices[model.mesh.faces].astype(np.float64)
        across = np.cross(
            self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0]
        )
        doubled = np.linalg.norm(across, axis=1)
        height = self._corners[:, :, 2].mean(axis=1)
        level = np.abs(across[:, 2]) > _LEVEL * np.maximum(doubled, 1e-12)
        level &= (height > LOWEST) & (height < HIGHEST)
        steps, step = np.unique(np.round(height / _TOUCH).astype(np.int64), return_inverse=True)
        areas = np.bincount(step, np.where(level, doubled / 2, 0.0), len(steps))
        level &= areas[step] > _LEAST_AREA
        self._level = np.flatnonzero(level)
        self._weights = doubled[self._level] / max(doubled[self._level].sum(), 1e-12)
        self._scene = scene_of(self._corners)
        self.area = float(doubled[self._level].sum() / 2)  # m², including the undersides of boards

    def draw(self, rng: np.random.Generator) -> Spot:
        """A random point on a surface, uniform by area. There must be at least one surface."""
        a, b, c = self._corners[self._level[rng.choice(len(self._level), p=self._weights)]]
        u, v = np.sort(rng.random(2))
        x, y, z = a * u + b * (v - u) + c * (1 - v)
        return Spot(float(x), float(y), float(z))

    def holds(self, base: Rect, z: float, height: float) -> bool:
        """Whether a box with this base and height can stand at z.

        Its whole base must touch a surface, the model must not reach into it, and it must be reachable from
        above or from the front, unlike the inside of a drawer.
        """
        return (
            self._touches(base, z, height)
            and not triangles_in_box(self._corners, base, z + 2 * _TOUCH, z + height).any()
            and self._open(base, z, height)
        )

    def _touches(self, base: Rect, z: float, height: float) -> bool:
        u = np.linspace(-1, 1, 2 + int(2 * base.half_x / _PITCH))
        v = np.linspace(-1, 1, 2 + int(2 * base.half_y / _PITCH))
        plan = base.points(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
        origins = np.column_stack([plan, np.full(len(plan), z + height)]).astype(np.float32)
        down = np.broadcast_to(np.array([0.0, 0.0, -1.0], np.float32), origins.shape)
        found = self._scene.run(origins, down, output=1)
        gap = np.abs(found["tfar"] - height)
        return bool(((found["primID"] >= 0) & (gap < _TOUCH)).all())

    def _open(self, base: Rect, z: float, height: float) -> bool:
        middle = np.array([(base.x, base.y, z + height / 2)] * 2, np.float32)
        directions = np.array([(0.0, 0.0, 1.0), (0.0, -1.0, 0.0)], np.float32)
        return bool((self._scene.run(middle, directions, query="OCCLUDED") < 0).any())


def triangles_in_box(corners: NDArray[np.float64], base: Rect, low: float, high: float) -> NDArray[np.bool_]:
    """(M,) whether triangles (M, 3, 3) reach into an upright box (separating axes, Akenine-Möller 2001)."""
    local = np.concatenate([base.local(corners[..., :2]), corners[..., 2:] - (low + high) / 2], axis=-1)
    half = np.array([base.half_x, base.half_y, (high - low) / 2])
    near: NDArray[np.bool_] = (
        np.abs(local.min(axis=1) + local.max(axis=1)) / 2 < half + np.ptp(local, axis=1) / 2
    ).all(axis=1)
    inside: NDArray[np.bool_] = near.copy()
    tri = local[near]
    edges = np.roll(tri, -1, axis=1) - tri  # (K, 3, 3)
    crossed = np.cross(np.eye(3)[None, :, None], edges[:, None]).reshape(len(tri), 9, 3)
    axes = np.concatenate([crossed, np.cross(edges[:, 0], edges[:, 1])[:, None]], axis=1)
    spans = np.einsum("kac,kpc->kap", axes, tri)
    reach = (np.abs(axes) * half).sum(axis=2)
    apart = (spans.min(axis=2) > reach - 1e-9) | (spans.max(axis=2) < -reach + 1e-9)
    flat = (np.abs(axes) < 1e-12).all(axis=2)  # an edge parallel to a box axis gives no separating axis
    inside[near] = ~(apart & ~flat).any(axis=1)
    return inside
