"""Renders a dataset into a cached view graph, on all cores; objects that are in the cache are copied."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from activelsd.envs.cache import Pictures, cache_file, fill, make_once
from activelsd.envs.cores import cores
from activelsd.envs.digest import code_digest
from activelsd.envs.modelnet import sources
from activelsd.envs.modelnet.datasets import Dataset
from activelsd.envs.modelnet.sources import AZIMUTHS, PictureFiles
from activelsd.envs.viewgraph import SPLITS, ViewGraph, load_graph
from activelsd.envs.workers import spread
from activelsd.errors import DataError

_SHARE = 16
"""Objects for which starting another process, a third of a second, is worth it."""


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

    Its name carries a digest of the objects, the settings, and the code that renders, so that files of other
    settings stand beside it. Views of an object that stand in such a file already are copied: they depend on
    its own files alone, not on the split, the classes, or the other objects. A file that cannot be read is
    made anew: nothing but this function writes under such a name.

    Every object is one scene with one target, `CLASS/OBJECT`, seen from 12 azimuths by E elevations,
    elevation after elevation; views are named like `e30_a090`. Episodes start at the 12 views of the first
    elevation, all in the first split: `open_views` puts them in those of the dataset. There are no moves:
    `orbit.with_moves` adds those asked for.

    Args:
        dataset: the objects.
        size: side S of the views in pixels.
        elevations: of the cameras in degrees; pictures rendered by others stand for a single one.
        cache: folder to keep the file in; made if need be.
        workers: how many processes render; None for as many as there are cores and work.
        progress: called with the number of objects done and of all, at the start and after every object.

    Returns:
        The path of a file that `open_views` reads.

    Raises:
        DataError: an object is broken, or the cache cannot be written. See `cache.fill` for what stays.
    """
    if isinstance(dataset.source, PictureFiles) and len(elevations) > 1:
        raise DataError(
            f"{dataset.source.files.root} holds pictures of a single ring of views, so elevations"
            f" {list(elevations)} cannot be had from it; name one, or give meshes."
        )
    levels = [float(elevation) for elevation in elevations]
    made_by = {"size": size, "elevations": levels, "code": code_digest(sources.__name__)}
    names = _frame_names(dataset, made_by)
    objects = _digest([(item.name, name) for item, name in zip(dataset.items, names, strict=True)])
    key = {"dataset": dict(dataset.origin), "objects": objects} | made_by
    path = cache_file(cache, dataset.title, size, key)

    def rendered(todo: list[int]) -> Generator[tuple[int, Pictures], None, None]:
        count = max(1, min(workers or cores(), len(todo) // _SHARE))
        job = {"source": dataset.source.spec(), "size": size, "elevations": levels}
        items = ((i, asdict(dataset.items[i])) for i in todo)
        with closing(spread(f"{sources.__name__}:renderer", job, items, processes=count)) as views:
            for i, data in views:
                yield i, {"frames": np.frombuffer(data, np.uint8)}

    def make() -> None:
        graph = _without_frames(dataset, size, elevations)
        ends = np.arange(1, len(names) + 1) * (len(graph.frames) // len(names))
        fill(path, graph, key, {"frames": ends}, rendered, names=names, progress=progress)

    return make_once(path, key, make)


def open_views(file: Path, dataset: Dataset) -> ViewGraph:
    """The graph in a file that `prepare` made for a dataset, with the starts in the dataset's splits."""
    splits = np.array([SPLITS.index(item.split) for item in dataset.items], np.uint8)
    graph = load_graph(file)
    return replace(graph, start_split=splits[graph.start_target])


def _frame_names(dataset: Dataset, made_by: Mapping[str, Any]) -> list[str]:
    """For each object a digest of all that its frames are made from, its name and split not among it."""
    return [
        _digest([dict(dataset.origin), made_by, item.category, item.parts, item.stamp])
        for item in dataset.items
    ]


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:20]


def _without_frames(dataset: Dataset, size: int, elevations: Sequence[float]) -> ViewGraph:
    """The graph of a dataset's views; its frames are zeros that take no memory, its starts in one split."""
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
        start_split=np.zeros(len(items) * around, np.uint8),
    )
