"""A stand-in room in AI2-THOR's terms: its axes, its object names, and what is visible from a pose.

THOR's x is the room's x, its z is the room's y, and its y is up; headings are degrees clockwise from +z.
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
"""Height of the agent's centre above the floor in metres."""

EYE = 0.675
"""Height of the camera above the agent's centre in metres if it stands; 0 if it crouches."""

_SAMPLES = 24  # surface points per object that are tested for visibility


class StandInPose(NamedTuple):
    """The agent's pose in THOR's axes."""

    x: float
    z: float  # metres
    rotation: float  # degrees clockwise seen from above, 0 along +z, in [0, 360)
    horizon: float  # downward tilt of the camera in degrees
    standing: bool

    @property
    def eye(self) -> float:
        """Height of the camera above the floor in metres."""
        return AGENT_Y + EYE * self.standing


class StandInRoom:
    """The room of a scene.

    Attributes:
        ids: THOR's objectId of each object in the room, `Type|x|y|z`.
        reachable: float64 (N, 2), x and z of the points that the agent can reach.
    """

    def __init__(self, scene: str, grid: float) -> None:
        """Builds the room. Raises ConfigError if there is no such scene."""
        self._room: Room = furnished(scene)
        self._renderer = RoomRenderer(self._room)
        lattice = draw_floor_grid(self._room, step=grid, radius=RADIUS)
        middle = np.median(lattice.cells, axis=0).astype(np.int64)
        # the origin is a grid point near the middle, so that all coordinates are multiples of the step
        self._origin = lattice.points[0] + (middle - lattice.cells[0]) * grid
        self.reachable: NDArray[np.float64] = (lattice.cells - middle) * grid
        self._boxes = [_box(thing, self._origin) for thing in self._room.things]  # (2, 3) low and high
        self.ids: tuple[str, ...] = tuple(
            "|".join([object_type(thing.model.kind), *(f"{x:+06.2f}" for x in box.mean(axis=0))])
            for thing, box in zip(self._room.things, self._boxes, strict=True)
        )
        self._records = [self._record(i) for i in range(len(self.ids))]
        self._samples = np.stack([_surface(thing) for thing in self._room.things])  # (N, S, 3) in the room
        # the same image is often needed again, for example after a blocked step
        self._look = lru_cache(maxsize=2)(self._render)

    @property
    def start(self) -> tuple[float, float]:
        """The reachable point closest to the origin."""
        x, z = self.reachable[np.square(self.reachable).sum(axis=1).argmin()].tolist()
        return x, z

    def fits(self, start: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether the agent can move straight from start to end without a collision."""
        points = np.array([start, end]) + self._origin
        return bool(clear(self._room, points[:1], points[1:], RADIUS)[0])

    def look(self, pose: StandInPose, fov: float, width: int, height: int) -> Picture:
        """The image of the agent's camera, with vertical field of view `fov` in degrees."""
        return self._look(self._camera(pose, fov, width, height))

    def _render(self, camera: Camera) -> Picture:
        picture = self._renderer.look(camera)
        for array in picture:
            array.flags.writeable = False  # events share it
        return picture

    def objects(self, pose: StandInPose, fov: float, aspect: float, reach: float) -> list[dict[str, Any]]:
        """THOR's record of every object; an object in the image within `reach` metres is visible."""
        here = np.array([pose.x, AGENT_Y, pose.z])
        distances = [math.dist(here, box.mean(axis=0)) for box in self._boxes]
        near = [i for i, distance in enumerate(distances) if distance <= reach]
        visible = self._visible(pose, fov, aspect, near)
        return [
            record | {"visible": i in visible, "distance": distances[i]}
            for i, record in enumerate(self._records)
        ]

    def _visible(self, pose: StandInPose, fov: float, aspect: float, near: list[int]) -> set[int]:
        """Those of the objects `near` that have a surface point in the image that is not occluded."""
        camera = self._camera(pose, fov, 1, 1)
        eye = np.array([camera.x, camera.y, camera.z])
        points = self._samples[near].reshape(-1, 3)
        x, y, ahead = camera.axes @ (points - eye).T
        limit = ahead * math.tan(math.radians(fov) / 2)
        inside = (ahead > 0) & (np.abs(y) < limit) & (np.abs(x) < limit * aspect)
        wanted = np.repeat(near, _SAMPLES)[inside]
        met = self._renderer.met(eye.astype(np.float32), points[inside].astype(np.float32))
        return set(met[met == wanted].tolist())

    def _camera(self, pose: StandInPose, fov: float, width: int, height: int) -> Camera:
        x, y = np.add(self._origin, (pose.x, pose.z)).tolist()
        return Camera(x, y, pose.eye, 90.0 - pose.rotation, -pose.horizon, fov, width, height)

    def _record(self, index: int) -> dict[str, Any]:
        """The constant part of an object's record."""
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
    """x, y and z as a dict, as in THOR's metadata."""
    return dict(zip("xyz", values.tolist(), strict=True))


def _corners(thing: Placed) -> NDArray[np.float64]:
    """Corners (M, 3, 3) of an object's faces, in room coordinates."""
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
    """Minimum and maximum (2, 3) x, y and z of an object in THOR's axes."""
    points = _corners(thing).reshape(-1, 3) - (*origin, 0.0)
    return np.stack([points.min(axis=0), points.max(axis=0)])[:, [0, 2, 1]]


def _surface(thing: Placed) -> NDArray[np.float64]:
    """Centres (S, 3) of an object's faces in room coordinates, sampled in proportion to area."""
    corners = _corners(thing)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    faces = np.searchsorted(np.cumsum(areas), shares * areas.sum())
    middles: NDArray[np.float64] = corners[faces].mean(axis=1)
    return middles
