"""A simulator made up for tests: a grid with a hole in it, painted objects, and every call checked."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import SimulatorLost

SIZE = 40
"""Side of its pictures in pixels; they show 90 degrees."""

CELLS = ((0, 0), (1, 0), (2, 0), (0, 1), (2, 1), (0, 2), (1, 2), (2, 2))
"""A ring of cells around a hole at (1, 1)."""

OBJECTS = {"Apple|+02.00|+01.50|+00.25": (2.0, 1.5, 0.25), "Bowl|-01.50|+01.20|+00.00": (-1.5, 1.2, 0.0)}
"""Where the objects are; each is a cube with sides of 0.4 m."""

_EYE, _HALF, _STEP = 0.675, 0.2, 0.25


class Event(NamedTuple):
    frame: NDArray[np.uint8]
    instance_masks: Mapping[str, NDArray[np.bool_]]
    metadata: Mapping[str, Any]


class FakeSimulator:
    """Answers as AI2-THOR's controller does, poses with noise in them; what it does not know fails the test.

    Attributes:
        calls: the actions it was asked for, in order.
        sealed: cells from which it lands somewhere else.
        lost: numbers of calls at which it fails for good, until it is reset.
    """

    def __init__(
        self, *, sealed: tuple[tuple[int, int], ...] = (), lost: frozenset[int] = frozenset()
    ) -> None:
        self.calls: list[str] = []
        self.sealed, self.lost, self.stopped = sealed, lost, False
        self._scene = ""
        self._rng = np.random.default_rng(0)

    def reset(self, scene: str) -> Event:
        assert not self.stopped
        assert scene.startswith("FloorPlan")
        self._count("reset")
        self._scene, self._filter = scene, list(OBJECTS)
        self._pose = (0.0, 0.901, 0.0, 0.0, 0.0)
        return self._event()

    def step(self, action: str, **arguments: Any) -> Event:
        assert self._scene, "an action before the first reset"
        self._count(action)
        if action == "GetReachablePositions":
            assert not arguments
            return self._event(
                actionReturn=[
                    {"x": x * _STEP + self._noise(), "y": 0.90099, "z": z * _STEP} for x, z in CELLS
                ]
            )
        if action == "SetObjectFilter":
            self._filter = arguments["objectIds"]
            assert set(self._filter) <= set(OBJECTS)
            return self._event()
        assert action == "TeleportFull"
        assert set(arguments) == {"x", "y", "z", "rotation", "horizon", "standing"}
        at = {axis: arguments[axis] for axis in "xyz"}
        cell = (round(at["x"] / _STEP), round(at["z"] / _STEP))
        if cell not in CELLS:
            return self._event(lastActionSuccess=False, errorMessage="something is in the way")
        if cell in self.sealed:
            at = {**at, "x": at["x"] + 0.1}
        self._pose = (at["x"], at["y"], at["z"], arguments["rotation"]["y"], arguments["horizon"])
        return self._event()

    def stop(self) -> None:
        self.stopped = True

    def _count(self, action: str) -> None:
        self.calls.append(action)
        if len(self.calls) in self.lost:
            self._scene = ""
            raise SimulatorLost("the player is gone")

    def _noise(self) -> float:
        return float(self._rng.uniform(-2e-4, 2e-4))

    def _event(self, **metadata: Any) -> Event:
        x, y, z, rotation, horizon = self._pose
        seed = zlib.crc32(repr((self._scene, *np.round(self._pose, 3))).encode())
        frame = np.random.default_rng(seed).integers(0, 80, (SIZE, SIZE, 3), dtype=np.uint8)
        masks = {}
        for i, (name, at) in enumerate(OBJECTS.items()):
            mask = self._seen(np.array(at))
            if mask.any() and name in self._filter:
                masks[name] = mask
                frame[mask] = 120 + 60 * i
        agent = {
            "position": {"x": x + self._noise(), "y": y, "z": z + self._noise()},
            "rotation": {"x": 0.0, "y": rotation - 5e-4, "z": 0.0},
            "cameraHorizon": horizon + 2e-5,
        }
        objects = [
            {
                "objectId": name,
                "objectType": name.partition("|")[0],
                "axisAlignedBoundingBox": {"cornerPoints": _corners(np.array(at)).tolist()},
            }
            for name, at in OBJECTS.items()
            if name in self._filter
        ]
        told = {"agent": agent, "objects": objects, "sceneName": self._scene, "lastActionSuccess": True}
        # Rows from the bottom up, as the real client has them.
        return Event(np.flip(np.flip(frame, 0).copy(), 0), masks, told | {"actionReturn": None} | metadata)

    def _seen(self, at: NDArray[np.float64]) -> NDArray[np.bool_]:
        """The rectangle around a cube's corners, where all of them are before the camera."""
        x, y, z, rotation, horizon = self._pose
        yaw, pitch = np.deg2rad([rotation, horizon])
        offset = _corners(at) - np.array([x, y + _EYE, z])
        right = offset[:, 0] * np.cos(yaw) - offset[:, 2] * np.sin(yaw)
        level = offset[:, 0] * np.sin(yaw) + offset[:, 2] * np.cos(yaw)
        ahead = level * np.cos(pitch) - offset[:, 1] * np.sin(pitch)
        up = level * np.sin(pitch) + offset[:, 1] * np.cos(pitch)
        mask = np.zeros((SIZE, SIZE), np.bool_)
        if (ahead > 0.05).all():
            columns = SIZE / 2 * (1 + right / ahead)
            rows = SIZE / 2 * (1 - up / ahead)
            mask[_span(rows), _span(columns)] = True
        return mask


def _span(edges: NDArray[np.float64]) -> slice:
    return slice(max(0, round(edges.min())), max(0, min(SIZE, round(edges.max()))))


def _corners(at: NDArray[np.float64]) -> NDArray[np.float64]:
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    return np.asarray(at + _HALF * signs)
