"""Records scenes into files of the cache, each once, with as many simulators as asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from activelsd.envs.cache import cache_file, make_once, writing
from activelsd.envs.cores import cores
from activelsd.envs.digest import code_digest
from activelsd.envs.settings import Progress
from activelsd.envs.thor.record import ViewMaker, record
from activelsd.envs.thor.room import WalkableRoom
from activelsd.envs.thor.settings import STANDIN, THORSettings
from activelsd.envs.thor.simulators import build_of, start
from activelsd.envs.viewgraph import ViewGraph, read_key, save_graph
from activelsd.envs.workers import Item, Work, spread
from activelsd.errors import DataError, SimulatorLost

_DECIDE = frozenset({"backend", "classes", "horizons", "size", "width", "height", "field_of_view", "step"})
"""Settings that pictures depend on; `build_of` says which executable makes them."""


def walkable_room(world: THORSettings) -> WalkableRoom:
    """A simulator with a world's settings, to walk."""
    return WalkableRoom(start(world), step=world.step, horizons=world.horizons, classes=world.classes)


def view_maker(world: THORSettings) -> ViewMaker:
    """What makes a world's views of what the simulator shows."""
    return ViewMaker(world.size, world.field_of_view, world.colour)


class _Scene(NamedTuple):
    name: str
    path: str  # of its recording
    key: dict[str, Any]


def recordings(world: THORSettings, scenes: Sequence[str], progress: Progress | None = None) -> list[Path]:
    """The files of scenes' recordings, in the order of the scenes; missing ones are made.

    A scene without any of the objects that are asked for has a recording without targets.

    An interruption leaves whole scenes, and the next call goes on with the others.

    Args:
        world: what is recorded, and how.
        scenes: their names.
        progress: called with the number of scenes that are there and of all.

    Raises:
        UserError: the simulator cannot be started, a scene cannot be recorded, or the cache not be written.
    """
    found = [_scene(world, scene) for scene in scenes]
    todo = [i for i, scene in enumerate(found) if read_key(Path(scene.path)) != scene.key]
    report = progress or (lambda done, total: None)
    if todo:
        done = len(found) - len(todo)
        report(done, len(found))
        count = world.simulators or (cores() if world.backend == STANDIN else 1)
        items = ((i, found[i]._asdict()) for i in todo)
        job = world.model_dump(mode="json")
        with closing(spread(f"{__name__}:recorder", job, items, processes=min(count, len(todo)))) as made:
            for number, _ in enumerate(made, done + 1):
                report(number, len(found))
    return [Path(scene.path) for scene in found]


def _scene(world: THORSettings, name: str) -> _Scene:
    key = {"scene": name, "code": code_digest(record.__module__), "build": build_of(world)}
    key |= world.model_dump(mode="json", include=set(_DECIDE))
    if world.colour != "gray":  # keys of gray recordings are older than the setting
        key["colour"] = world.colour
    path = cache_file(world.cache_folder, f"thor-{world.backend}-{name}", world.size, key)
    return _Scene(name, str(path), key)


def _recorded(room: WalkableRoom, name: str, world: THORSettings) -> ViewGraph:
    """A scene's recording; one without views if the scene has none of the objects that are asked for."""
    camera = view_maker(world)
    try:
        return record(room, name, camera=camera, classes=world.classes)
    except DataError:
        if room.enter(name).targets:
            raise
    nothing = np.zeros(0, np.int32)
    return ViewGraph(
        frames=np.zeros((0, world.size, world.size), np.uint8),
        moves=np.zeros((0, 0), np.int32),
        move_names=(),
        classes=tuple(world.classes),
        targets=(),
        labels=np.zeros(0, np.int64),
        scenes=(name,),
        scene_of=nothing,
        view_names=(),
        start_view=nothing,
        start_target=nothing,
        start_split=np.zeros(0, np.uint8),
    )


@contextmanager
def recorder(job: Mapping[str, Any]) -> Iterator[Work]:
    """Records scenes with one simulator, started when one has to be recorded; see `workers.spread`."""
    world, rooms = THORSettings.model_validate(job), list[WalkableRoom]()

    def record_scene(item: Item) -> bytes:
        scene = _Scene(**item)
        path = Path(scene.path)

        def make() -> None:
            if not rooms:
                rooms.append(walkable_room(world))
            while True:
                try:
                    graph = _recorded(rooms[0], scene.name, world)
                except SimulatorLost:
                    continue  # the client starts another, and gives up with an error of its own
                with writing(path.parent):
                    save_graph(graph, path, scene.key)
                return

        make_once(path, scene.key, make)
        return b""

    try:
        yield record_scene
    finally:
        for room in rooms:
            room.simulator.stop()
