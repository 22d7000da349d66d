"""A stand-in room as AI2-THOR speaks of it: its axes, its names for things, what can be seen from a pose.

THOR's x is the room's x, its z the room's y, its y is up; a heading is in degrees clockwise from +z.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.thor.standin_scenes import RADIUS, furnished, object_type
from activelsd.scenery.rooms.floor_grid import clear, draw_floor_grid
from activelsd.scenery.rooms.layout import FLOOR, Placed, Room
from activelsd.scenery.rooms.room_renderer import Camera, Picture, RoomRenderer

AGENT_Y = 0.901
"""Metres of the agent's middle above the floor."""

EYE = 0.675
"""Metres of the camera above the agent's middle when it stands; when it crouches, none."""

_SAMPLES = 24  # points of a thing's surface that are looked for


class StandInPose(NamedTuple):
    """Where the agent is, in THOR's axes."""

    x: float
    z: float  # metres
    rotation: float  # degrees clockwise seen from above, 0 along +z, in [0, 360)
    horizon: float  # degrees that the camera looks down
    standing: bool

    @property
    def eye(self) -> float:
        """Metres of the camera above the floor."""
        return AGENT_Y + EYE * self.standing


class StandInRoom:
    """A scene's room, ready to be asked about.

    Attributes:
        ids: what THOR would call each of the room's things, `Type|x|y|z`.
        reachable: float64 (N, 2), x and z of the points where the agent can walk to.
    """

    def __init__(self, scene: str, grid: float) -> None:
        """Build it. Raises ConfigError where there is no such scene."""
        self._room: Room = furnished(scene)
        self._renderer = RoomRenderer(self._room)
        lattice = draw_floor_grid(self._room, step=grid, radius=RADIUS)
        middle = np.median(lattice.cells, axis=0).astype(np.int64)
        # a point of the grid in the middle is the origin, so that all of them are multiples of its step
        self._origin = lattice.points[0] + (middle - lattice.cells[0]) * grid
        self.reachable: NDArray[np.float64] = (lattice.cells - middle) * grid
        self._boxes = [_box(thing, self._origin) for thing in self._room.things]  # (2, 3) low and high
        self.ids: tuple[str, ...] = tuple(
            "|".join([object_type(thing.model.kind), *(f"{x:+06.2f}" for x in box.mean(axis=0))])
            for thing, box in zip(self._room.things, self._boxes, strict=True)
        )
        self._records = [self._record(i) for i in range(len(self.ids))]
        self._samples = np.stack([_surface(thing) for thing in self._room.things])  # (N, S, 3) in the room
        # what is asked for again is the same picture, as after a step that was blocked
        self._look = lru_cache(maxsize=2)(self._taken)

    @property
    def start(self) -> tuple[float, float]:
        """The reachable point nearest to the origin."""
        x, z = self.reachable[np.square(self.reachable).sum(axis=1).argmin()].tolist()
        return x, z

    def fits(self, start: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether the agent can stand at the end and meets nothing on the way there."""
        ways = np.array([start, end]) + self._origin
        return bool(clear(self._room, ways[:1], ways[1:], RADIUS)[0])

    def look(self, pose: StandInPose, fov: float, width: int, height: int) -> Picture:
        """What the agent's camera sees, with that vertical field of view in degrees."""
        return self._look(self._camera(pose, fov, width, height))

    def _taken(self, camera: Camera) -> Picture:
        picture = self._renderer.look(camera)
        for array in picture:
            array.flags.writeable = False  # events share it
        return picture

    def objects(self, pose: StandInPose, fov: float, aspect: float, reach: float) -> list[dict[str, Any]]:
        """THOR's record of every thing; visible are those in the picture and within reach, in metres."""
        here = np.array([pose.x, AGENT_Y, pose.z])
        distances = [math.dist(here, box.mean(axis=0)) for box in self._boxes]
        near = [i for i, distance in enumerate(distances) if distance <= reach]
        seen = self._seen(pose, fov, aspect, near)
        return [
            record | {"visible": i in seen, "distance": distances[i]}
            for i, record in enumerate(self._records)
        ]

    def _seen(self, pose: StandInPose, fov: float, aspect: float, near: list[int]) -> set[int]:
        """Which of the things near have a point on their surface that is in the picture and not covered."""
        camera = self._camera(pose, fov, 1, 1)
        eye = np.array([camera.x, camera.y, camera.z])
        points = self._samples[near].reshape(-1, 3)
        x, y, ahead = camera.axes @ (points - eye).T
        most = ahead * math.tan(math.radians(fov) / 2)
        inside = (ahead > 0) & (np.abs(y) < most) & (np.abs(x) < most * aspect)
        wanted = np.repeat(near, _SAMPLES)[inside]
        met = self._renderer.met(eye.astype(np.float32), points[inside].astype(np.float32))
        return set(met[met == wanted].tolist())

    def _camera(self, pose: StandInPose, fov: float, width: int, height: int) -> Camera:
        x, y = np.add(self._origin, (pose.x, pose.z)).tolist()
        return Camera(x, y, pose.eye, 90.0 - pose.rotation, -pose.horizon, fov, width, height)

    def _record(self, index: int) -> dict[str, Any]:
        """What never changes of a thing's record."""
        thing, (low, high) = self._room.things[index], self._boxes[index]
        corners = [
            [float(x), float(y), float(z)]
            for x in (low[0], high[0])
            for y in (low[1], high[1])
            for z in (low[2], high[2])
        ]
        return {
            "name": f"{object_type(thing.model.kind)}_{index}",
            "objectId": self.ids[index],
            "objectType": object_type(thing.model.kind),
            "position": vector((low + high) / 2),
            "rotation": {"x": 0.0, "y": -thing.yaw % 360.0, "z": 0.0},
            "parentReceptacles": None if thing.on == FLOOR else [self.ids[thing.on]],
            "axisAlignedBoundingBox": {
                "center": vector((low + high) / 2),
                "size": vector(high - low),
                "cornerPoints": corners,
            },
            "objectOrientedBoundingBox": None,
        }


def vector(values: NDArray[np.float64]) -> dict[str, float]:
    """THOR's way to write x, y and z."""
    return dict(zip("xyz", values.tolist(), strict=True))


def _corners(thing: Placed) -> NDArray[np.float64]:
    """Corners (M, 3, 3) of a thing's faces in the room."""
    angle = math.radians(thing.yaw)
    turned = np.array(
        [(math.cos(angle), math.sin(angle), 0), (-math.sin(angle), math.cos(angle), 0), (0, 0, 1)]
    )
    corners: NDArray[np.float64] = thing.model.mesh.vertices[thing.model.mesh.faces] @ turned + (
        thing.x,
        thing.y,
        thing.z,
    )
    return corners


def _box(thing: Placed, origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lowest and highest (2, 3) x, y and z of a thing in THOR's axes."""
    points = _corners(thing).reshape(-1, 3) - (*origin, 0.0)
    return np.stack([points.min(axis=0), points.max(axis=0)])[:, [0, 2, 1]]


def _surface(thing: Placed) -> NDArray[np.float64]:
    """Middles (S, 3) of some of a thing's faces, the larger the more often, in the room."""
    corners = _corners(thing)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    faces = np.searchsorted(np.cumsum(areas), shares * areas.sum())
    middles: NDArray[np.float64] = corners[faces].mean(axis=1)
    return middles
