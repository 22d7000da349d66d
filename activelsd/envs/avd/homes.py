"""The homes of the sample scans: rooms that stand in for the Active Vision Dataset's, and what is in them.

A home is one furnished room. Its scans share the furniture and differ in where the instances stand.
"""

from __future__ import annotations

import itertools
import math
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import ConfigError
from activelsd.scenery.rooms.floor_grid import FloorGrid, draw_floor_grid
from activelsd.scenery.rooms.layout import Room, furnish, set_out
from activelsd.scenery.rooms.library import Embedded
from activelsd.scenery.rooms.models import Model
from activelsd.scenery.rooms.room_renderer import Camera, Picture, RoomRenderer
from activelsd.scenery.rooms.smallthings import KINDS, small_thing

DEFAULT_SCANS: tuple[str, ...] = tuple(f"Home_{home:03d}_1" for home in range(1, 21))
"""Many small homes: with few of them an agent memorises where each instance stands."""

_COUNTS = {
    "book": 3, "bottle": 4, "bowl": 2, "box": 4, "can": 4, "carton": 4, "cup": 4, "laptop": 1, "radio": 1,
    "tin": 3, "vase": 3,
}  # fmt: skip

INSTANCES: tuple[str, ...] = tuple(
    small_thing(kind, number).name for kind, count in _COUNTS.items() for number in range(count)
)
"""Names of the 33 instances; the id of each is its place, from 1. What stands before `_N` is its category."""

HEADINGS = 12
"""Photographs at a point, each 30 degrees clockwise of the one before; the first looks along x."""

MOVES = ("rotate_ccw", "rotate_cw", "forward", "backward", "left", "right")

_TURNED = {"forward": 0, "left": 90, "backward": 180, "right": 270}  # degrees from the heading
_STANDING = 24  # instances in a scan, consecutive in INSTANCES, so that some look alike
_STRIDE = 14  # offset of the next home's: homes 1 to 5 have each instance twice or more
_CLUTTER = 2  # other small things in a scan
_STEP, _RADIUS = 0.3, 0.2  # metres
_FREE = (34, 48)  # points of the grid
_EYE, _PITCH = 1.3, -12.0  # metres above the floor, degrees
_FOCAL = 1070 / 1920  # of the picture's width
_SCAN = re.compile(r"(Home|Office|Gen)_(\d{3})_([1-9])")
_PLACES = ("Home", "Office", "Gen")


class ScanName(NamedTuple):
    """The parts of a scan's name."""

    place: int  # 0 Home, 1 Office, 2 Gen
    scene: int
    scan: int

    def image(self, index: int, kind: str) -> str:
        """The 15 digits of a file's name.

        Args:
            index: counts the scan's images from 1.
            kind: 01 colour, 03 depth registered to it.
        """
        return f"{self.place}{self.scene:03d}{self.scan}{index:06d}01{kind}"


def parsed(name: str) -> ScanName:
    """The parts of a scan's name.

    Raises:
        ConfigError: it is not like Home_001_1.
    """
    found = _SCAN.fullmatch(name)
    if found is None:
        raise ConfigError(f"'{name}' cannot be a scan; scans are named like Home_001_1 or Office_001_1.")
    return ScanName(_PLACES.index(found[1]), int(found[2]), int(found[3]))


class Home:
    """A scan's room, ready to be photographed.

    Attributes:
        room: the furniture and things with their places.
        lattice: the points that are photographed, each in all headings.
        instance_of: int32 (things + 1,), the id of the instance that a thing is, 0 for others; the last entry
            is for NOTHING.
    """

    def __init__(self, name: str, seed: int) -> None:
        """Furnish it and put the instances out. Raises ConfigError if the name cannot be a scan's."""
        scan = parsed(name)
        home = (seed, scan.place, scan.scene)
        small = _instances(scan) + _clutter((*home, scan.scan))
        self.room: Room = set_out(_furnished(home), small, (*home, scan.scan))
        self.lattice: FloorGrid = draw_floor_grid(self.room, step=_STEP, radius=_RADIUS)
        names = [thing.model.name for thing in self.room.things]
        ids = [INSTANCES.index(name) + 1 if name in INSTANCES else 0 for name in names]
        self.instance_of: NDArray[np.int32] = np.array([*ids, 0], np.int32)
        self._renderer = RoomRenderer(self.room)

    @property
    def present(self) -> list[str]:
        """Names of the instances that stand in it, in order of their ids."""
        return [INSTANCES[i - 1] for i in sorted(self.instance_of[self.instance_of > 0].tolist())]

    def camera(self, point: int, heading: int, width: int, height: int) -> Camera:
        """The camera at a point of the lattice in one of the headings, which turn clockwise."""
        x, y = self.lattice.points[point].tolist()
        fov = math.degrees(2 * math.atan(height / 2 / (_FOCAL * width)))
        return Camera(x, y, _EYE, _yaw(heading), _PITCH, fov, width, height)

    def look(self, camera: Camera) -> Picture:
        """What the camera sees."""
        return self._renderer.look(camera)

    def move(self, point: int, heading: int, move: str) -> tuple[int, int] | None:
        """Point and heading that a move leads to, None if it is blocked.

        A step goes along the axis of the grid that is nearest to its direction, never more than 30 degrees
        off it; so each step can be taken back, and three headings share a way.
        """
        if move == "rotate_cw":
            return point, (heading + 1) % HEADINGS
        if move == "rotate_ccw":
            return point, (heading - 1) % HEADINGS
        axis = round((_yaw(heading) + _TURNED[move]) / 90) % 4
        there = int(self.lattice.neighbours[point, 2 * axis])
        return None if there < 0 else (there, heading)


def _yaw(heading: int) -> float:
    return -360.0 / HEADINGS * heading


def _furnished(home: tuple[int, ...]) -> Room:
    """The first room of a home's seeds that leaves as many points as a small recorded home has."""
    for attempt in itertools.count():
        room = furnish(Embedded(), (*home, attempt))
        if _FREE[0] <= len(draw_floor_grid(room, step=_STEP, radius=_RADIUS).points) <= _FREE[1]:
            return room
    raise AssertionError


def _instances(scan: ScanName) -> list[Model]:
    """The instances in a scan; the next scan of the same home has those that follow."""
    first = _STRIDE * scan.scene + _STANDING * (scan.scan - 1) + scan.place
    things = [(kind, number) for kind, count in _COUNTS.items() for number in range(count)]
    return [small_thing(*things[(first + i) % len(things)]) for i in range(_STANDING)]


def _clutter(seed: tuple[int, ...]) -> list[Model]:
    """Things of kinds that no instance has."""
    rng = np.random.default_rng(seed)
    return [small_thing(str(rng.choice(KINDS)), int(rng.integers(4, 16))) for _ in range(_CLUTTER)]
