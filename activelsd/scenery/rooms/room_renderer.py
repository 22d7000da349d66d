"""What a camera sees of a room: colour, the number of the thing and depth at every pixel, by embree's rays.

One ray a pixel and one from there to the lamp. Faces are flat and seen from both sides, as the winding of
meshes from files cannot be trusted.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.scenery.rays import dot, face_normals, scene_of
from activelsd.scenery.rooms.layout import Placed, Room
from activelsd.scenery.rooms.textures import Palette
from activelsd.scenery.shapes.solids import shift, turn

NOTHING = -1
"""In place of a thing's number: walls, floor, ceiling, and the sky beyond a window."""

SKY = (206, 222, 236)
AMBIENT, LAMP, HEAD = 0.42, 0.85, 0.12
"""Light from everywhere, of the lamp at `_REACH` metres and less, and from where the camera is."""

_REACH = 1.5
_OFF = 1e-3  # metres that a ray to the lamp starts off its surface
_STRIP = 24_000  # rays at a time: their arrays stay in the processor's cache


class Camera(NamedTuple):
    """Where a picture is taken from, and how."""

    x: float
    y: float
    z: float  # metres
    yaw: float  # degrees, counter-clockwise seen from above; 0 looks along +x
    pitch: float  # degrees, positive upwards
    fov: float  # degrees, vertical
    width: int
    height: int  # pixels

    @property
    def focal(self) -> float:
        """Focal length in pixels; the principal point is the middle of the picture."""
        return self.height / 2 / math.tan(math.radians(self.fov) / 2)

    @property
    def axes(self) -> NDArray[np.float64]:
        """Rows right, down and forward (3, 3) in the room's coordinates."""
        a, e = math.radians(self.yaw), math.radians(self.pitch)
        right = (math.sin(a), -math.cos(a), 0.0)
        down = (math.sin(e) * math.cos(a), math.sin(e) * math.sin(a), -math.cos(e))
        return np.array([right, down, (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))])


class Picture(NamedTuple):
    """What is seen."""

    colour: NDArray[np.uint8]  # (H, W, 3) red, green, blue
    things: NDArray[np.int32]  # (H, W) numbers among the room's things, or NOTHING
    depth: NDArray[np.float32]  # (H, W) metres along the camera's axis; 0 where there is nothing


class RoomRenderer:
    """Takes pictures of one room; the same bytes for the same camera."""

    def __init__(self, room: Room, *, shadows: bool = True) -> None:
        """Build the scene; without shadows pictures take about two thirds of the time."""
        self._shadows = shadows
        self._lamp = np.array(room.light, np.float32)
        whole = Placed(room.shell, 0.0, 0.0, 0.0, 0.0, NOTHING)
        placed = [*room.things, whole]  # last, so that the number NOTHING finds it
        corners = np.concatenate([_corners(thing) for thing in placed])
        self._scene = scene_of(corners)

        faces = [len(thing.model.mesh.faces) for thing in placed]
        numbers = np.arange(len(placed))
        numbers[-1] = NOTHING
        firsts = np.cumsum([0] + [len(thing.model.materials) for thing in placed[:-1]])
        paints = [thing.model.paint + first for thing, first in zip(placed, firsts, strict=True)]
        self._palette = Palette([m for thing in placed for m in thing.model.materials])
        # by face; one more at the end, so that embree's -1 for a miss finds it
        self._thing_of = np.append(np.repeat(numbers, faces), NOTHING).astype(np.int32)
        self._material_of = np.append(np.concatenate(paints), 0).astype(np.int32)
        self._patterned = self._palette.patterns[self._material_of] > 0
        self._patterned[-1] = False
        self._colour_of = self._palette.colours[self._material_of]
        self._normal_of = np.vstack([face_normals(corners), np.zeros((1, 3))]).astype(np.float32)
        angles = np.radians([thing.yaw for thing in placed])
        self._cos, self._sin = np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
        self._at = np.array([(thing.x, thing.y, thing.z) for thing in placed], np.float32)
        self.triangles = len(corners)

    def look(self, camera: Camera) -> Picture:
        """Take a picture."""
        right, down, forward = camera.axes.astype(np.float32)
        x, y = _grid(camera.width, camera.height, camera.focal)
        eye = np.array([camera.x, camera.y, camera.z], np.float32)
        count = camera.width * camera.height
        colour = np.empty((count, 3), np.uint8)
        things, depth = np.empty(count, np.int32), np.empty(count, np.float32)
        rows = max(1, _STRIP // camera.width)
        for top in range(0, camera.height, rows):
            strip = slice(top * camera.width, min(top + rows, camera.height) * camera.width)
            rays = (forward + y[top : top + rows, None, None] * down) + x[:, None] * right
            self._trace(eye, rays.reshape(-1, 3), colour[strip], things[strip], depth[strip])
        shape = (camera.height, camera.width)
        return Picture(colour.reshape(*shape, 3), things.reshape(shape), depth.reshape(shape))

    def met(self, eye: NDArray[np.float32], towards: NDArray[np.float32]) -> NDArray[np.int32]:
        """Numbers (P,) of the things first met from the eye (3,) towards points (P, 3), or NOTHING."""
        rays = towards - eye
        faces = self._scene.run(np.broadcast_to(eye, rays.shape), rays, output=1)["primID"]
        things: NDArray[np.int32] = self._thing_of[faces]
        return things

    def _trace(
        self,
        eye: NDArray[np.float32],
        rays: NDArray[np.float32],
        colour: NDArray[np.uint8],
        things: NDArray[np.int32],
        depth: NDArray[np.float32],
    ) -> None:
        """Fill colour (P, 3), things (P,) and depth (P,) of rays (P, 3), each 1 long along the axis."""
        found = self._scene.run(np.broadcast_to(eye, rays.shape), rays, output=1)
        face = found["primID"]
        missed = face < 0
        depth[:] = np.where(missed, 0.0, found["tfar"])
        things[:] = self._thing_of[face]
        points = eye + depth[:, None] * rays
        light = self._light(points, rays, self._normal_of[face])
        albedo = self._colour_of[face]
        drawn = np.flatnonzero(self._patterned[face])
        if len(drawn):
            local = self._local(points[drawn], things[drawn])
            albedo[drawn] = self._palette.patterned(self._material_of[face[drawn]], local)
        albedo *= light[:, None]
        np.minimum(albedo, 255.0, out=albedo)
        colour[:] = np.rint(albedo)
        colour[missed] = SKY

    def _light(
        self, points: NDArray[np.float32], rays: NDArray[np.float32], normals: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Light (P,) that falls on points (P, 3) hit by rays (P, 3)."""
        against = -dot(normals, rays)
        side = np.where(against < 0, np.float32(-1), np.float32(1))
        towards = self._lamp - points
        squared = dot(towards, towards)
        lamp = np.maximum(side * dot(normals, towards), 0.0) / np.sqrt(squared)
        lamp /= np.maximum(np.sqrt(squared) / _REACH, 1.0)
        if self._shadows:
            lit = np.flatnonzero(lamp > 0)
            starts = points[lit] + (side[lit] * np.float32(_OFF))[:, None] * normals[lit]
            ways = self._lamp - starts
            near = np.full(len(lit), 0.999, np.float32)
            lamp[lit[self._scene.run(starts, ways, dists=near, query="OCCLUDED") >= 0]] = 0.0
        head = np.abs(against) / np.sqrt(dot(rays, rays))
        overhead = np.float32(AMBIENT) * (np.float32(0.85) + np.float32(0.15) * side * normals[:, 2])
        total: NDArray[np.float32] = overhead + np.float32(LAMP) * lamp + np.float32(HEAD) * head
        return total

    def _local(self, points: NDArray[np.float32], things: NDArray[np.int32]) -> NDArray[np.float32]:
        """Points (P, 3) in the coordinates of the models of their things (P,)."""
        moved = points - self._at[things]
        cos, sin = self._cos[things], self._sin[things]
        x, y, z = moved.T
        return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)


@lru_cache(maxsize=4)
def _grid(width: int, height: int, focal: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns (W,) and rows (H,) of the middles of pixels, on the plane at distance 1; y points down."""
    x = (np.arange(width) + 0.5 - width / 2) / focal
    y = (np.arange(height) + 0.5 - height / 2) / focal
    return x.astype(np.float32), y.astype(np.float32)


def _corners(thing: Placed) -> NDArray[np.float32]:
    """Corners (M, 3, 3) of a thing's faces in the room."""
    mesh = shift(turn(thing.model.mesh, thing.yaw), (thing.x, thing.y, thing.z))
    return np.ascontiguousarray(mesh.vertices[mesh.faces])
