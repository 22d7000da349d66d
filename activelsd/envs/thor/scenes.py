"""AI2-THOR's scenes by room type, and their split into train, val and test."""

from __future__ import annotations

import re
from collections.abc import Sequence

from activelsd.errors import ConfigError, did_you_mean

_FIRSTS = {"kitchen": 0, "living_room": 200, "bedroom": 300, "bathroom": 400}
_ROOMS = 30
_SPLITS = {"train": range(1, 21), "val": range(21, 26), "test": range(26, 31)}
_NAME = re.compile(r"FloorPlan([1-9]\d{0,2})(?:_physics)?")

ROOM_TYPES: tuple[str, ...] = tuple(_FIRSTS)
"""Room types; each has 30 scenes."""

SPLITS: tuple[str, ...] = tuple(_SPLITS)
"""Splits by room number, as is usual with these scenes: 1-20 train, 21-25 val, 26-30 test."""

SCENES: tuple[str, ...] = tuple(
    f"FloorPlan{first + i}" for first in _FIRSTS.values() for i in range(1, _ROOMS + 1)
)
"""All 120 scenes, by room type."""


def scenes(room_types: Sequence[str], split: str) -> tuple[str, ...]:
    """The scenes of a split, in the order of the given room types."""
    return tuple(f"FloorPlan{_FIRSTS[room_type] + i}" for room_type in room_types for i in _SPLITS[split])


def place_of(scene: str) -> tuple[str, int]:
    """The room type of a scene and its number within the type, from 1; the name may end in `_physics`.

    Raises:
        ConfigError: there is no such scene.
    """
    match = _NAME.fullmatch(scene)
    if match is not None:
        hundred, number = divmod(int(match[1]), 100)
        for room_type, first in _FIRSTS.items():
            if first == 100 * hundred and 1 <= number <= _ROOMS:
                return room_type, number
    hint = did_you_mean(scene, SCENES, "there are FloorPlan1 to 30, 201 to 230, 301 to 330 and 401 to 430.")
    raise ConfigError(f"There is no scene '{scene}'; {hint}")
