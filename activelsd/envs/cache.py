"""The files that views are kept in, and those in the making: block by block, resumed where they stopped.

HDF5 is closed while views are written: its metadata is laid down first, then bytes go to known places in the
file. So a process that is killed, even by SIGKILL, leaves a file that the next one goes on with. POSIX only.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.viewgraph import ViewGraph, read_key, replace_durably, seal, write_graph
from activelsd.errors import DataError

_DONE = "done"
_KEY = "partial_key"
_FLUSH_SECONDS = 2.0


def default_cache() -> Path:
    """Where rendered views are kept: $ACTIVELSD_CACHE, or `activelsd` in the user's cache folder."""
    if "ACTIVELSD_CACHE" in os.environ:
        return Path(os.environ["ACTIVELSD_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "activelsd"


def cache_file(cache: Path, title: str, size: int, key: Mapping[str, Any]) -> Path:
    """The file of views of a title and size; its name carries a digest of what they are made from."""
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:12]
    return cache / f"{re.sub(r'[^A-Za-z0-9_.+-]', '_', title)}-{size}px-{digest}.h5"


def make_once(path: Path, key: Mapping[str, Any], fill: Callable[[], None]) -> Path:
    """The file of a graph, made by `fill` unless it is there and of this key; one process at a time.

    Raises:
        DataError: from `fill`, or the cache cannot be written; a cache that stays empty is taken away again.
    """
    if read_key(path) == key:
        return path
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with alone(path):
            if read_key(path) != key:
                fill()
    except DataError:
        with suppress(OSError):  # unless there is something else in it
            path.parent.rmdir()
        raise
    return path


class CacheError(DataError):
    """Raised when the cache cannot be written: what is wrong is not the data."""


class CacheBusyError(CacheError):
    """Raised when another process is preparing the same file."""


class PartialGraph:
    """A graph whose pictures arrive in blocks: all frames of an object, or a photograph and its crops.

    Attributes:
        done: bool (n,), the blocks whose bytes have reached the disk.
    """

    def __init__(
        self, path: Path, graph: ViewGraph, key: Mapping[str, Any], ends: Mapping[str, NDArray[np.int64]]
    ) -> None:
        """Go on with the file, or begin it where there is none of this key that can be read.

        Args:
            path: of the finished file; the one in the making is beside it.
            graph: all of it but the pictures, whose shape alone counts.
            key: what the graph is made from.
            ends: per field of pictures (n,) the row that each of the n blocks ends before, in order.

        Raises:
            CacheError: here and below, the file cannot be written.
        """
        self._path = path
        self._key = key
        self._partial = path.with_name(path.name + ".partial")
        self._bounds = {name: np.concatenate([[0], rows]) for name, rows in ends.items()}
        self._row_bytes = graph.size * graph.size
        blocks = len(next(iter(ends.values())))
        with writing(path.parent):
            self._at = self._places() or self._begin(graph, blocks)
            self._done_at = self._at[_DONE]
            self._file = self._partial.open("r+b", buffering=0)
            self._file.seek(self._done_at)
            self.done = np.frombuffer(self._file.read(blocks), np.bool_).copy()
        self._written: list[int] = []
        self._flushed = time.monotonic()

    def write(self, block: int, **pictures: NDArray[np.uint8]) -> None:
        """Put a block's rows of all fields in place; it counts as done from the next flush, seconds later."""
        assert pictures.keys() == self._bounds.keys()
        for name, rows in pictures.items():
            first, end = self._bounds[name][block : block + 2]
            assert rows.size == (end - first) * self._row_bytes
            self._put(self._at[name] + int(first) * self._row_bytes, rows.tobytes())
        self._written.append(block)
        if time.monotonic() - self._flushed > _FLUSH_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Bring the pictures to the disk, and only then say that they are there."""
        with writing(self._path.parent):
            os.fsync(self._file.fileno())
        for block in self._written:
            self._put(self._done_at + block, b"\1")
            self.done[block] = True
        self._written.clear()
        self._flushed = time.monotonic()

    def finish(self) -> None:
        """Make it a whole graph, under its own name."""
        self.flush()
        assert self.done.all()
        self._file.close()
        with writing(self._path.parent):
            with h5py.File(self._partial, "r+") as file:
                del file[_DONE], file.attrs[_KEY]
                seal(file, self._key)
            replace_durably(self._partial, self._path)

    def leave(self, *, keep: bool) -> None:
        """Stop here: what is done stays to be gone on with, if there is any and it is worth keeping."""
        try:
            self.flush()
        finally:
            self._file.close()
            if not (keep and self.done.any()):
                self._partial.unlink()

    def _put(self, place: int, data: bytes) -> None:
        with writing(self._path.parent):
            self._file.seek(place)
            self._write_all(data)

    def _write_all(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]

    def _places(self) -> dict[str, int] | None:
        """Where pictures and done marks stand in the file; None where there is none to go on with."""
        try:
            with h5py.File(self._partial, "r") as file:
                if file.attrs.get(_KEY) != json.dumps(self._key, sort_keys=True):
                    return None
                return {name: file[name].id.get_offset() for name in (*self._bounds, _DONE)}
        except OSError:
            return None

    def _begin(self, graph: ViewGraph, blocks: int) -> dict[str, int]:
        with h5py.File(self._partial, "w") as file:
            write_graph(file, graph, skip=frozenset(self._bounds))
            places = {name: _allot(file, name, getattr(graph, name).shape) for name in self._bounds}
            places[_DONE] = _allot(file, _DONE, (blocks,))
            file.attrs[_KEY] = json.dumps(self._key, sort_keys=True)
        return places


def _allot(file: h5py.File, name: str, shape: tuple[int, ...]) -> int:
    """Make a dataset of zeros in one piece, and tell where in the file it stands."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_obj_track_times(False)  # the same views make the same bytes, whenever
    space = h5py.h5s.create_simple(shape)
    dataset = h5py.h5d.create(file.id, name.encode(), h5py.h5t.NATIVE_UINT8, space, dcpl=properties)
    place: int = dataset.get_offset()
    return place


@contextmanager
def writing(cache: Path) -> Iterator[None]:
    """Say of what the system refuses here that it is the cache: no room, no right, something in the way."""
    try:
        yield
    except OSError as error:
        reason = f"The cache {cache} cannot be written ({error.strerror or error})"
        raise CacheError(f"{reason}; make room there or choose another by env.cache.") from None


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Keep other processes from preparing the same file; a lock falls with its process.

    Raises:
        CacheBusyError: another process has it.
        CacheError: it cannot be written.
    """
    lock = path.with_name(path.name + ".lock")
    while True:
        with writing(path.parent):
            file = lock.open("a")
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise CacheBusyError(f"Another process is preparing {path}; wait until it is done.") from None
            if not _is_at(file.fileno(), lock):  # removed by the one who had it, after this one opened it
                continue
            try:
                yield
            finally:
                lock.unlink(missing_ok=True)
            return


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
