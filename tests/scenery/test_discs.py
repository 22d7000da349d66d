"""Discs at points: they lie in the surface, cover it, and stay in its box, whatever the unit and origin."""

from __future__ import annotations

import numpy as np
import pytest

from activelsd.errors import DataError
from activelsd.scenery.discs import disc_mesh
from activelsd.scenery.orbit_renderer import render_views
from activelsd.scenery.rays import face_normals


def sphere(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def box(count, seed=0):
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    points[np.arange(count), np.arange(count) % 3] = np.where(np.arange(count) % 2, 1.0, -1.0)
    return points


def pictures(mesh):
    return render_views(mesh, size=48, cameras=[(0, 30), (50, 30)])


def test_a_sphere_of_points_looks_like_a_sphere_without_holes():
    points = sphere(1024)
    mesh = disc_mesh(points)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    outward = corners.mean(axis=1) / np.linalg.norm(corners.mean(axis=1), axis=1, keepdims=True)
    level = np.abs((face_normals(corners) * outward).sum(axis=1))
    assert np.quantile(level, 0.05) > 0.95
    for view in pictures(mesh):
        rows, columns = np.nonzero(view < 255)
        inside = np.hypot(rows - 23.5, columns - 23.5) < 21
        assert (view[np.hypot(*(np.indices(view.shape) - 23.5)) < 21] < 255).all()
        assert inside.sum() > 0.85 * len(rows)


def test_a_box_has_three_plain_faces():
    points = box(1500)
    for view in pictures(disc_mesh(points)):
        seen = view[view < 255]
        grays, counts = np.unique(seen // 8, return_counts=True)
        assert np.sort(counts)[-4:].sum() > 0.6 * len(seen), dict(zip(grays, counts, strict=True))


def test_discs_stay_in_the_box_around_the_points():
    points = box(300) * (3, 2, 1)
    vertices = disc_mesh(points).vertices
    np.testing.assert_allclose(vertices.max(axis=0) * 6, points.max(axis=0), rtol=1e-5)
    np.testing.assert_allclose(vertices.min(axis=0) * 6, points.min(axis=0), rtol=1e-5)


@pytest.mark.parametrize(
    "changed",
    [
        lambda p: p * 1e30,
        lambda p: p * 1e-30,
        lambda p: p + np.array((465e3, 5761e3, 0)),
        lambda p: np.repeat(p, 2, 0),
    ],
    ids=["huge", "tiny", "far", "repeated"],
)
def test_unit_origin_order_and_repeats_do_not_matter(changed):
    points = box(300)
    np.testing.assert_allclose(pictures(disc_mesh(changed(points))), pictures(disc_mesh(points)), atol=3)
    mixed = np.random.default_rng(0).permutation(points)
    np.testing.assert_array_equal(disc_mesh(mixed).vertices, disc_mesh(points).vertices)


def test_known_normals_are_used():
    points = sphere(200)
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    mesh = disc_mesh(points, normals)
    level = np.abs(face_normals(mesh.vertices[mesh.faces])[:, 2])
    assert ((level == 1.0) | (level == 0.0)).all()  # 0: cut away at the box's top and bottom
    assert level.mean() > 0.98


def test_flat_straight_and_too_few_points():
    flat = box(200) * (1, 1, 0)
    assert (pictures(disc_mesh(flat)) < 255).any()
    line = np.linspace(0, 1, 50)[:, None] * (1, 1, 0)
    assert np.isfinite(disc_mesh(line).vertices).all()
    for points in (flat[:12], np.ones((100, 3)), np.repeat(flat[:12], 20, 0)):
        with pytest.raises(DataError, match="different points, and 13 are needed"):
            disc_mesh(points)


def test_a_large_cloud_is_drawn_in_blocks(monkeypatch):
    points = box(500)
    whole = disc_mesh(points)
    monkeypatch.setattr("activelsd.scenery.discs._BLOCK", 64)
    np.testing.assert_allclose(disc_mesh(points).vertices, whole.vertices, atol=1e-6)
