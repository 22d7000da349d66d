"""A safe AI2-THOR controller: any failure of its simulator raises one error and is fully cleaned up."""

from __future__ import annotations

import contextlib
import subprocess
import time
import traceback
import warnings
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any

import numpy as np

from activelsd.envs.thor.installation import HOME, INSTEAD, launch_options, load_controller
from activelsd.envs.thor.room import Event
from activelsd.envs.thor.watchdog import Watchdog
from activelsd.errors import ConfigError, SimulatorError, SimulatorLost, UserError, did_you_mean

RESTARTS, WINDOW_S = 3, 600.0
"""At most `RESTARTS` restarts of a lost simulator within `WINDOW_S` seconds."""

LOG = HOME / "log" / "unity.log"


class GuardedController:
    """Runs one AI2-THOR simulator, like `ai2thor.controller.Controller`, and handles its failures.

    The simulator starts at the first `reset`. If it crashes, hangs or sends an unreadable answer, the current
    call raises `SimulatorLost`; no process, thread, pipe or folder remains, and the next `reset` starts a new
    simulator. An action that fails raises nothing: the event says so. An unknown action, or wrong arguments,
    is a programming error: ValueError.

    Usage: `with GuardedController(width=224, height=224) as controller: controller.reset("FloorPlan1")`
    """

    def __init__(
        self,
        *,
        executable: str | None = None,
        width: int = 300,
        height: int = 300,
        field_of_view: float = 90.0,
        platform: str | None = None,
        x_display: str | None = None,
        gpu_device: int | None = None,
        start_timeout_s: float = 300.0,
        step_timeout_s: float = 60.0,
        **initialize: object,
    ) -> None:
        """Stores the settings; nothing is started yet.

        Args:
            executable: path or command line of another simulator; None for the downloaded build.
            width: width of the frames in pixels.
            height: height of the frames in pixels.
            field_of_view: vertical field of view in degrees.
            platform: platform of the downloaded build; None for the default, see `choose_platform`.
            x_display: X display such as `:0`; None for the environment's DISPLAY.
            gpu_device: GPU that `CloudRendering` renders on; None for the first.
            start_timeout_s: most seconds to start and load a scene, or to load another scene.
            step_timeout_s: most seconds to answer an action.
            initialize: AI2-THOR's other `Initialize` parameters, such as `renderInstanceSegmentation=True`.
        """
        self._launch = (executable, platform, x_display, gpu_device)
        self._settings = {"width": width, "height": height, "fieldOfView": field_of_view, **initialize}
        self._start_timeout_s, self._step_timeout_s = start_timeout_s, step_timeout_s
        self._simulator: _Simulator | None = None
        self._finalizer: weakref.finalize[..., GuardedController] | None = None
        self._last_event: Event | None = None
        self._lost: str | None = None  # why the previous simulator was lost, until a new one runs
        self._restarts: deque[float] = deque(maxlen=RESTARTS)

    def reset(self, scene: str) -> Event:
        """Loads a scene; starts a simulator if none is running.

        Args:
            scene: name of the scene, such as `FloorPlan5`.

        Raises:
            SimulatorLost: the simulator was lost during the call.
            SimulatorError: it was lost too often.
            UserError: something that it needs is missing, or there is no such scene.
        """
        if self._simulator is None:
            return self._start(scene)
        self._simulator.check_scene(scene)
        controller = self._simulator.controller
        return self._call(self._start_timeout_s, lambda: controller.reset(scene))

    def step(self, action: str, **arguments: object) -> Event:
        """Takes an action; the event's metadata has the result.

        Raises:
            SimulatorLost: the simulator was lost, or none is running, as before the first reset.
            ValueError: AI2-THOR does not know the action or these arguments.
        """
        if self._simulator is None:
            raise SimulatorLost("No AI2-THOR simulator is running; a reset starts one.")
        controller = self._simulator.controller
        return self._call(self._step_timeout_s, lambda: controller.step(action=action, **arguments))

    @property
    def last_event(self) -> Event | None:
        """The simulator's last answer."""
        return self._last_event

    def stop(self) -> None:
        """Stops the simulator, if any, and removes all its resources; also runs at the interpreter's exit."""
        if self._finalizer is not None:
            self._finalizer()
        self._simulator = self._finalizer = None

    def __enter__(self) -> GuardedController:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _start(self, scene: str) -> Event:
        if self._lost is not None:
            self._count_restart(self._lost)
        options = launch_options(*self._launch)
        self._simulator = simulator = _Simulator()
        self._finalizer = weakref.finalize(self, simulator.close)
        timeout = 2 * max(self._start_timeout_s, self._step_timeout_s)  # longer than the watchdog's
        options |= {"server_timeout": timeout, "server_start_timeout": timeout, "scene": scene}
        try:
            event = self._call(self._start_timeout_s, lambda: simulator.start(options | self._settings))
        except BaseException:
            self.stop()
            raise
        self._lost = None
        return event

    def _count_restart(self, reason: str) -> None:
        now = time.monotonic()
        if len(self._restarts) == RESTARTS and now - self._restarts[0] < WINDOW_S:
            raise SimulatorError(
                f"AI2-THOR's simulator was lost {RESTARTS + 1} times within {WINDOW_S / 60:g} minutes, the"
                f" last time because {reason}; see the log {LOG}; {INSTEAD}."
            )
        self._restarts.append(now)

    def _call(self, seconds: float, call: Callable[[], Any]) -> Event:
        """Calls the simulator; if that fails, cleans up before raising the error."""
        simulator = self._simulator
        assert simulator is not None
        try:
            with simulator.watchdog.guard(seconds):
                event = call()
        except Exception as error:
            if simulator.refuses(error):
                raise
            if simulator.process is None:
                raise ConfigError(f"AI2-THOR cannot be started: {_describe(error)}; {INSTEAD}.") from None
            reason = simulator.watchdog.lost or f"the connection to it failed ({_describe(error)})"
            raise self._lose(reason) from error
        except BaseException:  # such as Ctrl-C: an answer that nobody reads may still arrive
            self.stop()
            raise
        self._last_event = _contiguous(event)
        return self._last_event

    def _lose(self, reason: str) -> SimulatorLost:
        self.stop()
        self._lost = reason
        return SimulatorLost(f"AI2-THOR's simulator was lost: {reason}; see its log {LOG}.")


class _Simulator:
    """An AI2-THOR controller, created but not started, and its watchdog."""

    def __init__(self) -> None:
        kind = load_controller()
        self.controller = kind.__new__(kind)
        self.watchdog = Watchdog(self.controller)

    def start(self, settings: Mapping[str, object]) -> Any:
        """Runs the controller's constructor, which starts the player and loads a scene; returns the event."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # it does not close the player's log
            try:
                self.controller.__init__(**settings)
            except BaseException as error:
                traceback.clear_frames(error.__traceback__)  # these may keep that log open
                if isinstance(error, ValueError):
                    self.check_scene(str(settings["scene"]))
                raise
        return self.controller.last_event

    @property
    def process(self) -> subprocess.Popen[bytes] | None:
        """The player's process; None before it is started."""
        server = vars(self.controller).get("server")
        return None if server is None else server.unity_proc

    def check_scene(self, scene: str) -> None:
        """Raises ConfigError if the build is known to lack the scene."""
        known = vars(self.controller).get("_scenes_in_build")
        if known and self.controller.normalize_scene(scene) not in known:
            names = [name.removesuffix("_physics") for name in sorted(known)]
            hint = did_you_mean(scene, names, f"an example is {names[0]}.")
            raise ConfigError(f"This build of AI2-THOR has no scene {scene}; {hint}") from None

    def refuses(self, error: Exception) -> bool:
        """Whether an error only rejects the request, so the simulator keeps running."""
        if isinstance(error, UserError):
            return True
        if not isinstance(error, ValueError) or self.process is None or self.process.poll() is not None:
            return False
        event = self.controller.last_event  # an unreadable answer does not set it
        return event is not None and str(error) == event.metadata["errorMessage"]

    def close(self) -> None:
        """Kills and reaps the player and removes all its resources; the client's own `stop` may raise."""
        self.watchdog.close()
        parts = vars(self.controller)
        server, build = parts.get("server"), parts.get("_build")
        if server is not None:
            if server.unity_proc is not None:
                server.unity_proc.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):  # stuck in a driver: nothing to do
                    server.unity_proc.wait(5)
            for pipe in (server.client_pipe, server.server_pipe):
                if pipe is not None:
                    with contextlib.suppress(OSError):  # unsent data
                        pipe.close()
            server.tmp_dir.cleanup()
        if getattr(build, "_lock", None) is not None:
            build.unlock()


def _contiguous(event: Any) -> Event:
    """The event with its images as contiguous arrays; they arrive with the rows reversed."""
    for name in ("frame", "depth_frame"):
        if (picture := getattr(event, name)) is not None:
            setattr(event, name, np.ascontiguousarray(picture))
    converted: Event = event
    return converted


def _describe(error: BaseException) -> str:
    """One line about an error, or about the error inside it: the client wraps the informative one."""
    inner = error.__context__ or error
    text = " ".join(str(inner).split())
    return f"{type(inner).__name__}: {text[:200]}" if text else type(inner).__name__
