"""AI2-THOR's scenes by room type, which of them train, validate and test, and the classes to tell apart."""

from __future__ import annotations

import re
from collections.abc import Sequence

from activelsd.errors import ConfigError, did_you_mean

CLASSES: tuple[str, ...] = (
    "AlarmClock", "Apple", "Book", "Bowl", "Box", "Candle", "GarbageCan", "HousePlant", "Laptop",
    "SoapBottle", "Television", "Toaster",
)  # fmt: skip
"""Object types that stand in many rooms, the default."""

_FIRSTS = {"kitchen": 0, "living_room": 200, "bedroom": 300, "bathroom": 400}
_ROOMS = 30
_SPLITS = {"train": range(1, 21), "val": range(21, 26), "test": range(26, 31)}
_NAME = re.compile(r"FloorPlan([1-9]\d{0,2})(?:_physics)?")

ROOM_TYPES: tuple[str, ...] = tuple(_FIRSTS)
"""Of each there are 30 scenes."""

SPLITS: tuple[str, ...] = tuple(_SPLITS)
"""By the number of the room: 1-20 train, 21-25 validate, 26-30 test, as is usual with these scenes."""

SCENES: tuple[str, ...] = tuple(
    f"FloorPlan{first + i}" for first in _FIRSTS.values() for i in range(1, _ROOMS + 1)
)
"""All 120, by room type."""


def scenes(room_types: Sequence[str], split: str) -> tuple[str, ...]:
    """The scenes of a split of some room types, in the order of those.

    Raises:
        ConfigError: a room type or the split is unknown.
    """
    if split not in _SPLITS:
        raise ConfigError(f"There is no split '{split}'; {did_you_mean(split, SPLITS)}")
    for room_type in room_types:
        if room_type not in _FIRSTS:
            raise ConfigError(f"There is no room type '{room_type}'; {did_you_mean(room_type, ROOM_TYPES)}")
    return tuple(f"FloorPlan{_FIRSTS[room_type] + i}" for room_type in room_types for i in _SPLITS[split])


def place_of(scene: str) -> tuple[str, int]:
    """The room type of a scene and its number among those, from 1; `_physics` may end its name.

    Raises:
        ConfigError: there is no such scene.
    """
    found = _NAME.fullmatch(scene)
    if found is not None:
        hundred, number = divmod(int(found[1]), 100)
        for room_type, first in _FIRSTS.items():
            if first == 100 * hundred and 1 <= number <= _ROOMS:
                return room_type, number
    hint = did_you_mean(scene, SCENES, "they are FloorPlan1 to 30, 201 to 230, 301 to 330 and 401 to 430.")
    raise ConfigError(f"There is no scene '{scene}'; {hint}")
