"""Scenes and splits as usual with AI2-THOR; what stands in the rooms that stand in for them."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from activelsd.envs.thor.scenes import ROOM_TYPES, SCENES, SPLITS, place_of, scenes
from activelsd.envs.thor.settings import THORSettings
from activelsd.envs.thor.standin_scenes import RADIUS, furnished, object_type
from activelsd.errors import ConfigError
from activelsd.scenery.rooms.floor_grid import draw_floor_grid
from activelsd.scenery.rooms.footprints import overlap
from activelsd.scenery.rooms.layout import FLOOR
from activelsd.scenery.rooms.supports import Supports

SOME = SCENES[::15]
CLASSES = THORSettings().classes


def test_splits_part_the_scenes_of_each_room_type():
    for room_type in ROOM_TYPES:
        parts = [scenes([room_type], split) for split in SPLITS]
        assert [len(part) for part in parts] == [20, 5, 5]
        assert len({scene for part in parts for scene in part}) == 30
    assert sorted(SCENES) == sorted(scene for split in SPLITS for scene in scenes(ROOM_TYPES, split))


def test_names_are_thors():
    assert scenes(["kitchen"], "train")[:2] == ("FloorPlan1", "FloorPlan2")
    assert scenes(["bathroom", "living_room"], "test")[4:6] == ("FloorPlan430", "FloorPlan226")
    assert place_of("FloorPlan305_physics") == ("bedroom", 5)
    assert all(scenes([place_of(scene)[0]], "train") for scene in SCENES)


@pytest.mark.parametrize(
    ("ask", "hint"),
    [
        (lambda: place_of("FloorPlan31"), "did you mean FloorPlan3"),
        (lambda: place_of("FloorPlan101"), "did you mean FloorPlan"),
        (lambda: place_of("house"), "FloorPlan1 to 30"),
        (lambda: place_of("FloorPlan0"), "did you mean FloorPlan"),
    ],
)
def test_what_is_unknown_is_refused_with_what_was_meant(ask, hint):
    with pytest.raises(ConfigError, match=hint.replace("?", r"\?")):
        ask()


@pytest.fixture(scope="module", params=SOME)
def room(request):
    return furnished(request.param)


def test_a_room_has_things_of_many_classes_and_others(room):
    types = [object_type(thing.model.kind) for thing in room.things[room.furniture :]]
    targets = [name for name in types if name in CLASSES]
    assert 8 <= len(targets) <= 14
    assert len(set(targets)) >= 8
    assert len(types) - len(targets) >= 4
    assert not {object_type(thing.model.kind) for thing in room.things[: room.furniture]} & set(CLASSES)


def test_an_agent_can_walk_in_it(room):
    assert 40 <= len(draw_floor_grid(room, step=0.25, radius=RADIUS).points) <= 120


def test_things_stand_on_something_and_in_nothing(room):
    supports = [Supports(thing.model) for thing in room.things[: room.furniture]]
    small = room.things[room.furniture :]
    for i, thing in enumerate(small):
        if thing.on == FLOOR:
            assert thing.z == 0.0
        else:
            piece = room.things[thing.on]
            x, y = piece.footprint.local((thing.x, thing.y))
            base = thing.footprint._replace(x=float(x), y=float(y), yaw=thing.yaw - piece.yaw)
            assert supports[thing.on].holds(base, thing.z, thing.model.size[2])
        for other in small[:i]:
            apart = thing.z >= other.top or other.z >= thing.top
            assert apart or not overlap(thing.footprint, other.footprint)


def test_televisions_are_not_put_on_the_floor_and_cans_for_garbage_are(room):
    for thing in room.things[room.furniture :]:
        if thing.model.kind in ("television", "garbage_can"):
            assert (thing.on == FLOOR) is (thing.model.kind == "garbage_can")


def test_a_scene_is_the_same_whenever_asked_for():
    one, same = furnished("FloorPlan207"), furnished("FloorPlan207")
    assert [thing[1:] for thing in one.things] == [thing[1:] for thing in same.things]
    assert [thing.model.name for thing in one.things] == [thing.model.name for thing in same.things]
    for thing, other in zip(one.things, same.things, strict=True):
        np.testing.assert_array_equal(thing.model.mesh.vertices, other.model.mesh.vertices)


@pytest.mark.slow
def test_every_class_stands_in_many_rooms_as_other_things():
    standing = {split: Counter() for split in SPLITS}
    names = {split: set() for split in SPLITS}
    for split in SPLITS:
        for scene in scenes(ROOM_TYPES, split):
            room = furnished(scene)
            small = room.things[room.furniture :]
            standing[split].update({object_type(thing.model.kind) for thing in small})
            names[split] |= {thing.model.name for thing in small}
    for name in CLASSES:
        assert standing["train"][name] >= 40
        assert standing["val"][name] >= 8
        assert standing["test"][name] >= 8
    assert names["train"].isdisjoint(names["test"] | names["val"])
