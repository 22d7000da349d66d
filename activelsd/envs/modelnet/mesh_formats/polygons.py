"""Cuts polygons into triangles: fans where they are convex, ears where they are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.surface import Surface, ranges

_FLAT = 1e-6
"""Sine of the turn at a corner up to which it counts as straight."""

_FORCED = 8
"""Corners of a polygon that are clipped though they are no ears."""


def triangles(surface: Surface) -> NDArray[np.int64]:
    """Triangles (T, 3) of a surface's polygons in their order; points and lines have none.

    A polygon of n corners gives n - 2, whose union it is if it is flat and simple. A convex one gives a fan:
    a b c d gives a b c and a c d.
    """
    corners, sizes = surface.corners.astype(np.int64), surface.sizes
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    starts = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    places = np.cumsum(counts) - counts
    found = np.zeros((int(counts.sum()), 3), np.int64)
    for n in np.unique(sizes[sizes >= 3]):
        own = np.flatnonzero(sizes == n)
        polygons = corners[starts[own][:, None] + np.arange(n)]
        if n > 3:
            flat = _projected(surface.points[polygons])
            turns = _sines(flat)
            concave = np.flatnonzero(turns.min(axis=1) < -_FLAT)
        if n == 4:  # a fan from the corner that turns in
            first = turns[concave].argmin(axis=1)
            polygons[concave] = polygons[concave[:, None], (first[:, None] + np.arange(4)) % 4]
        fans = np.empty((len(own), n - 2, 3), np.int64)
        fans[..., 0], fans[..., 1], fans[..., 2] = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
        if n > 4:
            for i in concave:
                fans[i] = polygons[i][_ears(flat[i])]
        found[ranges(places[own], counts[own])] = fans.reshape(-1, 3)
    return found


def _projected(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Polygons (m, n, 3) seen along their normals: (m, n, 2), counter-clockwise."""
    shifted = polygons - polygons[:, :1]
    shifted /= np.maximum(np.abs(shifted).max(axis=(1, 2), keepdims=True), np.finfo(np.float64).tiny)
    ahead = np.roll(shifted, -1, axis=1)
    normals = np.cross(shifted, ahead).sum(axis=1)  # Newell's
    axis = np.abs(normals).argmax(axis=1)
    sign = np.sign(normals[np.arange(len(normals)), axis])
    u = np.take_along_axis(shifted, ((axis + 1) % 3)[:, None, None], axis=2)[..., 0]
    v = np.take_along_axis(shifted, ((axis + 2) % 3)[:, None, None], axis=2)[..., 0]
    return np.stack([u, v * np.where(sign < 0, -1.0, 1.0)[:, None]], axis=2)


def _sines(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sines (m, n) of the turns to the left at the corners of polygons (m, n, 2); 0 at one without length."""
    ahead = np.roll(polygons, -1, axis=1) - polygons
    behind = np.roll(ahead, 1, axis=1)
    scale = np.linalg.norm(behind, axis=2) * np.linalg.norm(ahead, axis=2)
    sines: NDArray[np.float64] = _cross(behind, ahead) / np.where(scale > 0, scale, 1.0)
    return sines


def _ears(polygon: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles (n - 2, 3) of a counter-clockwise polygon (n, 2) by clipping ears.

    Holes may be cut in by a bridge that is walked both ways. A polygon that crosses itself may have no ear
    left: then a corner is clipped all the same, and after a few of these the rest becomes a fan.
    """
    left = list(range(len(polygon)))
    ears: list[tuple[int, int, int]] = []
    turns = _turns(*(np.roll(polygon, shift, axis=0) for shift in (1, 0, -1)))
    at, failed, forced = 0, 0, 0
    while len(left) > 3 and forced < _FORCED:
        at %= len(left)
        here = left[at]
        ear = left[at - 1], here, left[(at + 1) % len(left)]
        is_ear = turns[here] == 0 or (turns[here] > 0 and not _holds(polygon[list(ear)], polygon[turns < 0]))
        if not is_ear and failed < len(left):
            at, failed = at + 1, failed + 1
            continue
        forced += not is_ear
        ears.append(ear)
        del left[at]
        turns[here] = 0
        failed = 0
        for i in (at - 1, at % len(left)):
            turns[left[i]] = _turns(*polygon[[left[i - 1], left[i], left[(i + 1) % len(left)]]])
    ears += [(left[0], left[i], left[i + 1]) for i in range(1, len(left) - 1)]
    return np.array(ears, np.int64)


def _turns(
    before: NDArray[np.float64], here: NDArray[np.float64], after: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Positive where the way from one point (…, 2) over the next to the last turns left."""
    return _cross(here - before, after - here)


def _holds(ear: NDArray[np.float64], points: NDArray[np.float64]) -> bool:
    """Whether one of the points (k, 2) lies inside the counter-clockwise triangle (3, 2), not on its rim."""
    sides = [_turns(ear[i], ear[(i + 1) % 3], points) > 0 for i in range(3)]
    return bool((sides[0] & sides[1] & sides[2]).any())


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    product: NDArray[np.float64] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
