"""The contents of a scene's stand-in room: furniture, objects of THOR's classes, and look-alikes.

They depend only on the scene's name. Furniture may be in several scenes, but each small object is in one, so
that classes must be recognised on objects that were not seen in training.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from activelsd.envs.thor.scenes import ROOM_TYPES, place_of
from activelsd.errors import DataError
from activelsd.scenery.rooms import household
from activelsd.scenery.rooms.fittings import Fitted
from activelsd.scenery.rooms.floor_grid import draw_floor_grid
from activelsd.scenery.rooms.household import household_thing
from activelsd.scenery.rooms.layout import FLOOR, Room, furnish, set_down, set_out
from activelsd.scenery.rooms.models import Model
from activelsd.scenery.rooms.smallthings import small_thing

RADIUS = 0.2
"""Radius of the agent in metres, seen from above."""

_GRID = 0.25  # metres
_POINTS = (40, 120)  # least and most grid points where the agent can stand


class _Furnishing(NamedTuple):
    """The contents of the rooms of one type."""

    needed: tuple[str, ...]  # furniture in all rooms
    others: tuple[str, ...]  # furniture in some rooms
    pieces: tuple[int, int]  # least and most pieces of furniture
    sides: tuple[float, float]  # shortest and longest side in metres
    always: tuple[str, ...]  # classes in all rooms
    at_times: tuple[str, ...]  # classes in about half of the rooms


_FURNISHINGS = {
    "kitchen": _Furnishing(
        ("counter", "fridge", "stove", "table"),
        ("counter", "chair", "chair", "night_stand", "bookshelf", "dresser"),
        (6, 8),
        (3.5, 4.6),
        ("Apple", "Bowl", "Toaster", "SoapBottle", "GarbageCan", "HousePlant", "Box", "Book"),
        ("Toaster", "Apple", "AlarmClock", "Candle", "Laptop", "Television"),
    ),
    "living_room": _Furnishing(
        ("sofa", "coffee_table", "tv_stand"),
        ("armchair", "bookshelf", "desk", "floor_lamp", "mantel", "table", "piano", "dresser"),
        (6, 7),
        (3.6, 4.6),
        ("Television", "Laptop", "Book", "Box", "Candle", "HousePlant", "Bowl", "GarbageCan"),
        ("Apple", "AlarmClock", "Toaster", "SoapBottle", "Apple", "Toaster"),
    ),
    "bedroom": _Furnishing(
        ("bed", "night_stand", "dresser"),
        ("night_stand", "desk", "chair", "wardrobe", "bookshelf", "armchair", "tv_stand", "bench"),
        (6, 8),
        (3.6, 4.6),
        ("AlarmClock", "Laptop", "Book", "Box", "Television", "Candle", "GarbageCan", "HousePlant"),
        ("Apple", "Bowl", "Toaster", "SoapBottle", "AlarmClock", "Toaster"),
    ),
    "bathroom": _Furnishing(
        ("basin", "toilet", "bathtub"),
        ("dresser", "bookshelf", "bench", "night_stand", "chair"),
        (5, 6),
        (3.2, 4.0),
        ("SoapBottle", "Candle", "GarbageCan", "HousePlant", "AlarmClock", "Box", "Bowl", "Book"),
        ("Apple", "Toaster", "Laptop", "SoapBottle", "Apple", "Toaster"),
    ),
}

_KINDS = {
    "AlarmClock": ("alarm_clock",),
    "Apple": ("apple",),
    "Book": ("lying_book", "book"),
    "Bowl": ("bowl", "dish", "dish"),
    "Box": ("cardboard_box",),
    "Candle": ("candle",),
    "GarbageCan": ("garbage_can",),
    "HousePlant": ("house_plant", "house_plant", "tall_plant"),
    "Laptop": ("laptop", "notebook", "notebook"),
    "SoapBottle": ("soap_bottle",),
    "Television": ("television",),
    "Toaster": ("toaster",),
}
"""For each class, the kinds that an object is drawn from."""

_CLUTTER = (
    "ball", "bottle", "can", "cup", "loudspeaker", "microwave", "picture_frame", "planter", "radio",
    "tall_planter", "tin", "tissue_box", "vase",
)  # fmt: skip
_CLUTTERED = (4, 7)  # least and most of `_CLUTTER` in a room

_ON_FLOOR = frozenset({"garbage_can", "tall_plant", "tall_planter"})
_LARGE = frozenset({"microwave", "television"})
_BOARDS = (
    "basin", "bench", "coffee_table", "counter", "desk", "dresser", "mantel", "night_stand", "piano",
    "stove", "table", "tv_stand",
)  # fmt: skip
"""Furniture that large objects are put on, with their fronts towards the room."""

_TYPES = {
    "armchair": "ArmChair",
    "bookshelf": "ShelvingUnit",
    "counter": "CounterTop",
    "mantel": "Fireplace",
    "night_stand": "SideTable",
    "planter": "Pot",
    "stove": "Oven",
    "table": "DiningTable",
    "tall_planter": "Pot",
    "tv_stand": "TVStand",
}
"""THOR's object types that cannot be derived from the kind."""


def object_type(kind: str) -> str:
    """THOR's object type for a kind, whether it is a class or not."""
    for name, kinds in _KINDS.items():
        if kind in kinds:
            return name
    return _TYPES.get(kind) or "".join(word.capitalize() for word in kind.split("_"))


def furnished(scene: str) -> Room:
    """The stand-in room of a scene; it is always the same.

    Raises:
        ConfigError: there is no such scene.
    """
    room_type, number = place_of(scene)
    index = 100 * ROOM_TYPES.index(room_type) + number
    style = _FURNISHINGS[room_type]
    things = _things(style, index)
    for attempt in itertools.count():
        room = _attempt(style, things, (index, attempt))
        if room is not None:
            return room
    raise AssertionError


def _things(style: _Furnishing, index: int) -> list[Model]:
    """The objects of the classes, then the clutter; no two scenes share an object number."""
    rng = np.random.default_rng(index)
    names = [*style.always, *(name for name in style.at_times if rng.random() < 0.5)]
    kinds = [str(rng.choice(_KINDS[name])) for name in names]
    clutter = rng.permutation(_CLUTTER)[: int(rng.integers(_CLUTTERED[0], _CLUTTERED[1] + 1))]
    # small objects come in families of four that differ only in the label; take at most one of a family
    return [
        _thing(str(kind), 4 * (32 * index + i) + int(rng.integers(4)))
        for i, kind in enumerate([*kinds, *clutter])
    ]


def _thing(kind: str, number: int) -> Model:
    return household_thing(kind, number) if kind in household.KINDS else small_thing(kind, number)


def _attempt(style: _Furnishing, things: list[Model], seed: tuple[int, int]) -> Room | None:
    """The room of a seed; None if something does not fit or the agent has too little or too much space."""
    rng = np.random.default_rng(seed)
    width, depth = (float(side) for side in rng.uniform(*style.sides, 2))
    pieces = int(rng.integers(style.pieces[0], style.pieces[1] + 1))
    others = rng.permutation(style.others)[: pieces - len(style.needed)].tolist()
    kinds = [*style.needed, *others]
    large = [thing for thing in things if thing.kind in _LARGE]
    standing = [thing for thing in things if thing.kind in _ON_FLOOR]
    small = [thing for thing in things if thing.kind not in _LARGE | _ON_FLOOR]
    try:
        room = furnish(Fitted(), seed, pieces=len(kinds), size=(width, depth), kinds=kinds)
        if sorted(piece.model.kind for piece in room.things) != sorted(kinds):
            return None  # one kind did not fit, and another is there twice
        if _points(room) > _POINTS[1]:
            return None
        room = set_out(room, large, seed, on=_BOARDS, turned=10.0, laid=0.0)
        if any(thing.on == FLOOR for thing in room.things[room.furniture :]):
            return None
        room = set_out(set_down(room, standing, seed), sorted(small, key=_sort_key), seed, laid=0.0)
    except DataError:
        return None
    return room if _points(room) >= _POINTS[0] else None


def _points(room: Room) -> int:
    return len(draw_floor_grid(room, step=_GRID, radius=RADIUS).points)


def _sort_key(thing: Model) -> float:
    """Sorts objects by floor area, largest first."""
    return -thing.size[0] * thing.size[1]
