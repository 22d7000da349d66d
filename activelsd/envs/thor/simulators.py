"""Starts the simulator of the world: AI2-THOR through its guarded client, or the stand-in's rooms."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

from activelsd.envs.digest import code_digest
from activelsd.envs.thor.room import Simulator
from activelsd.envs.thor.settings import AI2THOR, STANDIN, THORSettings
from activelsd.subprogram import NUMBER

Device = TypeVar("Device", str, int)


def start(world: THORSettings) -> Simulator:
    """A simulator that is ready for a scene.

    Raises:
        UserError: AI2-THOR is not there, or cannot be started here; the sentence says what to do.
    """
    if world.backend == STANDIN:
        from activelsd.envs.thor.standin import StandIn

        return StandIn(
            width=world.width,
            height=world.height,
            fieldOfView=world.field_of_view,
            gridSize=world.step,
            renderInstanceSegmentation=True,
        )
    from activelsd.envs.thor.client import GuardedController

    return GuardedController(
        executable=world.executable,
        x_display=_own(world.x_displays),
        gpu_device=_own(world.gpu_devices),
        width=world.width,
        height=world.height,
        field_of_view=world.field_of_view,
        gridSize=world.step,
        renderInstanceSegmentation=True,
    )


def _own(devices: Sequence[Device]) -> Device | None:
    """The device of this process: processes that are started side by side take them in turn."""
    return devices[int(os.environ.get(NUMBER, 0)) % len(devices)] if devices else None


def build_of(world: THORSettings) -> str:
    """What the pictures of a simulator depend on beside its settings: its build, or the stand-in's code."""
    if world.backend == STANDIN:
        return code_digest("activelsd.envs.thor.standin")
    if world.executable is not None:
        file = Path(world.executable)
        stamp = f" {file.stat().st_size} {file.stat().st_mtime_ns}" if file.exists() else ""
        return world.executable + stamp
    try:
        return f"ai2thor {version('ai2thor')}"
    except PackageNotFoundError:
        return AI2THOR
