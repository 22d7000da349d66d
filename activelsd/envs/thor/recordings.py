"""Recordings of scenes in the cache, each made once, by as many simulators as asked for."""

from __future__ import annotations

import hashlib
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import lru_cache
from importlib import resources
from multiprocessing import get_context
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, NamedTuple

from activelsd.envs.cache import cache_file, make_once
from activelsd.envs.cores import cores
from activelsd.envs.thor.record import ViewMaker, record
from activelsd.envs.thor.room import WalkableRoom
from activelsd.envs.thor.simulators import STANDIN, SimulatorSettings, build_of, start
from activelsd.envs.viewgraph import read_key, save_graph
from activelsd.errors import SimulatorLost
from activelsd.subprogram import NUMBER

_ELSEWHERE = ("executable", "x_displays", "gpu_devices")
"""Settings that pictures do not depend on, or that `build_of` tells better."""

_SOURCES = ("pictures.py", "thor/lattice.py", "thor/record.py", "thor/room.py")


class RecordingSettings(NamedTuple):
    """What a recording depends on, in values that JSON holds."""

    simulator: SimulatorSettings = SimulatorSettings()
    horizons: tuple[float, ...] = (-30.0, 0.0, 30.0)  # degrees down
    classes: tuple[str, ...] = ()
    size: int = 64  # pixels of frames and crops

    def room(self) -> WalkableRoom:
        """A simulator of these settings, to walk."""
        step = self.simulator.step
        return WalkableRoom(start(self.simulator), step=step, horizons=self.horizons, classes=self.classes)

    @property
    def camera(self) -> ViewMaker:
        """What makes its pictures."""
        return ViewMaker(self.size, self.simulator.field_of_view)


class _Job(NamedTuple):
    settings: RecordingSettings
    scene: str
    path: Path
    key: dict[str, Any]


def recordings(
    settings: RecordingSettings,
    scenes: Sequence[str],
    *,
    cache: Path,
    simulators: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """The files of scenes' recordings, in the order of the scenes; those that are not there are made.

    What an interruption leaves is whole scenes, and the next call goes on with the others.

    Args:
        settings: what is recorded, and how.
        scenes: their names.
        cache: folder for the files.
        simulators: how many record side by side; None for one of AI2-THOR, or as many stand-ins as cores.
        progress: called with the number of scenes that are there and of all.

    Raises:
        UserError: the simulator cannot be started, a scene cannot be recorded, or the cache not be written.
    """
    jobs = [_job(settings, scene, cache) for scene in scenes]
    todo = [job for job in jobs if read_key(job.path) != job.key]
    report = progress or (lambda done, total: None)
    if todo:
        report(len(jobs) - len(todo), len(jobs))
        count = simulators or (cores() if settings.simulator.backend == STANDIN else 1)
        with _made(todo, min(count, len(todo))) as made:
            for number, _ in enumerate(made, len(jobs) - len(todo) + 1):
                report(number, len(jobs))
    return [job.path for job in jobs]


def _job(settings: RecordingSettings, scene: str, cache: Path) -> _Job:
    simulator = settings.simulator
    key: dict[str, Any] = {"scene": scene, "code": _code(), "build": build_of(simulator)}
    key |= {k: v for k, v in settings._asdict().items() if k != "simulator"}
    key |= {k: v for k, v in simulator._asdict().items() if k not in _ELSEWHERE}
    key["horizons"], key["classes"] = list(settings.horizons), list(settings.classes)
    path = cache_file(cache, f"thor-{simulator.backend}-{scene}", settings.size, key)
    return _Job(settings, scene, path, key)


def _code() -> str:
    """A digest of the modules that make what is recorded."""
    package = resources.files("activelsd.envs")
    return hashlib.sha256(b"".join((package / name).read_bytes() for name in _SOURCES)).hexdigest()[:16]


@contextmanager
def _made(jobs: Sequence[_Job], workers: int) -> Iterator[Iterator[Path]]:
    """The files of all jobs, in any order, as they are made."""
    if workers == 1:
        room = jobs[0].settings.room()
        try:
            yield (_record(room, job) for job in jobs)
        finally:
            room.simulator.stop()
        return
    context = get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(context.Value("i", 0),))
    try:
        yield (future.result() for future in as_completed([pool.submit(_in_worker, job) for job in jobs]))
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(counter: Synchronized[int]) -> None:
    """Take the next number; Ctrl-C is for the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with counter.get_lock():
        os.environ[NUMBER] = str(counter.value)
        counter.value += 1


def _in_worker(job: _Job) -> Path:
    return _record(_room(job.settings), job)


@lru_cache(maxsize=1)
def _room(settings: RecordingSettings) -> WalkableRoom:
    """A process's simulator, started once."""
    return settings.room()


def _record(room: WalkableRoom, job: _Job) -> Path:
    def fill() -> None:
        while True:
            try:
                graph = record(room, job.scene, camera=job.settings.camera, classes=job.settings.classes)
            except SimulatorLost:
                continue  # the client starts another, and gives up by an error of its own
            save_graph(graph, job.path, job.key)
            return

    return make_once(job.path, job.key, fill)
