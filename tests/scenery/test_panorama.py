"""Distance panoramas, against bodies whose distances are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from activelsd.errors import DataError
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.panorama import COLUMNS, ROWS, render_panorama


def mesh_of(*bodies: trimesh.Trimesh) -> Mesh:
    whole = trimesh.util.concatenate(bodies)
    return Mesh(np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.int32))


def turned(mesh: Mesh, degrees: float) -> Mesh:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
    return Mesh(mesh.vertices @ turn.T, mesh.faces)


def test_a_box_is_as_far_from_the_axis_as_geometry_says() -> None:
    """Wherever it stands, and however large it is."""
    angles = (np.arange(COLUMNS) + 0.5) * 2 * np.pi / COLUMNS
    sides = 1 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    expected = np.rint(255 * sides / sides.max())
    box = trimesh.creation.box((2, 2, 5))
    for scale, where in ((1.0, (0, 0, 0)), (30.0, (7, -4, 100))):
        seen = render_panorama(mesh_of(box.copy().apply_scale(scale).apply_translation(where)))
        assert seen.shape == (ROWS, COLUMNS)
        assert np.abs(seen - expected).max() <= 1


def test_turning_the_object_shifts_the_columns() -> None:
    mesh = mesh_of(
        trimesh.creation.box((1, 2, 3)), trimesh.creation.box((3, 0.5, 0.5)).apply_translation((1, 0, 1))
    )
    plain, other = render_panorama(mesh), render_panorama(turned(mesh, 32 * 360 / COLUMNS))
    different = np.abs(np.roll(plain, 32, 1).astype(int) - other) > 1
    assert different.mean() < 0.005, "rays that graze an edge may fall on either side"


def test_the_outermost_surface_counts_and_holes_are_zero() -> None:
    """Two rings one above the other around a post, with nothing between them."""
    post = trimesh.creation.cylinder(0.25, 4, sections=64)
    rings = [trimesh.creation.cylinder(1.0, 1, sections=64).apply_translation((0, 0, z)) for z in (-1.5, 1.5)]
    seen = render_panorama(mesh_of(post, *rings)).astype(int)
    assert seen[ROWS // 8].min() >= 252
    assert np.abs(seen[ROWS // 2] - 255 / 4).max() < 2
    apart = render_panorama(mesh_of(*rings))
    assert not apart[ROWS // 2].any()


def test_what_stands_beyond_the_axis_belongs_to_the_other_side() -> None:
    """One wall at x = 1 and a heavier one at x = -1: no column sees both, nor one through the other."""
    walls = [trimesh.creation.box((0.02, 2, 2)).apply_translation((x, 0, 0)) for x in (-1, 1)]
    seen = render_panorama(mesh_of(*walls))
    front, side = seen[ROWS // 2, 0], seen[ROWS // 2, COLUMNS // 4]
    assert front > 150
    assert side == 0


def test_a_mesh_without_faces_is_refused() -> None:
    empty: NDArray[np.int32] = np.zeros((0, 3), np.int32)
    with pytest.raises(DataError, match="no faces"):
        render_panorama(Mesh(np.zeros((3, 3), np.float32), empty))
