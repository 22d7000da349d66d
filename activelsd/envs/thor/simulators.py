"""The simulators behind the world: AI2-THOR by its guarded client, or furnished rooms in its stead."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple, TypeVar

from activelsd.envs.thor.room import Simulator
from activelsd.errors import ConfigError, did_you_mean
from activelsd.subprogram import NUMBER

AI2THOR, STANDIN = "ai2thor", "standin"
BACKENDS = (AI2THOR, STANDIN)

Device = TypeVar("Device", str, int)

_STANDIN = ("standin.py", "standin_room.py", "standin_scenes.py")
_ROOMS = ("activelsd.scenery.rooms", "activelsd.scenery.shapes")
"""What the stand-in's pictures depend on: modules beside this one, and packages."""


class SimulatorSettings(NamedTuple):
    """What a simulator is started with, in values that JSON holds."""

    backend: str = AI2THOR
    executable: str | None = None  # of AI2-THOR's player; None for the build that its client downloads
    width: int = 224  # pixels
    height: int = 224
    field_of_view: float = 90.0  # degrees from top to bottom
    step: float = 0.5  # metres between places
    x_displays: tuple[str, ...] = ()  # AI2-THOR: each process takes the next; none: $DISPLAY
    gpu_devices: tuple[int, ...] = ()  # the same


def start(settings: SimulatorSettings) -> Simulator:
    """A simulator that is ready for a scene.

    Raises:
        ConfigError: there is no such backend.
        UserError: AI2-THOR is not there, or cannot be started here; the sentence says what to do.
    """
    check_backend(settings.backend)
    _, executable, width, height, field_of_view, step, x_displays, gpu_devices = settings
    if settings.backend == STANDIN:
        from activelsd.envs.thor.standin import StandIn

        return StandIn(
            width=width,
            height=height,
            fieldOfView=field_of_view,
            gridSize=step,
            renderInstanceSegmentation=True,
        )
    from activelsd.envs.thor.client import GuardedController

    return GuardedController(
        executable=executable,
        x_display=_own(x_displays),
        gpu_device=_own(gpu_devices),
        width=width,
        height=height,
        field_of_view=field_of_view,
        gridSize=step,
        renderInstanceSegmentation=True,
    )


def _own(devices: Sequence[Device]) -> Device | None:
    """This process's of some devices: processes that are started side by side take them in turn."""
    return devices[int(os.environ.get(NUMBER, 0)) % len(devices)] if devices else None


def check_backend(name: str) -> None:
    """Raise ConfigError where a backend is unknown."""
    if name not in BACKENDS:
        raise ConfigError(f"There is no backend '{name}'; {did_you_mean(name, BACKENDS)}")


def build_of(settings: SimulatorSettings) -> str:
    """What the pictures of a simulator depend on beside its settings: its build, or the stand-in's code."""
    if settings.backend == STANDIN:
        modules = [resources.files("activelsd.envs.thor") / name for name in _STANDIN]
        for package in _ROOMS:
            found = (one for one in resources.files(package).iterdir() if one.name.endswith(".py"))
            modules += sorted(found, key=lambda one: one.name)
        return hashlib.sha256(b"".join(one.read_bytes() for one in modules)).hexdigest()[:16]
    if settings.executable is not None:
        file = Path(settings.executable)
        stamp = f" {file.stat().st_size} {file.stat().st_mtime_ns}" if file.exists() else ""
        return settings.executable + stamp
    try:
        return f"ai2thor {version('ai2thor')}"
    except PackageNotFoundError:
        return AI2THOR
