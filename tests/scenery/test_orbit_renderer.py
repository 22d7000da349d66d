"""Views of a mesh: framing, shading, what must not matter, and what must be refused."""

from __future__ import annotations

from multiprocessing import get_context

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.errors import DataError
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.orbit_renderer import BACKGROUND, render_views
from activelsd.scenery.shapes import CATEGORIES, make_shape
from activelsd.scenery.shapes.solids import box, cylinder, join, lathe, turn

RING = [30.0 * i for i in range(12)]


def look(mesh, size=48, azimuths=RING, elevations=(30.0,)):
    cameras = [(azimuth, elevation) for elevation in elevations for azimuth in azimuths]
    return render_views(mesh, size=size, cameras=cameras)


@pytest.fixture
def step():
    """A block with a step on its -y side: no two of its four sides look alike."""
    return join([box((-1, -0.6, 0), (1, 0.6, 0.5)), box((-1, -0.1, 0.5), (0.2, 0.6, 1.1))])


def test_views_come_elevation_after_elevation(step):
    views = look(step, azimuths=(0.0, 90.0, 200.0), elevations=(10.0, 50.0))
    assert views.shape == (6, 48, 48)
    assert views.dtype == np.uint8
    for i, elevation in enumerate((10.0, 50.0)):
        for j, azimuth in enumerate((0.0, 90.0, 200.0)):
            alone = look(step, azimuths=(azimuth,), elevations=(elevation,))[0]
            np.testing.assert_array_equal(views[3 * i + j], alone)


def test_same_bytes_again_and_in_other_processes(step):
    here = look(step)
    np.testing.assert_array_equal(look(step), here)
    with get_context("spawn").Pool(2) as pool:
        for there in pool.map(look, [step, step]):
            np.testing.assert_array_equal(there, here)


def test_background_is_white_and_object_is_not(step):
    views = look(step)
    corners = views[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    assert (corners == BACKGROUND).all()
    centre = views[:, 20:28, 20:28]
    assert (centre < 230).all()


@pytest.mark.parametrize("category", CATEGORIES)
def test_nothing_touches_the_border(category):
    views = look(make_shape(category, np.random.default_rng(1)), elevations=(0.0, 30.0, 90.0))
    border = np.concatenate([views[:, 0], views[:, -1], views[:, :, 0], views[:, :, -1]], axis=None)
    assert (border == BACKGROUND).all()


def test_a_ball_fills_the_frame_and_no_more():
    ball = lathe([(np.sin(a), -np.cos(a)) for a in np.linspace(0, np.pi, 25)], 48)
    (view,) = look(ball, size=64, azimuths=(0.0,))
    rows, columns = np.nonzero(view < BACKGROUND)
    assert {rows.min(), columns.min()} <= {0, 1, 2}
    assert {rows.max(), columns.max()} <= {61, 62, 63}


def test_azimuth_is_counter_clockwise_from_x():
    """A post at +x stands in the middle seen from azimuth 0, and to the left seen from +y, azimuth 90."""
    mesh = join([box((-1, -1, 0), (1, 1, 0.2)), box((0.7, -0.1, 0), (0.9, 0.1, 2.0))])
    top = look(mesh, azimuths=(0, 90, 270), elevations=(0,))[:, :20] < BACKGROUND
    middle, left, right = (np.nonzero(rows)[1].mean() for rows in top)
    assert middle == pytest.approx(23.5, abs=1)
    assert left < 17
    assert right > 30


def test_turning_the_object_is_moving_along_the_ring(step):
    views = look(step)
    turned = look(turn(step, 90.0))  # a quarter turn keeps the bounding box's centre in place
    difference = np.abs(np.roll(views, 3, axis=0).astype(int) - turned)
    assert (difference > 2).mean() < 0.002  # rounding may move a ray across an edge


def test_vertices_no_face_uses_do_not_matter(step):
    vertices = np.vstack([step.vertices, [(1e6, -3e5, 7e4)]]).astype(np.float32)
    np.testing.assert_array_equal(look(Mesh(vertices, step.faces)), look(step))


def test_winding_does_not_matter(step):
    flipped = Mesh(step.vertices, np.ascontiguousarray(step.faces[:, ::-1]))
    np.testing.assert_array_equal(look(flipped), look(step))


@settings(max_examples=20, deadline=None)
@given(scale=st.floats(1e-3, 1e4), x=st.floats(-50, 50), y=st.floats(-50, 50), z=st.floats(-50, 50))
def test_units_and_origin_do_not_matter(scale, x, y, z):
    mesh = join([box((-1, -0.6, 0), (1, 0.6, 0.5)), box((-1, -0.1, 0.5), (0.2, 0.6, 1.1))])
    moved = Mesh(((mesh.vertices + np.array([x, y, z])) * scale).astype(np.float32), mesh.faces)
    difference = np.abs(look(moved, azimuths=(40.0,)).astype(int) - look(mesh, azimuths=(40.0,)))
    assert (difference > 2).mean() < 0.01


def test_repeated_and_zero_area_faces_do_not_matter(step):
    np.testing.assert_array_equal(look(join([step, step])), look(step))
    more = np.array([(0, 0, 1), (2, 2, 2)], dtype=np.int32)
    np.testing.assert_array_equal(look(Mesh(step.vertices, np.concatenate([step.faces, more]))), look(step))


def test_a_thin_sheet_is_seen_from_both_sides():
    sheet = Mesh(
        np.array([(0, -1, 0), (0, 1, 0), (0, 1, 1), (0, -1, 1)], dtype=np.float32),
        np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32),
    )
    front, back = look(sheet, azimuths=(0.0, 180.0))
    assert (front < BACKGROUND).sum() > 100
    np.testing.assert_array_equal(front, back)


def test_edges_are_smoothed():
    (view,) = look(cylinder(0.5, 0, 1, segments=32), azimuths=(0.0,))
    assert len(np.unique(view)) > 12


def test_a_mesh_without_faces_is_refused():
    mesh = Mesh(np.zeros((3, 3), dtype=np.float32), np.zeros((0, 3), dtype=np.int32))
    with pytest.raises(DataError, match="no faces"):
        look(mesh)


def test_a_mesh_without_extent_is_refused():
    mesh = Mesh(np.ones((3, 3), dtype=np.float32), np.array([(0, 1, 2)], dtype=np.int32))
    with pytest.raises(DataError, match="no extent"):
        look(mesh)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_not_numbers_are_refused(step, value):
    vertices = step.vertices.copy()
    vertices[3, 1] = value
    with pytest.raises(DataError, match="not finite"):
        look(Mesh(vertices, step.faces))
