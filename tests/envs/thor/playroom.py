"""A made-up room in AI2-THOR's terms: where one can stand, what is seen from there, what an action does."""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

GRID, EYE, Y = 0.25, 1.576, 0.9009995
SCENES = [f"FloorPlan{100 * kind + n}_physics" for kind in (0, 2, 3, 4) for n in range(1, 31)]
MOVES = {"MoveAhead": 0, "MoveRight": 90, "MoveBack": 180, "MoveLeft": 270}
"""Which way each goes, in degrees to the right of ahead."""


class Thing(NamedTuple):
    """An upright rectangle that faces whoever looks."""

    kind: str
    x: float
    y: float  # of its middle
    z: float
    width: float  # metres; 0 leaves no pixels
    height: float
    color: tuple[int, int, int]

    @property
    def id(self) -> str:
        return f"{self.kind}|{self.x:+06.2f}|{self.y:+06.2f}|{self.z:+06.2f}"


class WalkableRoom:
    """The cells and things of a scene, drawn from its name."""

    def __init__(self, scene: str) -> None:
        rng = np.random.default_rng(zlib.crc32(scene.encode()))
        self.corner = rng.integers(-8, 8, 2) * GRID + 0.1
        self.cells = {(i, j) for i in range(9) for j in range(8)} - {(3, 3), (4, 3), (6, 5), (0, 7)}
        middle = self.corner + GRID * np.array((4, 3.5))
        # A ring of things about the cells. A book has pixels and is never visible; a candle the reverse.
        kinds = ["Apple", "Book", "Bowl", "Candle", "HousePlant", "Laptop", "Television", "Toaster"]
        self.things = []
        for n, (kind, turn) in enumerate(zip(kinds, rng.permutation(8), strict=True)):
            angle, radius = np.radians(45 * turn + rng.uniform(-15, 15)), rng.uniform(1.8, 2.4)
            size = 0.0 if kind == "Candle" else rng.uniform(0.25, 0.8)
            self.things.append(
                Thing(
                    kind,
                    round(float(middle[0] + radius * np.sin(angle)), 2),
                    round(float(rng.uniform(0.5, 1.6)), 2),
                    round(float(middle[1] + radius * np.cos(angle)), 2),
                    size,
                    size * rng.uniform(0.6, 1.4),
                    (200, 31 * n, 255 - 31 * n),
                )
            )

    def place(self, cell: tuple[int, int]) -> dict[str, float]:
        """A cell's middle."""
        return {
            "x": float(self.corner[0] + GRID * cell[0]),
            "y": Y,
            "z": float(self.corner[1] + GRID * cell[1]),
        }

    def cell(self, x: float, z: float) -> tuple[int, int] | None:
        """The cell whose middle is within a centimetre, where there is one that is free."""
        at = (np.array((x, z)) - self.corner) / GRID
        near = np.round(at)
        found = (int(near[0]), int(near[1]))
        return found if found in self.cells and np.abs(at - near).max() * GRID < 0.01 else None


class Refused(Exception):
    """An action that fails; the code is one of AI2-THOR's, or empty for a mere failure."""

    def __init__(self, text: str, code: str = "") -> None:
        super().__init__(text)
        self.code = code


class World:
    """A room, the agent in it, and what is drawn of it."""

    def __init__(self, width: int, height: int, *, noise: bool) -> None:
        self.width, self.height, self.noise = width, height, noise
        self.settings: dict[str, Any] = {}
        self.load(SCENES[0])

    def load(self, scene: str) -> None:
        self.scene, self.room = scene, WalkableRoom(scene)
        self.cell, self.yaw, self.horizon = (1, 1), 0.0, 0.0
        self.filter: set[str] | None = None

    def act(self, name: str, arguments: dict[str, Any]) -> object:
        """What the action returns, which is mostly nothing."""
        if name == "Reset":
            if arguments["sceneName"] not in SCENES:
                raise Refused(f"no scene {arguments['sceneName']}")
            self.load(arguments["sceneName"])
        elif name == "Initialize":
            self.settings = arguments
            return {"cameraNearPlane": 0.1, "cameraFarPlane": 20.0}
        elif name == "ChangeResolution":
            self.width, self.height = arguments["x"], arguments["y"]
        elif name == "GetScenesInBuild":
            return SCENES
        elif name == "GetReachablePositions":
            return [self.room.place(cell) for cell in sorted(self.room.cells)]
        elif name in ("Teleport", "TeleportFull"):
            self.teleport(arguments)
        elif name in MOVES:
            self.walk(MOVES[name], arguments.get("moveMagnitude") or GRID)
        elif name in ("RotateLeft", "RotateRight"):
            degrees = arguments.get("degrees") or self.settings.get("rotateStepDegrees") or 90.0
            self.yaw = (self.yaw + (degrees if name == "RotateRight" else -degrees)) % 360
        elif name in ("LookUp", "LookDown"):
            degrees = arguments.get("degrees") or 30.0
            self.tilt(self.horizon + (degrees if name == "LookDown" else -degrees))
        elif name == "SetObjectFilter":
            self.filter = set(arguments["objectIds"])
        elif name == "ResetObjectFilter":
            self.filter = None
        return None

    def teleport(self, to: dict[str, Any]) -> None:
        cell = self.room.cell(to["x"], to["z"])
        if cell is None or abs(to["y"] - Y) > 0.1:
            raise Refused(f"cannot stand at ({to['x']}, {to['y']}, {to['z']})")
        self.tilt(to.get("horizon", self.horizon))
        self.cell, self.yaw = cell, float(to.get("rotation", {"y": self.yaw})["y"]) % 360

    def walk(self, way: float, metres: float) -> None:
        here, angle = self.room.place(self.cell), np.radians(self.yaw + way)
        cell = self.room.cell(here["x"] + metres * np.sin(angle), here["z"] + metres * np.cos(angle))
        if cell is None:
            raise Refused("something is in the way")
        self.cell = cell

    def tilt(self, horizon: float) -> None:
        if not -30.01 <= horizon <= 60.01:
            raise Refused(f"cannot look {horizon} degrees down")
        self.horizon = float(horizon)

    def draw(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
        """The frame, the ids by colour and the depth, (H, W, 3 or none), first row at the top."""
        focal = self.height / 2 / np.tan(np.radians(self.settings.get("fieldOfView", 90.0)) / 2)
        across = np.arange(self.width) + 0.5 - self.width / 2
        down = np.arange(self.height)[:, None] + 0.5 - self.height / 2
        pitch = np.radians(self.horizon)
        bearing = np.radians(self.yaw) + np.arctan(across / focal)
        wall = 110 + 40 * np.sin(5 * bearing) + 10 * np.sin(23 * bearing)
        floor = np.arctan(down / focal) + pitch > np.radians(20)
        frame = np.repeat(np.where(floor, 60.0, wall)[..., None], 3, axis=2).astype(np.uint8)
        ids = np.where(floor[..., None], np.uint8([9, 9, 9]), np.uint8([7, 7, 7]))
        ids = np.ascontiguousarray(np.broadcast_to(ids, frame.shape))
        depth = np.full((self.height, self.width), 5.0, np.float32)
        for thing, (right, below, away) in sorted(self.seen_from(pitch), key=lambda item: -item[1][2]):
            if away < 0.1:
                continue
            left, end = (focal * (right + side * thing.width / 2) / away for side in (-1, 1))
            top, bottom = (focal * (below + side * thing.height / 2) / away for side in (-1, 1))
            rows = ((down >= top) & (down < bottom))[:, 0]
            columns = (across >= left) & (across < end)
            inside = np.ix_(rows, columns)
            ids[inside], depth[inside] = thing.color, away
            frame[inside] = np.uint8(thing.color) // 2 + 60
        return frame, ids, depth

    def seen_from(self, pitch: float) -> list[tuple[Thing, tuple[float, float, float]]]:
        """Every thing with how far it is to the right, below and away of the eye's axis."""
        here, yaw, found = self.room.place(self.cell), np.radians(self.yaw), []
        for thing in self.room.things:
            x, y, z = thing.x - here["x"], EYE - thing.y, thing.z - here["z"]
            right, ahead = x * np.cos(yaw) - z * np.sin(yaw), x * np.sin(yaw) + z * np.cos(yaw)
            below, away = y * np.cos(pitch) - ahead * np.sin(pitch), y * np.sin(pitch) + ahead * np.cos(pitch)
            found.append((thing, (float(right), float(below), float(away))))
        return found

    def describe(self) -> dict[str, Any]:
        """The agent's part of the metadata, as of where it stands."""
        here, yaw, horizon = self.room.place(self.cell), self.yaw, self.horizon
        position, rotation = dict(here), {"x": 0.0, "y": yaw, "z": 0.0}
        if self.noise:
            position["y"] = 0.90099
            rotation = {"x": -0.0, "y": -0.0 if yaw == 0 else yaw - 0.0005, "z": 0.0}
            horizon = horizon + 0.00002
        agent = {"name": "agent", "position": position, "rotation": rotation, "cameraHorizon": horizon}
        objects = [self.describe_thing(thing) for thing in self.room.things]
        return {
            "agentId": 0,
            "agent": {**agent, "isStanding": True},
            "objects": [one for one in objects if self.filter is None or one["objectId"] in self.filter],
            "colors": [
                *({"name": thing.id, "color": list(thing.color)} for thing in self.room.things),
                {"name": "Wall|+00.00|+00.00|+00.00", "color": [7, 7, 7]},
                {"name": "Floor|+00.00|+00.00|+00.00", "color": [9, 9, 9]},
            ],
            "sceneName": self.scene,
            "screenWidth": self.width,
            "screenHeight": self.height,
            "depthFormat": "Meters",
            "thirdPartyCameras": [],
            "inventoryObjects": [],
        }

    def describe_thing(self, thing: Thing) -> dict[str, Any]:
        here = self.room.place(self.cell)
        away = float(np.hypot(thing.x - here["x"], thing.z - here["z"]))
        near = away < self.settings.get("visibilityDistance", 1.5)
        middle, size = (thing.x, thing.y, thing.z), (thing.width, thing.height, thing.width)
        signs = np.array([(i, j, k) for i in (1, -1) for j in (1, -1) for k in (1, -1)])
        return {
            "objectId": thing.id,
            "objectType": thing.kind,
            "name": thing.id,
            "position": named(middle),
            "visible": near and thing.kind != "Book",
            "distance": away,
            "axisAlignedBoundingBox": {
                "center": named(middle),
                "size": named(size),
                "cornerPoints": (np.array(middle) + signs * np.array(size) / 2).tolist(),
            },
            "objectOrientedBoundingBox": None,
        }


def named(point: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip("xyz", point, strict=True))
