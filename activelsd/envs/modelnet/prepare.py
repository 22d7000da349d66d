"""Renders a dataset into a cached view graph, on all cores, going on where an earlier attempt stopped."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from contextlib import closing
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from activelsd.envs.cache import CacheError, PartialGraph, cache_file, make_once
from activelsd.envs.cores import cores
from activelsd.envs.modelnet.datasets import Dataset
from activelsd.envs.modelnet.sources import AZIMUTHS, PictureFiles, Source
from activelsd.envs.modelnet.workers import rendered
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import ConfigError, DataError

_SHARE = 16
"""Objects that make starting another process worth its third of a second."""


def prepare(
    dataset: Dataset,
    *,
    size: int,
    elevations: Sequence[float],
    cache: Path,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """The file of a dataset's views, rendered unless it is there.

    Its name carries a digest of what it is made from, and of the code that makes it, so that settings live
    side by side and a change makes a file anew. One that is there but cannot be read, or is of another key,
    is made anew too: nothing but this function writes under such a name.

    Every object is one scene with one target, `CLASS/OBJECT`, seen from 12 azimuths by E elevations,
    elevation after elevation; views are named like `e30_a090`. Episodes start at the 12 views of the first
    elevation. There are no moves: `orbit.with_moves` adds those asked for.

    Args:
        dataset: the objects.
        size: side S of the views in pixels.
        elevations: of the cameras in degrees; pictures rendered by others stand for a single one.
        cache: folder to keep the file in; made if need be.
        workers: how many processes render; None for as many as there are cores and work.
        progress: called with the number of objects done and of all, at the start and after every object.

    Returns:
        The path of a file that `viewgraph.load_graph` reads.

    Raises:
        ConfigError: size or elevations cannot be.
        DataError: an object is broken, or the cache cannot be written or is being prepared elsewhere. After
            a broken object nothing stays behind, since without it the dataset is another; after anything
            else, KeyboardInterrupt included, what is done stays and is gone on with next time.
    """
    _check(dataset, size, elevations)
    levels = [float(elevation) for elevation in elevations]
    key = {"dataset": dict(dataset.key), "size": size, "elevations": levels, "code": _code(dataset.source)}
    path = cache_file(cache, dataset.title, size, key)
    return make_once(path, key, lambda: _fill(dataset, size, levels, path, key, workers, progress))


def _check(dataset: Dataset, size: int, elevations: Sequence[float]) -> None:
    if size < 1:
        raise ConfigError(f"Views of {size} pixels cannot be; choose a size of at least 1.")
    if not elevations or len(set(elevations)) < len(elevations):
        raise ConfigError(f"Elevations {list(elevations)} cannot be; name at least one, and none twice.")
    if not all(math.isfinite(e) and abs(e) <= 90 for e in elevations):
        raise ConfigError(f"Elevations {list(elevations)} cannot be; they go from -90 to 90 degrees.")
    if isinstance(dataset.source, PictureFiles) and len(elevations) > 1:
        raise DataError(
            f"{dataset.source.files.root} holds pictures of a single ring of views, so elevations"
            f" {list(elevations)} cannot be had from it; name one, or give meshes."
        )


def _code(source: Source) -> str:
    """A digest of the modules that a source's pictures depend on."""
    package = resources.files("activelsd.envs.modelnet")
    digest = hashlib.sha256()
    for pattern in source.code:
        folder, _, name = pattern.rpartition("/")
        for module in sorted((package / folder).iterdir(), key=lambda m: m.name):
            if module.name == name or (name == "*.py" and module.name.endswith(".py")):
                digest.update(module.read_bytes())
    return digest.hexdigest()


def _fill(
    dataset: Dataset,
    size: int,
    elevations: Sequence[float],
    path: Path,
    key: dict[str, Any],
    workers: int | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    report = progress or (lambda done, total: None)
    graph = _without_frames(dataset, size, elevations)
    ends = np.arange(1, len(dataset.items) + 1) * (len(graph.frames) // len(dataset.items))
    partial = PartialGraph(path, graph, key, {"frames": ends})
    try:
        todo = np.flatnonzero(~partial.done).tolist()
        done, total = len(dataset.items) - len(todo), len(dataset.items)
        report(done, total)
        views = rendered(
            dataset.source,
            [(i, dataset.items[i]) for i in todo],
            size=size,
            elevations=elevations,
            processes=max(1, min(workers or cores(), len(todo) // _SHARE)),
        )
        with closing(views):
            for i, frames in views:
                partial.write(i, frames=frames)
                done += 1
                report(done, total)
    except BaseException as error:
        partial.leave(keep=isinstance(error, CacheError) or not isinstance(error, DataError))
        raise
    partial.finish()


def _without_frames(dataset: Dataset, size: int, elevations: Sequence[float]) -> ViewGraph:
    """The graph of a dataset's views; its frames are zeros that take no room."""
    items, around = dataset.items, len(AZIMUTHS)
    ring = [f"e{elevation:g}_a{azimuth:03d}" for elevation in elevations for azimuth in AZIMUTHS]
    first = np.arange(len(items)) * len(ring)
    names = tuple(item.name for item in items)
    return ViewGraph(
        frames=np.broadcast_to(np.uint8(0), (len(items) * len(ring), size, size)),
        moves=np.zeros((len(items) * len(ring), 0), np.int32),
        move_names=(),
        classes=dataset.classes,
        targets=names,
        labels=np.array([dataset.classes.index(item.category) for item in items], np.int64),
        scenes=names,
        scene_of=np.repeat(np.arange(len(items), dtype=np.int32), len(ring)),
        view_names=tuple(ring) * len(items),
        start_view=(first[:, None] + np.arange(around)).ravel().astype(np.int32),
        start_target=np.repeat(np.arange(len(items), dtype=np.int32), around),
        start_split=np.repeat(np.array([SPLITS.index(item.split) for item in items], np.uint8), around),
    )
