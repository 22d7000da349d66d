"""AI2-THOR's controller made safe: however its simulator fails, one error says so and nothing is left."""

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
"""A simulator that was lost is started again at most so often within so many seconds."""

LOG = HOME / "log" / "unity.log"


class GuardedController:
    """Starts and talks to one AI2-THOR simulator, like `ai2thor.controller.Controller`, and survives it.

    The simulator starts at the first `reset`. Where it crashes, hangs, or answers what cannot be understood,
    the call that notices it ends in `SimulatorLost`, with no process, thread, pipe or folder left, and the
    next `reset` starts another. An action that fails is no error: the event says so. An action that the
    simulator does not know, or with wrong arguments, is a programming error: ValueError.

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
        """Nothing is started yet.

        Args:
            executable: a simulator of one's own, as a path or a command line; else the downloaded build.
            width: of the frames, in pixels.
            height: of the frames, in pixels.
            field_of_view: vertical, in degrees.
            platform: of a downloaded build; else `Linux64` with a display, `CloudRendering` without.
            x_display: as `:0`; else that of the environment.
            gpu_device: the card `CloudRendering` draws with; else the first it sees.
            start_timeout_s: how long it may take to start and load a scene, or to load another scene.
            step_timeout_s: how long it may take to answer an action.
            initialize: what AI2-THOR's `Initialize` takes beside, as `renderInstanceSegmentation=True`.
        """
        self._launch = (executable, platform, x_display, gpu_device)
        self._settings = {"width": width, "height": height, "fieldOfView": field_of_view, **initialize}
        self._start_timeout_s, self._step_timeout_s = start_timeout_s, step_timeout_s
        self._simulator: _Simulator | None = None
        self._finalizer: weakref.finalize[..., GuardedController] | None = None
        self._last_event: Event | None = None
        self._lost: str | None = None  # why the simulator before was lost, until another runs
        self._restarts: deque[float] = deque(maxlen=RESTARTS)

    def reset(self, scene: str) -> Event:
        """Load a scene, in a simulator that is started where none runs.

        Args:
            scene: as `FloorPlan5`.

        Raises:
            SimulatorLost: the simulator was lost on the way.
            SimulatorError: it was lost too often.
            UserError: something that it needs is missing, or there is no such scene.
        """
        if self._simulator is None:
            return self._start(scene)
        self._simulator.check_scene(scene)
        controller = self._simulator.controller
        return self._call(self._start_timeout_s, lambda: controller.reset(scene))

    def step(self, action: str, **arguments: object) -> Event:
        """Take an action; what came of it is in the event's metadata.

        Raises:
            SimulatorLost: the simulator was lost, or there is none, as before the first reset.
            ValueError: AI2-THOR knows no such action, or not with these arguments.
        """
        if self._simulator is None:
            raise SimulatorLost("No AI2-THOR simulator runs; a reset starts one.")
        controller = self._simulator.controller
        return self._call(self._step_timeout_s, lambda: controller.step(action=action, **arguments))

    @property
    def last_event(self) -> Event | None:
        """What the simulator answered last."""
        return self._last_event

    def stop(self) -> None:
        """End the simulator, if one runs, and leave nothing behind; also done at the interpreter's exit."""
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
        beyond = 2 * max(self._start_timeout_s, self._step_timeout_s)  # the watchdog's turn comes before
        options |= {"server_timeout": beyond, "server_start_timeout": beyond, "scene": scene}
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
                f" last time because {reason}: look into {LOG}; {INSTEAD}."
            )
        self._restarts.append(now)

    def _call(self, seconds: float, call: Callable[[], Any]) -> Event:
        """Talk to the simulator; where that fails it is cleared away before the error is raised."""
        simulator = self._simulator
        assert simulator is not None
        try:
            with simulator.watchdog.guard(seconds):
                event = call()
        except Exception as error:
            if simulator.refuses(error):
                raise
            if simulator.process is None:
                raise ConfigError(f"AI2-THOR cannot be started: {_say(error)}; {INSTEAD}.") from None
            raise self._lose(simulator.watchdog.lost or f"talking to it failed ({_say(error)})") from error
        except BaseException:  # as Ctrl-C, after which an answer may be on its way that nobody awaits
            self.stop()
            raise
        self._last_event = _contiguous(event)
        return self._last_event

    def _lose(self, reason: str) -> SimulatorLost:
        self.stop()
        self._lost = reason
        return SimulatorLost(f"AI2-THOR's simulator was lost: {reason}; its log is {LOG}.")


class _Simulator:
    """One of AI2-THOR's controllers, made without starting anything, and the watchdog over it."""

    def __init__(self) -> None:
        kind = load_controller()
        self.controller = kind.__new__(kind)
        self.watchdog = Watchdog(self.controller)

    def start(self, settings: Mapping[str, object]) -> Any:
        """Run the controller's constructor, which starts the player and loads a scene; the event of that."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # it leaves the player's log to be closed
            try:
                self.controller.__init__(**settings)
            except BaseException as error:
                traceback.clear_frames(error.__traceback__)  # which may hold that log
                if isinstance(error, ValueError):
                    self.check_scene(str(settings["scene"]))
                raise
        return self.controller.last_event

    @property
    def process(self) -> subprocess.Popen[bytes] | None:
        """The player, once it was started."""
        server = vars(self.controller).get("server")
        return None if server is None else server.unity_proc

    def check_scene(self, scene: str) -> None:
        """Raise ConfigError where the build is known to have no such scene."""
        known = vars(self.controller).get("_scenes_in_build")
        if known and self.controller.normalize_scene(scene) not in known:
            names = [name.removesuffix("_physics") for name in sorted(known)]
            hint = did_you_mean(scene, names, f"{names[0]} is one.")
            raise ConfigError(f"{scene} is no scene of this build of AI2-THOR; {hint}") from None

    def refuses(self, error: Exception) -> bool:
        """Whether an error is about what was asked for, of a simulator that goes on."""
        if isinstance(error, UserError):
            return True
        if not isinstance(error, ValueError) or self.process is None or self.process.poll() is not None:
            return False
        event = self.controller.last_event  # of an answer that could not be read, it is not
        return event is not None and str(error) == event.metadata["errorMessage"]

    def close(self) -> None:
        """Kill and reap the player, and clear away all there is of it; the client's own `stop` may raise."""
        self.watchdog.close()
        parts = vars(self.controller)
        server, build = parts.get("server"), parts.get("_build")
        if server is not None:
            if server.unity_proc is not None:
                server.unity_proc.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):  # stuck in a driver, it cannot be helped
                    server.unity_proc.wait(5)
            for pipe in (server.client_pipe, server.server_pipe):
                if pipe is not None:
                    with contextlib.suppress(OSError):  # what was not sent yet
                        pipe.close()
            server.tmp_dir.cleanup()
        if getattr(build, "_lock", None) is not None:
            build.unlock()


def _contiguous(event: Any) -> Event:
    """The event with its pictures in the usual order of rows; they come last row first."""
    for name in ("frame", "depth_frame"):
        if (picture := getattr(event, name)) is not None:
            setattr(event, name, np.ascontiguousarray(picture))
    found: Event = event
    return found


def _say(error: BaseException) -> str:
    """What went wrong, on one line; the client puts an error of its own around the telling one."""
    inner = error.__context__ or error
    text = " ".join(str(inner).split())
    return f"{type(inner).__name__}: {text[:200]}" if text else type(inner).__name__
