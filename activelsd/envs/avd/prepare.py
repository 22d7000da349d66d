"""Makes a cached view graph from scans, photograph by photograph, and resumes an interrupted attempt."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.avd.photographs import read_photograph
from activelsd.envs.avd.scan import (
    ANNOTATIONS,
    INSTANCES,
    PHOTOGRAPHS,
    POSES,
    PRESENT,
    Scan,
    check_release,
    read_instances,
    read_scan,
)
from activelsd.envs.avd.settings import MOVES
from activelsd.envs.cache import Pictures, cache_file, fill, make_once
from activelsd.envs.cores import cores
from activelsd.envs.crops import cut_out, squashed
from activelsd.envs.digest import code_digest
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import DataError
from activelsd.sections import Colour

_AHEAD = 2
"""Photographs in progress per thread; this limits memory, at a few MB each."""


def prepare(
    folders: Sequence[Path],
    *,
    size: int,
    cache: Path,
    colour: Colour = "gray",
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """The file of the scans' views, made unless it is there.

    Its name carries a digest of name, size and time of every file it is made from, and of the code that makes
    it. Every scan is a scene, every instance in it a target named `SCAN/INSTANCE`, with the data set's
    instances as classes; all six moves are in it. Its starts are the views that show a target, all in the
    first split: `AVDSettings.graph` chooses among them.

    Args:
        folders: of the scans, of one root.
        size: side S of frames and crops in pixels.
        cache: folder to keep the file in; made if need be.
        colour: of the pictures.
        workers: how many threads decode; None for as many as there are cores.
        progress: called with the number of photographs done and of all.

    Returns:
        The path of a file that `viewgraph.load_graph` reads.

    Raises:
        DataError: a scan is broken, or the cache cannot be written. See `cache.fill` for what stays.
    """
    root = folders[0].parent
    stamps = {path.name: _stamp(path) for path in folders}
    data = {"scans": stamps, "instances": _stamp_of([root / INSTANCES])}
    key = data | {"size": size, "code": code_digest(__name__)}
    if colour != "gray":  # keys of gray pictures are older than the setting
        key["colour"] = colour
    path = cache_file(cache, root.resolve().name, size, key)

    def make() -> None:
        instances = read_instances(root)
        scans = [read_scan(folder, instances) for folder in folders]
        boxes = np.concatenate([np.bincount(scan.box_view, minlength=len(scan.files)) for scan in scans])
        ends = {"frames": np.arange(1, len(boxes) + 1), "crops": np.cumsum(boxes)}
        decoded = partial(_decoded, scans, size=size, colour=colour, workers=workers or cores())
        picture = (size, size) if colour == "gray" else (3, size, size)
        fill(path, _without_pictures(scans, instances, picture), key, ends, decoded, progress=progress)

    return make_once(path, key, make)


def _stamp(folder: Path) -> str:
    check_release(folder)
    try:
        photographs = sorted((folder / PHOTOGRAPHS).iterdir())
    except OSError as error:
        raise DataError(
            f"{folder / PHOTOGRAPHS} cannot be read ({error.strerror}); copy the scan again."
        ) from None
    return _stamp_of([*(folder / name for name in (ANNOTATIONS, POSES, PRESENT)), *photographs])


def _stamp_of(files: Sequence[Path]) -> str:
    """A digest of files' names, sizes and times; a missing file is reported when it is read."""
    digest = hashlib.sha256()
    for file in files:
        if file.exists():
            stat = file.stat()
            digest.update(f"{file.name} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:16]


def _decoded(
    scans: Sequence[Scan], todo: Sequence[int], *, size: int, colour: Colour, workers: int
) -> Generator[tuple[int, Pictures], None, None]:
    """The pictures of views by their numbers, in order.

    By threads, since OpenCV releases Python's lock: processes are no faster at 1920 x 1080 pixels, and take
    longer for small photographs.
    """
    views = list(_views(scans))
    left = iter(todo)
    with ThreadPoolExecutor(workers) as pool:
        under_way: deque[tuple[int, Future[Pictures]]] = deque()
        try:
            for number in islice(left, workers * _AHEAD):
                under_way.append((number, pool.submit(_pictures, *views[number], size, colour)))
            while under_way:
                number, future = under_way.popleft()
                yield number, future.result()
                for following in islice(left, 1):
                    under_way.append((following, pool.submit(_pictures, *views[following], size, colour)))
        finally:
            pool.shutdown(cancel_futures=True)


def _views(scans: Sequence[Scan]) -> Iterator[tuple[Scan, int]]:
    for scan in scans:
        for view in range(len(scan.files)):
            yield scan, view


def _pictures(scan: Scan, view: int, size: int, colour: Colour) -> Pictures:
    """A photograph's frame ([3,] S, S), and the crops (p, [3,] S, S) of the boxes in it."""
    file = scan.files[view]
    photograph = read_photograph(file, colour)
    height, width = photograph.shape[:2]
    if (height, width) != (scan.height, scan.width):
        raise DataError(
            f"{file} is {width} x {height} pixels, and others of its scan {scan.width} x {scan.height};"
            " copy it again."
        )
    first, end = np.searchsorted(scan.box_view, [view, view + 1])
    frame = squashed(photograph, size)
    crops = np.empty((end - first, *frame.shape), np.uint8)
    for i, box in enumerate(scan.boxes[first:end]):
        crops[i] = cut_out(photograph, box, size)
    return {"frames": frame, "crops": crops}


def _without_pictures(
    scans: Sequence[Scan], instances: dict[str, int], picture: tuple[int, ...]
) -> ViewGraph:
    """The graph of the scans; its frames and crops, of the shape `picture`, are zeros that take no memory."""
    ids, names = np.array(list(instances.values())), tuple(instances)
    views, boxes = sum(len(scan.files) for scan in scans), sum(len(scan.boxes) for scan in scans)
    if not boxes:
        raise DataError(
            f"{', '.join(scan.name for scan in scans)}: no photograph shows an instance; get"
            f" {ANNOTATIONS} again."
        )
    kinds = [np.unique(scan.box_instance) for scan in scans]  # ids of each scan's targets
    labels = np.searchsorted(ids, np.concatenate(kinds))
    pair_of = np.full((views, len(labels)), -1, np.int32)
    first_view, first_target, first_pair = 0, 0, 0
    moves, pairs = [], []
    for scan, own in zip(scans, kinds, strict=True):
        rows = first_view + scan.box_view
        columns = first_target + np.searchsorted(own, scan.box_instance)
        pair_of[rows, columns] = first_pair + np.arange(len(rows))
        pairs.append(np.stack([rows, columns], 1))
        moves.append(np.where(scan.moves >= 0, scan.moves + first_view, -1))
        first_view, first_target = first_view + len(scan.files), first_target + len(own)
        first_pair += len(rows)
    start_view, start_target = np.concatenate(pairs).T.astype(np.int32)
    return ViewGraph(
        frames=np.broadcast_to(np.uint8(0), (views, *picture)),
        moves=np.concatenate(moves).astype(np.int32),
        move_names=MOVES,
        classes=names,
        targets=tuple(
            f"{scan.name}/{names[label]}"
            for scan, own in zip(scans, kinds, strict=True)
            for label in np.searchsorted(ids, own)
        ),
        labels=labels.astype(np.int64),
        scenes=tuple(scan.name for scan in scans),
        scene_of=np.repeat(np.arange(len(scans)), [len(scan.files) for scan in scans]).astype(np.int32),
        view_names=tuple(file.stem for scan in scans for file in scan.files),
        start_view=start_view,
        start_target=start_target,
        start_split=np.zeros(boxes, np.uint8),
        pair_of=pair_of,
        boxes=np.concatenate([_fractions(scan) for scan in scans]),
        crops=np.broadcast_to(np.uint8(0), (boxes, *picture)),
        difficulty=np.concatenate([scan.difficulty for scan in scans]),
        poses=np.concatenate([scan.poses for scan in scans]),
    )


def _fractions(scan: Scan) -> NDArray[np.float32]:
    """(P, 4) cx, cy, w, h of a scan's boxes as fractions of the photograph."""
    low, high = scan.boxes[:, :2].astype(np.float64), scan.boxes[:, 2:].astype(np.float64)
    whole = (scan.width, scan.height)
    return np.concatenate([(low + high) / 2 / whole, (high - low) / whole], 1).astype(np.float32)
