"""Replaces AI2-THOR's Unity player, with the calls and fields of `ai2thor.controller.Controller` 5.0.0.

It needs no download, display or GPU: its rooms are our own and are ray-cast. It uses THOR's axes and names
and supports what the worlds need; it does not support what needs Unity (picking up, opening, physics).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from activelsd.envs.thor.scenes import SCENES
from activelsd.envs.thor.standin_room import AGENT_Y, StandInPose, StandInRoom
from activelsd.scenery.rooms.room_renderer import Picture

_HORIZONS = (-30.0, 60.0)
_TOLERANCE = 1e-4  # degrees by which a horizon may exceed its limits
_LANDING = 0.05  # metres by which a teleport may miss the floor
_INITIAL = {
    "fieldOfView": 90.0,
    "gridSize": 0.25,
    "renderDepthImage": False,
    "renderInstanceSegmentation": False,
    "rotateStepDegrees": 90.0,
    "visibilityDistance": 1.5,
}
"""Parameters of `Initialize` and their defaults, kept over resets; other keywords only matter to Unity."""


class StandInEvent:
    """The result of an action. Images are rendered on first access and are always the same bytes.

    Attributes:
        metadata: the supported fields of THOR's metadata.
        screen_width: width of the images in pixels.
        screen_height: height of the images in pixels.
    """

    def __init__(
        self,
        metadata: dict[str, Any],
        ids: Sequence[str],
        look: Callable[[], Picture],
        *,
        depth: bool,
        masks: bool,
    ) -> None:
        """Stores how to render the image; depth and masks are available only if asked for."""
        self.metadata = metadata
        self.screen_width: int = metadata["screenWidth"]
        self.screen_height: int = metadata["screenHeight"]
        self._ids = ids
        self._look = look
        self._depth, self._masks = depth, masks

    def __bool__(self) -> bool:
        return bool(self.metadata["lastActionSuccess"])

    @cached_property
    def _picture(self) -> Picture:
        return self._look()

    @property
    def frame(self) -> NDArray[np.uint8]:
        """RGB image (H, W, 3)."""
        return self._picture.colour

    @property
    def depth_frame(self) -> NDArray[np.float32] | None:
        """Depth (H, W) in metres along the camera's axis; None unless `renderDepthImage` is on."""
        return self._picture.depth if self._depth else None

    @cached_property
    def instance_masks(self) -> dict[str, NDArray[np.bool_]]:
        """Mask (H, W) of every visible object by its objectId; empty unless segmentation is on."""
        if not self._masks:
            return {}
        things = self._picture.things
        return {self._ids[i]: things == i for i in np.unique(things).tolist() if i >= 0}

    @cached_property
    def instance_detections2D(self) -> dict[str, tuple[int, int, int, int]] | None:
        """Inclusive x1, y1, x2, y2 of every visible object by objectId; None unless segmentation is on."""
        if not self._masks:
            return None
        found = enumerate(find_objects(self._picture.things + 1))
        return {
            self._ids[i]: (columns.start, rows.start, columns.stop - 1, rows.stop - 1)
            for i, (rows, columns) in ((i, spans) for i, spans in found if spans is not None)
        }


class _FailedError(Exception):
    """Raised inside an action that fails and changes nothing; the text is THOR's `errorMessage`."""


class StandIn:
    """One agent in one room at a time.

    Attributes:
        last_event: result of the last action.
        scene: name of the room, as THOR spells it.
    """

    def __init__(
        self, *, scene: str = SCENES[0], width: int = 300, height: int = 300, **initialize: Any
    ) -> None:
        """Opens a scene.

        Args:
            scene: name of the scene, such as FloorPlan1.
            width: width of the images in pixels.
            height: height of the images in pixels.
            **initialize: THOR's `fieldOfView` (vertical, degrees), `gridSize`, `renderDepthImage`,
                `renderInstanceSegmentation`, `rotateStepDegrees` and `visibilityDistance`; other parameters
                of its player are ignored.

        Raises:
            ConfigError: there is no such scene.
        """
        self.width, self.height = width, height
        self.initialization_parameters: dict[str, Any] = dict(_INITIAL)
        self.scene = scene
        self._built: tuple[str, float] | None = None  # scene and grid size of the current room
        self._filter: frozenset[str] | None = None
        self._open = True
        self.last_event = self.reset(scene, **initialize)

    def reset(self, scene: str | None = None, **initialize: Any) -> StandInEvent:
        """Goes to a scene, None for the same again; parameters keep their values unless given again.

        Raises:
            ConfigError: there is no such scene.
            RuntimeError: the stand-in was stopped.
        """
        self._check_open()
        self.width, self.height = initialize.pop("width", self.width), initialize.pop("height", self.height)
        self.initialization_parameters.update(initialize)
        name = (self.scene if scene is None else scene).removesuffix("_physics")
        wanted = name, float(self._parameter("gridSize"))
        if wanted != self._built:
            self._room, self._built = StandInRoom(*wanted), wanted
        self.scene = f"{name}_physics"
        self._filter = None
        self._pose = StandInPose(*self._room.start, 0.0, 0.0, True)
        self.last_event = self._event("Initialize", None, None)
        return self.last_event

    def step(self, action: str, *, raise_for_failure: bool = False, **arguments: Any) -> StandInEvent:
        """Takes an action. An action that fails changes nothing; its event says so.

        Raises:
            ValueError: there is no such action, or its arguments are wrong.
            RuntimeError: the action failed and `raise_for_failure` is set, or the stand-in was stopped.
        """
        self._check_open()
        if action not in _ACTIONS:
            raise ValueError(f"The stand-in has no action {action}; there are {', '.join(_ACTIONS)}.")
        bound = _ACTIONS[action].__get__(self)
        try:
            inspect.signature(bound).bind(**arguments)
        except TypeError as error:
            raise ValueError(f"{action}: {error}") from None
        returned, failure = None, None
        try:
            returned = bound(**arguments)
        except _FailedError as error:
            failure = str(error)
        self.last_event = self._event(action, returned, failure)
        if failure is not None and raise_for_failure:
            raise RuntimeError(failure)
        return self.last_event

    def stop(self) -> None:
        """Stops; later calls raise RuntimeError."""
        self._open = False

    def _check_open(self) -> None:
        if not self._open:
            raise RuntimeError("The stand-in was stopped; create a new one.")

    def _parameter(self, name: str) -> Any:
        return self.initialization_parameters[name]

    def _event(self, action: str, returned: Any, failure: str | None) -> StandInEvent:
        pose, room = self._pose, self._room
        fov, width, height = float(self._parameter("fieldOfView")), self.width, self.height
        objects = room.objects(pose, fov, width / height, float(self._parameter("visibilityDistance")))
        metadata = {
            "agent": {
                "name": "agent",
                "position": {"x": pose.x, "y": AGENT_Y, "z": pose.z},
                "rotation": {"x": 0.0, "y": pose.rotation, "z": 0.0},
                "cameraHorizon": pose.horizon,
                "isStanding": pose.standing,
            },
            "objects": [o for o in objects if self._filter is None or o["objectId"] in self._filter],
            "sceneName": self.scene,
            "lastAction": action,
            "lastActionSuccess": failure is None,
            "errorMessage": failure or "",
            "errorCode": "",
            "actionReturn": returned,
            "cameraPosition": {"x": pose.x, "y": pose.eye, "z": pose.z},
            "fov": fov,
            "screenWidth": width,
            "screenHeight": height,
        }
        return StandInEvent(
            metadata,
            room.ids,
            lambda: room.look(pose, fov, width, height),
            depth=bool(self._parameter("renderDepthImage")),
            masks=bool(self._parameter("renderInstanceSegmentation")),
        )

    def _pass(self) -> None:
        pass

    def _scenes_in_build(self) -> list[str]:
        return [f"{scene}_physics" for scene in SCENES]

    def _reachable_positions(self) -> list[dict[str, float]]:
        return [{"x": x, "y": AGENT_Y, "z": z} for x, z in self._room.reachable.tolist()]

    def _set_filter(self, objectIds: Sequence[str]) -> None:
        self._filter = frozenset(objectIds)

    def _reset_filter(self) -> None:
        self._filter = None

    def _teleport_full(
        self,
        x: float,
        y: float,
        z: float,
        rotation: float | Mapping[str, float],
        horizon: float,
        standing: bool,
    ) -> None:
        yaw = float(rotation["y"] if isinstance(rotation, Mapping) else rotation) % 360.0
        low, high = _HORIZONS
        if not low - _TOLERANCE <= horizon <= high + _TOLERANCE:
            raise _FailedError(f"Each horizon must be in [{low:.0f}:{high:.0f}]. You gave {horizon}.")
        if abs(y - AGENT_Y) > _LANDING:
            raise _FailedError(f"The agent cannot stand at a height of {y} m; its y is {AGENT_Y}.")
        if not self._room.fits((x, z), (x, z)):
            raise _FailedError(f"Something is in the way of the agent at x {x:.2f}, z {z:.2f}.")
        self._pose = StandInPose(float(x), float(z), yaw, float(horizon), bool(standing))

    def _teleport(
        self,
        position: Mapping[str, float] | None = None,
        rotation: float | Mapping[str, float] | None = None,
        horizon: float | None = None,
        standing: bool | None = None,
    ) -> None:
        """Teleports; arguments that are None keep the current values."""
        pose = self._pose
        target = {"x": pose.x, "y": AGENT_Y, "z": pose.z} if position is None else position
        self._teleport_full(
            **target,
            rotation=pose.rotation if rotation is None else rotation,
            horizon=pose.horizon if horizon is None else horizon,
            standing=pose.standing if standing is None else standing,
        )

    def _move(self, degrees: float, magnitude: float | None) -> None:
        """Steps in a direction, in degrees clockwise from the agent's heading."""
        pose = self._pose
        length = self._parameter("gridSize") if magnitude is None else magnitude
        angle = math.radians(pose.rotation + degrees)
        # rounded, so that a step and its reverse end at the same point
        x, z = round(pose.x + length * math.sin(angle), 6), round(pose.z + length * math.cos(angle), 6)
        if not self._room.fits((pose.x, pose.z), (x, z)):
            raise _FailedError(f"Something is blocking the agent from moving to x {x:.2f}, z {z:.2f}.")
        self._pose = pose._replace(x=x, z=z)

    def _ahead(self, moveMagnitude: float | None = None) -> None:
        self._move(0.0, moveMagnitude)

    def _right(self, moveMagnitude: float | None = None) -> None:
        self._move(90.0, moveMagnitude)

    def _back(self, moveMagnitude: float | None = None) -> None:
        self._move(180.0, moveMagnitude)

    def _left(self, moveMagnitude: float | None = None) -> None:
        self._move(270.0, moveMagnitude)

    def _rotate_right(self, degrees: float | None = None) -> None:
        by = self._parameter("rotateStepDegrees") if degrees is None else degrees
        self._pose = self._pose._replace(rotation=(self._pose.rotation + by) % 360.0)

    def _rotate_left(self, degrees: float | None = None) -> None:
        by = self._parameter("rotateStepDegrees") if degrees is None else degrees
        self._rotate_right(-by)

    def _look_down(self, degrees: float = 30.0) -> None:
        self._teleport(horizon=self._pose.horizon + degrees)

    def _look_up(self, degrees: float = 30.0) -> None:
        self._look_down(-degrees)


_ACTIONS: Mapping[str, Callable[..., Any]] = {
    "GetReachablePositions": StandIn._reachable_positions,
    "GetScenesInBuild": StandIn._scenes_in_build,
    "LookDown": StandIn._look_down,
    "LookUp": StandIn._look_up,
    "MoveAhead": StandIn._ahead,
    "MoveBack": StandIn._back,
    "MoveLeft": StandIn._left,
    "MoveRight": StandIn._right,
    "Pass": StandIn._pass,
    "ResetObjectFilter": StandIn._reset_filter,
    "RotateLeft": StandIn._rotate_left,
    "RotateRight": StandIn._rotate_right,
    "SetObjectFilter": StandIn._set_filter,
    "Teleport": StandIn._teleport,
    "TeleportFull": StandIn._teleport_full,
}
"""The method for each action: its parameters are THOR's, and its result is the event's `actionReturn`."""
