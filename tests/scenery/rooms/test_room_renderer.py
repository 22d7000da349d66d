"""Pictures of rooms: what is where in them, how far, lit and shaded as it should be, and the same again."""

from __future__ import annotations

from multiprocessing import get_context

import numpy as np
import pytest

from activelsd.scenery.rooms.layout import FLOOR, Placed, Room, furnish, set_out
from activelsd.scenery.rooms.library import Embedded
from activelsd.scenery.rooms.models import assembled
from activelsd.scenery.rooms.room_renderer import NOTHING, SKY, Camera, RoomRenderer
from activelsd.scenery.rooms.shell import FloorPlan, draw_shell
from activelsd.scenery.rooms.smallthings import small_thing
from activelsd.scenery.rooms.textures import Material
from activelsd.scenery.shapes.solids import box

WHITE = Material((200.0, 200.0, 200.0))


def room_with(*things, ceiling=False):
    plan = FloorPlan(4.0, 4.0, 2.5, ceiling, ())
    shell = draw_shell(np.random.default_rng(0), plan)
    return Room(plan=plan, shell=shell, furniture=0, things=things, light=(2.0, 2.0, 2.4))


def block(side, x, y, z, yaw=0.0, material=WHITE):
    mesh = box((-side / 2, -side / 2, 0), (side / 2, side / 2, side))
    return Placed(assembled("block", 0, [(mesh, material)]), x, y, z, yaw, FLOOR)


def camera(x=0.5, y=2.0, z=1.2, yaw=0.0, pitch=0.0, fov=60.0, width=61, height=41):
    return Camera(x, y, z, yaw, pitch, fov, width, height)


def look(seed):
    room = set_out(furnish(Embedded(), seed), [small_thing("can", 0), small_thing("box", 1)], seed)
    return [part.tobytes() for part in RoomRenderer(room).look(camera(1.0, 1.0, yaw=40.0, pitch=-10.0))]


def test_same_bytes_again_and_in_another_process():
    here = look(2)
    assert look(2) == here
    with get_context("spawn").Pool(1) as pool:
        assert pool.apply(look, (2,)) == here


def test_shapes_and_types():
    picture = RoomRenderer(room_with()).look(camera())
    assert picture.colour.shape == (41, 61, 3)
    assert picture.colour.dtype == np.uint8
    assert picture.things.dtype == np.int32
    assert picture.depth.dtype == np.float32
    assert (picture.things == NOTHING).all()


def test_a_thing_is_where_the_camera_projects_it():
    thing = block(0.2, 3.0, 1.6, 1.3)
    eye = camera(yaw=-10.0, pitch=5.0, width=161, height=121)
    picture = RoomRenderer(room_with(thing)).look(eye)
    rows, columns = np.nonzero(picture.things == 0)
    corners = thing.model.mesh.vertices + np.array([thing.x, thing.y, thing.z])
    x, y, z = eye.axes @ (corners - (eye.x, eye.y, eye.z)).T
    u, v = eye.focal * x / z + 80.5, eye.focal * y / z + 60.5
    assert columns.min() == pytest.approx(u.min(), abs=1)
    assert columns.max() + 1 == pytest.approx(u.max(), abs=1)
    assert rows.min() == pytest.approx(v.min(), abs=1)
    assert rows.max() + 1 == pytest.approx(v.max(), abs=1)


def test_depth_is_along_the_axis():
    """The wall across is equally deep everywhere, however slanted the ray."""
    picture = RoomRenderer(room_with(ceiling=True)).look(camera(x=1.0, fov=20.0))
    np.testing.assert_allclose(picture.depth, 3.0, atol=1e-4)


def test_depth_of_every_pixel_is_on_a_surface_of_the_room():
    room = room_with(block(0.5, 2.5, 2.0, 0.0), ceiling=True)
    eye = camera(yaw=20.0, pitch=-25.0)
    picture = RoomRenderer(room).look(eye)
    u, v = np.meshgrid(np.arange(61) + 0.5 - 30.5, np.arange(41) + 0.5 - 20.5)
    rays = np.stack([u / eye.focal, v / eye.focal, np.ones_like(u)], axis=-1) @ eye.axes
    points = np.array([eye.x, eye.y, eye.z]) + picture.depth[..., None] * rays
    shell = picture.things == NOTHING
    x, y, z = points[shell].T
    gaps = [np.abs(x), np.abs(x - 4), np.abs(y), np.abs(y - 4), np.abs(z), np.abs(z - 2.5)]
    assert np.min(gaps, axis=0).max() < 0.02  # a skirting stands out that much
    inside = points[~shell]
    assert (np.abs(inside[:, :2] - (2.5, 2.0)).max(axis=1) < 0.2501).all()
    assert len(inside) > 100


def test_sky_has_no_depth():
    picture = RoomRenderer(room_with()).look(camera(pitch=80.0))
    assert (picture.depth == 0).all()
    assert (picture.colour == SKY).all()


def test_yaw_is_counter_clockwise_and_pitch_upwards():
    thing = block(0.2, 3.0, 2.0, 1.1)
    renderer = RoomRenderer(room_with(thing))

    def middle(**pose):
        rows, columns = np.nonzero(renderer.look(camera(**pose)).things == 0)
        return rows.mean(), columns.mean()

    row, column = middle()
    assert (row, column) == pytest.approx((20, 30), abs=1)
    assert middle(yaw=10.0)[1] > column + 3  # turned to the left, it moves to the right
    assert middle(pitch=10.0)[0] > row + 3


def test_shadows_fall_away_from_the_lamp_only():
    thing = block(0.4, 1.2, 2.0, 0.8)
    top = Camera(2.0, 2.0, 6.0, 90.0, -89.9, 60.0, 121, 121)
    with_shadow = RoomRenderer(room_with(thing)).look(top)
    without = RoomRenderer(room_with(thing), shadows=False).look(top)
    np.testing.assert_array_equal(with_shadow.things, without.things)
    gray = [picture.colour.astype(int).sum(axis=2) for picture in (with_shadow, without)]
    darker = gray[0] < gray[1] - 30
    assert (gray[0] <= gray[1]).all()
    floor = darker & (with_shadow.things == NOTHING)
    columns = np.nonzero(floor[30:90])[1]
    assert floor.sum() > 100
    assert columns.max() < np.nonzero(with_shadow.things == 0)[1].max()  # to the lamp's other side


def test_faces_are_shaded_by_their_slope():
    picture = RoomRenderer(room_with(block(0.5, 2.5, 2.2, 0.0))).look(camera(pitch=-20.0))
    levels = np.unique(picture.colour[picture.things == 0][:, 0] // 8)
    assert len(levels) >= 3


def test_a_pattern_goes_with_its_thing():
    """Camera and thing turned and moved alike: the same picture of it."""
    checks = Material((220.0, 220.0, 220.0), (40.0, 40.0, 40.0), "checks", 0.1)
    here, there = block(0.4, 2.0, 2.0, 1.0, material=checks), block(0.4, 2.0, 2.0, 1.0, 90.0, checks)
    one = RoomRenderer(room_with(here)).look(Camera(0.8, 2.0, 1.6, 0.0, -20.0, 40.0, 64, 64))
    two = RoomRenderer(room_with(there)).look(Camera(2.0, 0.8, 1.6, 90.0, -20.0, 40.0, 64, 64))
    np.testing.assert_array_equal(one.things, two.things)
    seen = one.things == 0
    difference = np.abs(one.colour.astype(int) - two.colour)[seen].max(axis=1)
    assert (difference > 3).mean() < 0.01
    assert np.ptp(one.colour[seen][:, 0].astype(int)) > 100
