"""Walks a simulator by lattice: enters a scene, puts the agent at the pose of a view, and looks at targets.

It uses the calls that AI2-THOR's own client and the stand-in share (AI2-THOR 5.0.0, `Controller`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.colour import in_colour
from activelsd.envs.thor.lattice import Lattice, Pose, lattice_of
from activelsd.errors import DataError
from activelsd.sections import Colour

LANDING, TURN = 0.02, 0.5
"""Metres and degrees by which an agent may miss the pose that it was sent to."""

EYE = 0.675
"""Metres of a standing agent's camera above the agent, if the simulator does not say."""

NEAREST = 0.05
"""Metres before the camera that its picture begins."""


class Event(Protocol):
    """A simulator's answer: what the agent sees, and metadata of the scene."""

    @property
    def frame(self) -> NDArray[np.uint8]:
        """(H, W, 3) RGB."""

    @property
    def instance_masks(self) -> Mapping[str, NDArray[np.bool_]]:
        """(H, W) by the simulator's name of the object."""

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Of the agent, the objects and the action."""


class Simulator(Protocol):
    """The calls of AI2-THOR's controller that a world makes."""

    def reset(self, scene: str) -> Event:
        """Load a scene."""

    def step(self, action: str, **arguments: Any) -> Event:
        """Do one of the simulator's actions."""

    def stop(self) -> None:
        """End it; nothing is left running."""


class Target(NamedTuple):
    """An object of a scene that may be the target of an episode."""

    id: str  # the simulator's
    kind: str
    corners: NDArray[np.float64]  # (8, 3) of the box around it, metres


class Sight(NamedTuple):
    """What a picture shows of an object."""

    box: tuple[int, int, int, int]  # xmin, ymin, xmax, ymax in pixels, half-open
    pixels: int  # that show the object itself


class Scene(NamedTuple):
    """A scene with its lattice and targets."""

    name: str
    lattice: Lattice
    targets: tuple[Target, ...]


class WalkableRoom:
    """A simulator with an agent in one of its scenes."""

    def __init__(
        self, simulator: Simulator, *, step: float, horizons: Sequence[float], classes: Sequence[str]
    ) -> None:
        """Take a simulator that is ready.

        Args:
            simulator: which is walked.
            step: between cells, metres.
            horizons: degrees down.
            classes: types of the objects that may be asked for.
        """
        self.simulator = simulator
        self._step, self._horizons, self._classes = step, horizons, set(classes)

    def enter(self, name: str) -> Scene:
        """Load a scene with its lattice and targets; from then on the simulator reports no other objects.

        Raises:
            DataError: its agent can reach nothing.
        """
        objects = self.simulator.reset(name).metadata["objects"]
        places = self.simulator.step("GetReachablePositions").metadata["actionReturn"] or []
        if not places:
            raise DataError(f"The agent can reach no place in {name}; leave that scene out.")
        targets = [
            Target(
                item["objectId"],
                item["objectType"],
                np.array(item["axisAlignedBoundingBox"]["cornerPoints"], np.float64),
            )
            for item in sorted(objects, key=lambda item: str(item["objectId"]))
            if item["objectType"] in self._classes
        ]
        # Reporting objects, not drawing pixels, takes most of a simulator's time.
        self.simulator.step("SetObjectFilter", objectIds=[target.id for target in targets])
        return Scene(name, lattice_of(places, step=self._step, horizons=self._horizons), tuple(targets))

    def stand(self, pose: Pose) -> Event | None:
        """Put the agent there; None if the simulator refuses or it lands somewhere else."""
        x, y, z, rotation, horizon = pose
        event = self.simulator.step(
            "TeleportFull",
            x=x,
            y=y,
            z=z,
            rotation={"x": 0.0, "y": rotation, "z": 0.0},
            horizon=horizon,
            standing=True,
        )
        agent = event.metadata["agent"]
        off = max(abs(agent["position"]["x"] - x), abs(agent["position"]["z"] - z))
        turned = max(_apart(agent["rotation"]["y"], rotation), _apart(agent["cameraHorizon"], horizon))
        landed = event.metadata["lastActionSuccess"] and off <= LANDING and turned <= TURN
        return event if landed else None


def photograph(event: Event, colour: Colour) -> NDArray[np.uint8]:
    """What an event shows, uint8 (H, W) in gray or (H, W, 3) RGB."""
    return in_colour(np.ascontiguousarray(event.frame), colour)  # its rows may run backwards in memory


def sight(event: Event, name: str) -> Sight | None:
    """What is seen of an object, by its mask and the simulator's name of it; None if no pixel shows it."""
    mask = event.instance_masks.get(name)
    if mask is None or not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    return Sight(box, int(np.count_nonzero(mask)))


def unhindered(event: Event, target: Target, pose: Pose, field_of_view: float) -> float:
    """Pixels that the rectangle around a target would have if nothing hid it and the frame were endless.

    Args:
        event: the simulator's answer at the pose.
        target: which object.
        pose: where the agent is.
        field_of_view: of the camera, degrees from top to bottom.
    """
    yaw, pitch = np.deg2rad([pose.rotation, pose.horizon])
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    ahead = np.array([np.sin(yaw) * np.cos(pitch), -np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    up = np.cross(ahead, right)
    across, above, depth = ((target.corners - _camera(event, pose)) @ np.stack([right, up, ahead], 1)).T
    depth = np.maximum(depth, NEAREST)
    focal = len(event.frame) / 2 / np.tan(np.deg2rad(field_of_view) / 2)
    return float(np.ptp(across / depth) * np.ptp(above / depth) * focal**2)


def _apart(one: float, other: float) -> float:
    """Degrees between two directions."""
    return abs((one - other + 180) % 360 - 180)


def _camera(event: Event, pose: Pose) -> NDArray[np.float64]:
    at = event.metadata.get("cameraPosition")
    return np.array([pose.x, pose.y + EYE, pose.z] if at is None else [at["x"], at["y"], at["z"]])
