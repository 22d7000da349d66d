"""Gray pictures of a mesh from cameras around it, by casting rays with embree on the CPU.

The mesh is centred and scaled into the unit sphere and every camera sees just that sphere, so nothing
depends on the file's units. Faces are shaded flat and from both sides, since the winding of ModelNet's
faces cannot be trusted. The lights hang on the camera: turning the object by one step of the ring and
moving the camera by one step give the same picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from activelsd.errors import DataError
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rays import dot, face_normals, scene_of

DISTANCE = 3.0
"""From the camera to the centre of the unit sphere."""

FRAME_RADIUS = math.tan(math.asin(1 / DISTANCE)) * 1.05
"""Half the frame's side at distance 1; the twentieth keeps the sphere off the outermost pixels."""

SAMPLES = 2
"""Rays along each side of a pixel; their mean smooths the edges."""

BACKGROUND = 255
DEEPEST = 65535
"""Of a depth where a ray hits nothing."""

AMBIENT = 40.0
LIGHTS = (  # direction towards the light as (right, up, towards the camera), and its strength
    (np.array((-0.50, 0.60, 0.62)), 175.0),
    (np.array((0.80, 0.00, 0.60)), 60.0),
)
"""From the upper left and from the right: the top of a box, its front and its ends differ in gray. The
brightest gray is 223, so that nothing fades into the background."""


def render_views(mesh: Mesh, *, size: int, cameras: Sequence[tuple[float, float]]) -> NDArray[np.uint8]:
    """Pictures of a mesh from every camera.

    Args:
        mesh: what to look at.
        size: side S of the square pictures, in pixels.
        cameras: V pairs of an angle about z, counter-clockwise seen from above, and an angle above the xy
            plane, in degrees.

    Returns:
        uint8 (V, S, S); the same bytes for the same arguments.

    Raises:
        DataError: the mesh has no faces, no extent, or coordinates that are not finite.
    """
    corners = _normalised(mesh)
    scene, normals = scene_of(corners), face_normals(corners)
    points = corners.reshape(-1, 3)
    views = [
        _look(scene, corners[:, 0], normals, points, _camera(azimuth, elevation), size)
        for azimuth, elevation in cameras
    ]
    return np.stack(views)


def render_depths(mesh: Mesh, *, size: int, cameras: Sequence[tuple[float, float]]) -> NDArray[np.uint16]:
    """Depths of a mesh from every camera, with one ray through the middle of each pixel.

    Args:
        mesh: as `render_views`.
        size: as `render_views`.
        cameras: as `render_views`.

    Returns:
        uint16 (V, S, S): along the camera's axis, 0 where the unit sphere is nearest to the camera, 65534
        where it is furthest, and 65535 where the ray hits nothing.

    Raises:
        DataError: as `render_views`.
    """
    corners = _normalised(mesh)
    scene, points = scene_of(corners), corners.reshape(-1, 3)
    depths = np.full((len(cameras), size, size), DEEPEST, np.uint16)
    for picture, camera in zip(depths, cameras, strict=True):
        rows, columns, distance = _cast(scene, points, _camera(*camera), size, "DISTANCE")
        level = np.clip((distance - (DISTANCE - 1)) / 2, 0, 1) * (DEEPEST - 1)
        picture[rows, columns] = np.where(distance < DISTANCE + 2, np.rint(level), DEEPEST)
    return depths


def check_mesh(mesh: Mesh) -> None:
    """Raises DataError if a mesh cannot be rendered."""
    _normalised(mesh)


def _normalised(mesh: Mesh) -> NDArray[np.float64]:
    """Corners (M, 3, 3) of the faces, centred on their bounding box and scaled into the unit sphere."""
    if len(mesh.faces) == 0:
        raise DataError("The mesh has no faces, so there is nothing to render; leave it out.")
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    if not np.isfinite(corners).all():
        raise DataError("The mesh has coordinates that are not finite numbers; repair or leave it out.")
    flat = corners.reshape(-1, 3)  # the vertices that faces use: ModelNet has others, far away
    centred = corners - (flat.min(axis=0) + flat.max(axis=0)) / 2
    radius = math.sqrt(np.square(centred).sum(axis=2).max())
    if radius == 0.0:
        raise DataError("The mesh has no extent: all its vertices are one point; repair or leave it out.")
    normalised: NDArray[np.float64] = centred / radius
    return normalised


def _camera(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Rows right, up and back (towards the camera) of the camera that looks at the origin."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array(
        [
            (-math.sin(a), math.cos(a), 0.0),
            (-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)),
            (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)),
        ]
    )


def _look(
    scene: EmbreeScene,
    anchors: NDArray[np.float64],
    normals: NDArray[np.float64],
    points: NDArray[np.float64],
    camera: NDArray[np.float64],
    size: int,
) -> NDArray[np.uint8]:
    """One picture (S, S). `anchors` (M, 3) holds a corner of each face, `points` (P, 3) all corners."""
    rows, columns, face = _cast(scene, points, camera, size * SAMPLES, "INTERSECT")
    fine = np.full((size * SAMPLES, size * SAMPLES), BACKGROUND, dtype=np.uint8)
    fine[rows, columns] = _shades(anchors, normals, camera)[face]
    return _mean_of_blocks(fine)


def _cast(
    scene: EmbreeScene,
    points: NDArray[np.float64],
    camera: NDArray[np.float64],
    side: int,
    query: Literal["INTERSECT", "DISTANCE"],
) -> tuple[slice, slice, NDArray[Any]]:
    """Rows and columns of the samples that rays are cast for, and what embree answers (h, w) for each.

    A distance is along the camera's axis, since rays are as long as to reach the plane at distance 1.
    """
    rows, columns = _window(points, camera, side)
    step = 2 * FRAME_RADIUS / side
    x = (np.arange(side)[columns] + 0.5) * step - FRAME_RADIUS
    y = FRAME_RADIUS - (np.arange(side)[rows] + 0.5) * step
    right, up, back = camera
    across, down = x[:, None] * right, y[:, None] * up - back
    rays = across.astype(np.float32)[None] + down.astype(np.float32)[:, None]
    origins = np.broadcast_to((back * DISTANCE).astype(np.float32), (len(y) * len(x), 3))
    answers = scene.run(origins, rays.reshape(-1, 3), query=query).reshape(len(y), len(x))
    return rows, columns, answers


def _mean_of_blocks(fine: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture (S, S) of samples (S * SAMPLES, S * SAMPLES), rounded; strided sums beat a reduction."""
    rows = np.zeros((len(fine) // SAMPLES, len(fine)), dtype=np.uint16)
    total = np.zeros((len(rows), len(rows)), dtype=np.uint16)
    for i in range(SAMPLES):
        rows += fine[i::SAMPLES]
    for i in range(SAMPLES):
        total += rows[:, i::SAMPLES]
    return ((total + SAMPLES**2 // 2) // SAMPLES**2).astype(np.uint8)


def _window(points: NDArray[np.float64], camera: NDArray[np.float64], side: int) -> tuple[slice, slice]:
    """Rows and columns of the samples the mesh can cover; rays elsewhere would be cast for nothing."""
    right, up, back = camera
    scale = side / 2 / FRAME_RADIUS / (DISTANCE - dot(points, back))
    x, y = dot(points, right) * scale + side / 2, side / 2 - dot(points, up) * scale

    def span(values: NDArray[np.float64]) -> slice:
        return slice(max(0, math.floor(values.min()) - 1), min(side, math.ceil(values.max()) + 1))

    return span(y), span(x)


def _shades(
    anchors: NDArray[np.float64], normals: NDArray[np.float64], camera: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """Gray (M + 1,) of every face; the last entry is the background, so embree's -1 for a miss finds it."""
    facing = np.where(dot(normals, camera[2] * DISTANCE) >= dot(normals, anchors), 1.0, -1.0)
    gray = np.full(len(normals), AMBIENT)
    for direction, strength in LIGHTS:
        towards = direction[0] * camera[0] + direction[1] * camera[1] + direction[2] * camera[2]
        gray += strength * np.maximum(facing * dot(normals, towards), 0.0)
    return np.append(np.rint(gray), BACKGROUND).astype(np.uint8)
