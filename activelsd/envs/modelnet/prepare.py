"""Renders a dataset into a cached view graph, on all cores; objects that are in the cache are copied."""

from __future__ import annotations

import hashlib
import json
import logging
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.cache import Pictures, cache_file, fill, make_once, writing
from activelsd.envs.cores import cores
from activelsd.envs.digest import code_digest
from activelsd.envs.modelnet import geometry, sources
from activelsd.envs.modelnet.broken import BrokenObjects, note, noted, without
from activelsd.envs.modelnet.cameras import Rig, Rings
from activelsd.envs.modelnet.datasets import Dataset
from activelsd.envs.modelnet.settings import AZIMUTHS
from activelsd.envs.modelnet.sources import Item, PictureFiles, Shapes
from activelsd.envs.settings import Progress, stage
from activelsd.envs.viewgraph import SPLITS, ViewGraph, load_graph
from activelsd.envs.workers import spread
from activelsd.errors import DataError

_LOG = logging.getLogger("activelsd")
Shows = Literal["shaded", "depth", "panorama"]
_SHARE = 16
"""Objects for which starting another process, a third of a second, is worth it."""


def prepare(
    dataset: Dataset,
    *,
    size: int,
    rig: Rig,
    cache: Path,
    shows: Shows = "shaded",
    workers: int | None = None,
    check: bool = True,
    progress: Progress | None = None,
) -> Path:
    """The file of a dataset's views, rendered unless it is there.

    Its name carries a digest of the objects, the settings, and the code that renders, so that files of other
    settings stand beside it. Views of an object that stand in such a file already are copied: they depend on
    its own files alone, not on the split, the classes, or the other objects. A file that cannot be read is
    made anew: nothing but this function writes under such a name.

    Every object is one scene with one target, `CLASS/OBJECT`, seen by the cameras of its rig (see `rigs_of`)
    in order; views are named like `e30_a090`. Episodes start at the rig's first views, all in the first
    split: `open_views` puts them in those of the dataset. There are no moves: `orbit.with_moves` adds those
    asked for.

    Args:
        dataset: the objects.
        size: side S of the views in pixels.
        rig: the cameras.
        cache: folder to keep the file in; made if need be.
        shows: what the views are; depths are as `scenery.depths` has them, and a panorama has its own size.
        workers: how many processes render; None for as many as there are cores and work.
        check: read all objects before any is rendered.
        progress: called with the number of objects done and of all, at the start and after every object.

    Returns:
        The path of a file that `open_views` reads.

    Raises:
        BrokenObjects: objects are broken; all of them are named. Views that are made stay.
        DataError: the cache cannot be written, or pictures were not taken by such cameras.
    """
    rigs = rigs_of(dataset, rig)
    made_by = _made_by(size, rig, shows)
    names = _frame_names(dataset, made_by)
    objects = _digest([(item.name, name) for item, name in zip(dataset.items, names, strict=True)])
    key = {"dataset": dict(dataset.origin), "objects": objects} | made_by
    title = dataset.title if shows == "shaded" else f"{dataset.title}-{shows}"
    path = cache_file(cache, title, size, key)

    job = {"source": dataset.source.spec(), "size": size, "cameras": made_by["cameras"], "kind": shows}
    module = _drawn_by(shows)

    def work(what: str, todo: list[int]) -> Generator[tuple[int, bytes], None, None]:
        """Results of a function of the module that draws; raises BrokenObjects at the end if any are."""
        count, broken = max(1, min(workers or cores(), len(todo) // _SHARE)), {}
        in_order = sorted(todo, key=lambda i: dataset.items[i].parts)  # rows of one file are read fast
        items = ((i, asdict(dataset.items[i])) for i in in_order)
        with closing(spread(f"{module}:{what}", job, items, processes=count)) as results:
            for i, data in results:
                if data[:1] == sources.BROKEN:
                    broken[i] = data[1:].decode()
                yield i, data
        if broken:
            raise BrokenObjects(dataset, broken)

    def read_all(todo: list[int]) -> None:
        report = stage(progress, "Checking objects")
        for done, _ in enumerate(work("checker", todo)):
            report(done + 1, len(todo))

    def rendered(todo: list[int]) -> Generator[tuple[int, Pictures], None, None]:
        for i, data in work("renderer", todo):
            if data[:1] != sources.BROKEN:
                yield i, {"frames": np.frombuffer(data, np.uint8, offset=1)}

    def make() -> None:
        _tell_differences(dataset, rigs)
        ends = np.cumsum([len(one.cameras) for one in rigs])
        coloured = isinstance(dataset.source, PictureFiles) and dataset.source.colour == "rgb"
        picture = (3, size, size) if coloured else (_height(shows, size), size)
        graph = _without_frames(dataset, rigs, picture, ends)
        only_read = isinstance(dataset.source, Shapes | PictureFiles)  # there is nothing to do before
        first = read_all if check and not only_read else None
        fill(path, graph, key, {"frames": ends}, rendered, names=names, check=first, progress=progress)

    return make_once(path, key, make)


def rigs_of(dataset: Dataset, rig: Rig) -> list[Rig]:
    """The cameras of every object: the rig, or those that its pictures by others were taken with.

    Pictures stand on one ring, evenly spaced, unless their names tell where; or on the dodecahedron if that
    is the rig, as their number does not tell a ring from it.

    Raises:
        DataError: the pictures were not taken with such a rig.
    """
    if not isinstance(dataset.source, PictureFiles):
        return [rig] * len(dataset.items)
    root = dataset.source.files.root
    if isinstance(rig, Rings) and rig.climbs:
        raise DataError(
            f"{root} holds pictures, and only their names can tell elevations, as in cup_e30_a090.png; leave"
            " out env.elevations, or give meshes."
        )
    return [_rig_of(item, rig, root) for item in dataset.items]


def _rig_of(item: Item, rig: Rig, root: Path) -> Rig:
    count = len(item.parts)
    if item.fault:
        return rig  # its pictures cannot be had, however many there are
    if isinstance(rig, Rings):
        (ring,), asked = rig.rings, rig.starts
        if asked not in (AZIMUTHS, count):
            raise DataError(
                f"'{item.name}' in {root} has {count} pictures, not {asked}; leave out env.azimuths."
            )
        return Rings(item.rings) if item.rings else Rings.even(count, [ring.elevation])
    if item.rings or count != len(rig.cameras):
        raise DataError(
            f"'{item.name}' in {root} has {count} pictures, not one for each of a dodecahedron's"
            f" {len(rig.cameras)} vertices in order; leave out env.cameras."
        )
    return rig


def _tell_differences(dataset: Dataset, rigs: Sequence[Rig]) -> None:
    """Logs how many views objects have if that differs: a view may be missing from the end of some."""
    counts = Counter(len(rig.cameras) for rig in rigs)
    if len(counts) == 1:
        return
    rare = min(counts, key=lambda views: (counts[views], views))
    example = next(i.name for i, rig in zip(dataset.items, rigs, strict=True) if len(rig.cameras) == rare)
    shown = ", ".join(f"{views} views of {n}" for views, n in sorted(counts.items()))
    _LOG.warning(
        "Objects of %s have different numbers of views: %s; '%s' has %d.", dataset.title, shown, example, rare
    )


def open_views(file: Path, dataset: Dataset) -> ViewGraph:
    """The graph in a file that `prepare` made for a dataset, with the starts in the dataset's splits."""
    splits = np.array([SPLITS.index(item.split) for item in dataset.items], np.uint8)
    graph = load_graph(file)
    return replace(graph, start_split=splits[graph.start_target])


def prepared_views(
    dataset: Dataset,
    *,
    size: int,
    rig: Rig,
    cache: Path,
    shows: Shows = "shaded",
    skip_broken: bool = False,
    progress: Progress | None = None,
) -> ViewGraph:
    """The views of a dataset, rendered unless they are there.

    Args:
        dataset: the objects.
        size: as `prepare`.
        rig: as `prepare`.
        cache: as `prepare`.
        shows: as `prepare`.
        skip_broken: leave out broken objects; the graph names them, as does the screen. Those that were found
            broken before are tried again, by themselves: what cannot be read may be readable now.
        progress: as `prepare`.

    Raises:
        DataError: as `prepare`; or a class is left with nothing to train or test on.
    """
    if not skip_broken:
        views = prepare(dataset, size=size, rig=rig, cache=cache, shows=shows, progress=progress)
        return open_views(views, dataset)
    made_by = _made_by(size, rig, shows)
    names = _frame_names(dataset, made_by)
    file = cache / f"broken-{_digest(names)}.json"
    known = noted(file)
    reasons = {i: item.fault for i, item in enumerate(dataset.items) if item.fault}
    again = [i for i, name in enumerate(names) if name in known and i not in reasons]
    tried = {i: _breaks(dataset, dataset.items[i], size, rig) for i in again}
    reasons = dict(sorted({**reasons, **{i: reason for i, reason in tried.items() if reason}}.items()))
    prepare_sound = partial(prepare, size=size, rig=rig, cache=cache, shows=shows, progress=progress)
    found, path = _without_broken(dataset, reasons, prepare_sound)
    if found != reasons:
        with writing(cache):
            note(file, names, found)
    left_out = tuple(dataset.items[i].name for i in found)
    sound = tuple(item for i, item in enumerate(dataset.items) if i not in found)
    return replace(open_views(path, replace(dataset, items=sound)), left_out=left_out)


def _without_broken(
    dataset: Dataset, reasons: Mapping[int, str], make: Callable[..., Path], *, check: bool = True
) -> tuple[dict[int, str], Path]:
    """Prepares the objects that are not broken; returns why the others are, and the file."""
    sound = without(dataset, reasons)
    try:
        return dict(reasons), make(sound, check=check)
    except BrokenObjects as error:
        place = {item.name: i for i, item in enumerate(dataset.items)}
        found = {place[sound.items[i].name]: reason for i, reason in error.reasons.items()}
    # The others were read well.
    return _without_broken(dataset, dict(sorted({**reasons, **found}.items())), make, check=False)


def _breaks(dataset: Dataset, item: Item, size: int, rig: Rig) -> str | None:
    """Why an object cannot be rendered; None if it can be."""
    try:
        dataset.source.views(item, size=size, cameras=rig.cameras)
    except DataError as error:
        return str(error)
    return None


def _drawn_by(shows: Shows) -> str:
    """The module that draws."""
    return sources.__name__ if shows == "shaded" else geometry.__name__


def _height(shows: Shows, size: int) -> int:
    """Rows of a view of `size` columns."""
    if shows != "panorama":
        return size
    from activelsd.scenery.panorama import ROWS  # embree is not needed for pictures

    return ROWS


def _made_by(size: int, rig: Rig, shows: Shows) -> dict[str, Any]:
    made_by = {
        "size": size,
        "cameras": [list(camera) for camera in rig.cameras],
        "code": code_digest(_drawn_by(shows)),
    }
    return made_by if shows == "shaded" else made_by | {"shows": shows}  # caches of pictures are older


def _frame_names(dataset: Dataset, made_by: Mapping[str, Any]) -> list[str]:
    """For each object a digest of all that its frames are made from, its name and split not among it."""
    return [
        _digest([dict(dataset.origin), made_by, item.category, item.parts, item.stamp])
        for item in dataset.items
    ]


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:20]


def _without_frames(
    dataset: Dataset, rigs: Sequence[Rig], picture: tuple[int, ...], ends: NDArray[np.int64]
) -> ViewGraph:
    """The graph of a dataset's views; its frames are zeros that take no memory, its starts in one split.

    Args:
        dataset: the objects.
        rigs: the cameras of each.
        picture: shape of a view.
        ends: the view that those of each object end before.
    """
    items, views = dataset.items, int(ends[-1])
    names = tuple(item.name for item in items)
    starts = [
        range(end - len(rig.cameras), end - len(rig.cameras) + rig.starts)
        for rig, end in zip(rigs, ends.tolist(), strict=True)
    ]
    return ViewGraph(
        frames=np.broadcast_to(np.uint8(0), (views, *picture)),
        moves=np.zeros((views, 0), np.int32),
        move_names=(),
        classes=dataset.classes,
        targets=names,
        labels=np.array([dataset.classes.index(item.category) for item in items], np.int64),
        scenes=names,
        scene_of=np.repeat(np.arange(len(items), dtype=np.int32), np.diff(ends, prepend=0)),
        view_names=tuple(camera.name for rig in rigs for camera in rig.cameras),
        start_view=np.concatenate(starts).astype(np.int32),
        start_target=np.repeat(np.arange(len(items), dtype=np.int32), [len(some) for some in starts]),
        start_split=np.zeros(sum(map(len, starts)), np.uint8),
    )
