"""Embedded shapes: sound meshes, replayed by a seed, that hide what tells them apart from some sides."""

from __future__ import annotations

import time

import numpy as np
import pytest

from activelsd.errors import DataError
from activelsd.scenery.orbit_renderer import render_views
from activelsd.scenery.shapes import CATEGORIES, cabinets, make_shape, screens, tables, vessels
from activelsd.scenery.shapes.solids import arc, box, cylinder, join, lathe, prism, shift, tube, turn

MODELNET40 = """
airplane bathtub bed bench bookshelf bottle bowl car chair cone cup curtain desk door dresser flower_pot
glass_box guitar keyboard lamp laptop mantel monitor night_stand person piano plant radio range_hood sink
sofa stairs stool table tent toilet tv_stand vase wardrobe xbox
"""
FRONT, BACK = 270.0, 90.0  # azimuths: shapes are built with the front towards -y, then turned


def test_categories_are_modelnets():
    assert len(CATEGORIES) >= 16
    assert list(CATEGORIES) == sorted(set(CATEGORIES))
    assert set(CATEGORIES) <= set(MODELNET40.split())


@pytest.mark.parametrize("category", CATEGORIES)
def test_meshes_are_sound(category):
    for seed in range(20):
        vertices, faces = make_shape(category, np.random.default_rng(seed))
        assert vertices.dtype == np.float32
        assert faces.dtype == np.int32
        assert np.isfinite(vertices).all()
        assert faces.min() >= 0
        assert faces.max() < len(vertices)
        assert 40 <= len(faces) <= 2000
        assert (np.ptp(vertices, axis=0) > 0.05).all()


@pytest.mark.parametrize("category", CATEGORIES)
def test_a_seed_replays_a_shape(category):
    one, same, other = (make_shape(category, np.random.default_rng(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.vertices, same.vertices)
    np.testing.assert_array_equal(one.faces, same.faces)
    assert one.vertices.shape != other.vertices.shape or not np.allclose(one.vertices, other.vertices)


def test_shapes_are_turned_at_random():
    """The handles of cups point everywhere."""
    angles = []
    for seed in range(60):
        x, y, _ = make_shape("cup", np.random.default_rng(seed)).vertices.T
        far = np.argmax(x**2 + y**2)
        angles.append(np.degrees(np.arctan2(y[far], x[far])) % 360)
    assert (np.histogram(angles, bins=4, range=(0, 360))[0] >= 6).all()


def test_an_unknown_category_is_refused():
    with pytest.raises(DataError, match=r"'car'.*bench"):
        make_shape("car", np.random.default_rng(0))


def test_shapes_are_made_quickly():
    began, count = time.process_time(), 0
    for category in CATEGORIES:
        for seed in range(5):
            make_shape(category, np.random.default_rng(seed))
            count += 1
    assert (time.process_time() - began) / count < 0.01  # 0.6 ms measured


def views_of(maker, seed, azimuths):
    mesh = maker(np.random.default_rng(seed))
    return render_views(mesh, size=64, cameras=[(azimuth, 30.0) for azimuth in azimuths]).astype(int)


def test_a_cup_hides_its_handle():
    """From behind the left half mirrors the right one; from the side the handle breaks the mirror."""
    for seed in range(8):
        side, back = views_of(vessels.cup, seed, (0.0, BACK)) < 255
        assert (back != back[:, ::-1]).mean() < 0.02
        assert (side != side[:, ::-1]).mean() > 0.03


@pytest.mark.parametrize(
    "maker",
    [cabinets.bookshelf, cabinets.dresser, cabinets.night_stand, cabinets.tv_stand, cabinets.wardrobe],
)
def test_cabinets_tell_only_at_the_front(maker):
    """The back is plain: its left half mirrors the right one, and the outline is the front's."""
    for seed in range(6):
        front, back = views_of(maker, seed, (FRONT, BACK))
        assert ((front < 255) != (back < 255)).mean() < 0.08
        assert (np.abs(back - back[:, ::-1]) > 20).mean() < 0.04
        assert (np.abs(front - back) > 20).mean() > 0.04


@pytest.mark.parametrize("maker", [tables.desk, screens.laptop])
def test_fronts_and_backs_differ(maker):
    front, back = views_of(maker, 0, (FRONT, BACK))
    assert (np.abs(front - back) > 20).mean() > 0.05


def area(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def volume(mesh):
    """By the divergence theorem: right only where every face is wound outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    return abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_solids_have_the_area_and_volume_they_should():
    block = box((1, 2, 3), (2, 4, 6))
    assert area(block) == pytest.approx(2 * (1 * 2 + 2 * 3 + 1 * 3))
    assert volume(block) == pytest.approx(6.0)
    assert volume(cylinder(0.5, 1.0, 3.0, segments=200)) == pytest.approx(0.5 * np.pi, rel=1e-3)
    assert volume(cylinder(1.0, 0.0, 3.0, segments=200, top=0.0)) == pytest.approx(np.pi, rel=1e-3)
    wedge = prism([(0, 0), (2, 0), (0, 1)], -1.0, 2.0)
    assert area(wedge) == pytest.approx(2 + 3 * (2 + 1 + np.sqrt(5)))
    ball = lathe([(np.sin(a), np.cos(a)) for a in np.linspace(0, np.pi, 100)], 200)
    assert area(ball) == pytest.approx(4 * np.pi, rel=1e-3)


def test_a_tube_keeps_its_radius_around_a_bend():
    bow = np.insert(arc(0, 180, 40), 1, 0.0, axis=1)  # in the xz plane
    bar = tube(bow, 0.1, sides=12)
    x, y, z = bar.vertices.T
    np.testing.assert_allclose(np.hypot(np.hypot(x, z) - 1, y), 0.1, atol=0.01)


def test_turning_and_shifting():
    mesh = shift(box((0, 0, 0), (1, 1, 1)), (1, 0, 0))
    quarter = turn(mesh, 90.0)
    np.testing.assert_allclose(quarter.vertices.min(axis=0), (-1, 1, 0), atol=1e-6)
    np.testing.assert_allclose(turn(mesh, 90.0, axis="x").vertices.max(axis=0), (2, 0, 1), atol=1e-6)
    np.testing.assert_allclose(turn(mesh, 90.0, about=(1.5, 0.5, 0)).vertices.mean(axis=0), (1.5, 0.5, 0.5))


def test_joining_keeps_every_face_with_its_vertices():
    parts = [box((0, 0, 0), (1, 1, 1)), cylinder(1, 0, 1), box((2, 2, 2), (3, 3, 3))]
    assert area(join(parts)) == pytest.approx(sum(area(part) for part in parts), rel=1e-6)
