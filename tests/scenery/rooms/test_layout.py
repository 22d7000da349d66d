"""What stands where: nothing in anything else, small things on real surfaces, replayed by a seed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from activelsd.errors import DataError
from activelsd.scenery.rooms.footprints import Rect, overlap
from activelsd.scenery.rooms.layout import FLOOR, furnish, set_down, set_out
from activelsd.scenery.rooms.library import Embedded
from activelsd.scenery.rooms.models import Model
from activelsd.scenery.rooms.smallthings import KINDS, small_thing
from activelsd.scenery.rooms.supports import Supports, triangles_in_box
from activelsd.scenery.rooms.textures import Material
from activelsd.scenery.shapes.solids import box, join, shift, turn

SEEDS = range(6)


def draw(seed, **options):
    room = furnish(Embedded(), seed, **options)
    return set_out(room, [small_thing(KINDS[i % len(KINDS)], i) for i in range(16)], seed)


@pytest.fixture(scope="module", params=SEEDS)
def room(request):
    return draw(request.param)


def placed_mesh(thing):
    mesh = shift(turn(thing.model.mesh, thing.yaw), (thing.x, thing.y, thing.z))
    return mesh.vertices[mesh.faces].astype(np.float64)


def test_rooms_are_furnished_and_replayed(room):
    assert 6 <= room.furniture <= 12
    assert len(room.things) == room.furniture + 16
    assert all(3.4 <= side <= 4.6 for side in (room.plan.width, room.plan.depth))
    assert {opening.kind for opening in room.plan.openings} == {"door", "window"}


def test_a_seed_replays_a_room():
    one, same, other = draw(3), draw(3), draw(4)
    assert [t[1:] for t in one.things] == [t[1:] for t in same.things]
    assert [t.model.name for t in one.things] == [t.model.name for t in same.things]
    assert [t[1:] for t in one.things] != [t[1:] for t in other.things]


def test_everything_is_inside_the_walls(room):
    for thing in room.things:
        points = placed_mesh(thing).reshape(-1, 3)
        assert (points > -1e-4).all()
        assert (points < np.array([room.plan.width, room.plan.depth, room.plan.height])).all()


def test_furniture_does_not_interpenetrate(room):
    """By points sampled on each piece's surface against the others' rectangles."""
    pieces = room.things[: room.furniture]
    for i, piece in enumerate(pieces):
        corners = placed_mesh(piece)
        weights = np.random.default_rng(0).dirichlet((1, 1, 1), size=(len(corners), 8))
        points = (weights[..., None] * corners[:, None]).sum(axis=2)[..., :2].reshape(-1, 2)
        for j, other in enumerate(pieces):
            if i != j:
                own = np.abs(other.footprint.local(points))
                inside = own < (other.footprint.half_x, other.footprint.half_y)
                assert not inside.all(axis=1).any()


def test_furniture_by_the_wall_faces_into_the_room(room):
    """Its front, -y, looks at the middle rather than at the wall behind."""
    for piece in room.things[: room.furniture]:
        if piece.yaw % 90 == 0:
            angle = np.radians(piece.yaw - 90)
            ahead = np.array([piece.x, piece.y]) + 0.3 * np.array([np.cos(angle), np.sin(angle)])
            edges = [*ahead, *(np.array([room.plan.width, room.plan.depth]) - ahead)]
            assert min(edges) > 0.2


def test_doors_are_free(room):
    for opening in room.plan.openings:
        if opening.kind == "door":
            zone = room.plan.before(opening, 0.75)
            assert not any(overlap(zone, thing.footprint) for thing in room.things if thing.on == FLOOR)


def test_small_things_touch_what_they_stand_on(room):
    """Rays of another library, from the middle of the thing's base and from around it."""
    carried = [thing for thing in room.things[room.furniture :] if thing.on != FLOOR]
    assert len(carried) >= 10
    for thing in carried:
        mesh = trimesh.Trimesh(
            *trimesh.triangles.to_kwargs(placed_mesh(room.things[thing.on])).values(), process=False
        )
        rect = thing.footprint
        shares = 0.95 * np.array([(0, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)], float)
        starts = np.column_stack([rect.points(shares), np.full(5, thing.z + 0.004)])
        hits, rays, _ = mesh.ray.intersects_location(starts, np.tile((0.0, 0.0, -1.0), (5, 1)))
        gaps = [starts[i, 2] - hits[rays == i, 2].max() - 0.004 for i in range(5)]
        assert np.abs(gaps).max() < 0.003


def test_small_things_are_in_nothing(room):
    """Neither in the furniture that carries them nor in one another."""
    small = room.things[room.furniture :]
    for i, thing in enumerate(small):
        rect = thing.footprint
        for piece in room.things[: room.furniture]:
            assert not triangles_in_box(placed_mesh(piece), rect, thing.z + 0.004, thing.top).any()
        for other in small[:i]:
            assert not (overlap(rect, other.footprint) and thing.z < other.top and other.z < thing.top)


def test_scans_of_a_room_share_the_furniture():
    room = furnish(Embedded(), 5)
    things = [small_thing("can", 0), small_thing("cup", 1)]
    one, other = set_out(room, things, 1), set_out(room, things, 2)
    assert one.things[: room.furniture] == other.things[: room.furniture]
    assert one.things[-1][1:] != other.things[-1][1:]


def test_things_are_put_where_they_are_wanted():
    """On some kinds of furniture, facing about as that does, after others; or on the floor."""
    room = furnish(Embedded(), 1, kinds=["desk", "table", "sofa", "dresser", "bed", "night_stand"])
    once = set_out(
        room, [small_thing("can", i) for i in range(8)], 2, on=("desk", "table"), turned=5.0, laid=0.0
    )
    both = set_down(
        set_out(once, [small_thing("cup", i) for i in range(4)], 3), [small_thing("radio", 1)] * 2, 4
    )
    cans = once.things[once.furniture :]
    assert {once.things[can.on].model.kind for can in cans} <= {"desk", "table"}
    assert all(abs(can.yaw - once.things[can.on].yaw) <= 5.0 for can in cans)
    assert both.things[: len(once.things)] == once.things
    assert all(thing.on == FLOOR and thing.z == 0.0 for thing in both.things[-2:])
    small = both.things[both.furniture :]
    for i, thing in enumerate(small):
        for other in small[:i]:
            apart = thing.z >= other.top or other.z >= thing.top
            assert apart or not overlap(thing.footprint, other.footprint)


def test_what_does_not_fit_is_refused():
    with pytest.raises(DataError, match=r"9 pieces.*ask for fewer"):
        furnish(Embedded(), 0, pieces=9, size=(2.0, 2.0), kinds=["night_stand", "chair"])
    small = furnish(Embedded(), 0, pieces=1, size=(2.0, 2.0), kinds=["night_stand"])
    with pytest.raises(DataError, match="no place left"):
        set_out(small, [small_thing("box", i) for i in range(200)], 0)


def cupboard():
    """A closed box 1 m high with a shelf inside, beside an open shelf at 0.5 m."""
    mesh = join(
        [
            box((-1, -0.3, 0.0), (0, 0.3, 1.0)),
            box((-1, -0.3, 0.5), (0, 0.3, 0.52)),
            box((0, -0.3, 0.5), (1, 0.3, 0.52)),
            box((0.6, -0.2, 0.52), (0.64, 0.3, 0.9)),
        ]
    )
    paint = np.zeros(len(mesh.faces), np.int32)
    return Supports(Model("cupboard", 0, mesh, paint, (Material((1.0, 1.0, 1.0)),)))


@pytest.mark.parametrize(
    ("x", "z", "holds"),
    [
        (-0.5, 1.0, True),  # on top
        (-0.5, 0.52, False),  # shut up inside
        (0.3, 0.52, True),  # on the shelf
        (0.3, 0.6, False),  # in the air above it
        (0.3, 0.5, False),  # on its underside
        (0.95, 0.52, False),  # half over the edge
        (0.62, 0.52, False),  # through the board that stands on it
        (0.57, 0.52, False),  # reaching into that board
    ],
)
def test_supports(x, z, holds):
    assert cupboard().holds(Rect(x, 0.0, 0.06, 0.06, 30.0), z, 0.2) is holds


def test_boxed_agrees_with_points_of_the_triangles():
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (400, 3, 3))
    rect, low, high = Rect(0.1, -0.1, 0.4, 0.3, 25.0), -0.3, 0.4
    found = triangles_in_box(corners, rect, low, high)
    weights = rng.dirichlet((0.7, 0.7, 0.7), size=4000)
    points = np.einsum("pc,mcd->mpd", weights, corners)
    plan = np.abs(rect.local(points[..., :2])) < (rect.half_x, rect.half_y)
    inside = plan.all(axis=2) & (points[..., 2] > low) & (points[..., 2] < high)
    assert not (inside.any(axis=1) & ~found).any()
    assert (found & ~inside.any(axis=1)).sum() < 8  # that only a corner grazes
