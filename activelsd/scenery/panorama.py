"""Distance panoramas of objects, as DeepPano sees them (Shi et al. 2015): by rays towards an upright axis.

The axis goes through the centroid of the surface. A pixel is the distance from the axis at which a horizontal
ray from outside first hits the object; its column is the angle, its row the height. Theirs has 500 columns
and 300 rows; half of that, in powers of two, lets pools shift without a rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.orbit_renderer import check_mesh
from activelsd.scenery.rays import scene_of

ROWS, COLUMNS = 128, 256

_OUTSIDE = 1.01
"""Where rays begin, in distances of the outermost vertex from the axis."""


def render_panorama(mesh: Mesh) -> NDArray[np.uint8]:
    """The panorama of a mesh, (ROWS, COLUMNS): 255 is the largest distance, 0 the axis, or nothing hit.

    The first column looks at the side that faces x, and the next ones go on counter-clockwise seen from
    above; the first row is just below the highest vertex.

    Raises:
        DataError: the mesh has no faces, no extent, or coordinates that are not finite.
    """
    check_mesh(mesh)
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    low, high = corners[..., 2].min(), corners[..., 2].max()
    corners[..., :2] -= _centroid(corners)[:2]
    reach = np.sqrt(np.square(corners[..., :2]).sum(-1)).max() or 1.0
    corners[..., :2] /= reach
    corners[..., 2] = (corners[..., 2] - low) / ((high - low) or 1.0)

    angles = (np.arange(COLUMNS) + 0.5) * (2 * np.pi / COLUMNS)
    heights = 1 - (np.arange(ROWS) + 0.5) / ROWS
    outward = np.stack([np.cos(angles), np.sin(angles), np.zeros(COLUMNS)], 1)
    origins = _OUTSIDE * outward + heights[:, None, None] * np.array([0.0, 0.0, 1.0])
    rays = np.broadcast_to(-outward, origins.shape)
    travelled = scene_of(corners).run(
        origins.reshape(-1, 3).astype(np.float32), rays.reshape(-1, 3).astype(np.float32), query="DISTANCE"
    )
    # What lies beyond the axis belongs to the opposite column.
    distances = np.clip(_OUTSIDE - travelled.reshape(ROWS, COLUMNS), 0.0, 1.0)
    largest = distances.max() or 1.0
    panorama: NDArray[np.uint8] = np.rint(255 * distances / largest).astype(np.uint8)
    return panorama


def _centroid(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """The centroid (3,) of faces, given by their corners (M, 3, 3), weighted by their areas."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.sqrt(np.square(across).sum(1))
    if not areas.any():
        areas += 1.0
    centroid: NDArray[np.float64] = (corners.mean(1) * areas[:, None]).sum(0) / areas.sum()
    return centroid
