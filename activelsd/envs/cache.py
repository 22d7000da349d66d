"""The files that views are kept in: each is made once, block by block, and resumed after an interruption.

HDF5 is closed while views are written: its metadata is written first, then bytes go to known places in the
file. So a process that is killed, even by SIGKILL, leaves a file that the next one goes on with.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import re
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.locks import locked
from activelsd.envs.viewgraph import (
    FORMAT,
    ViewGraph,
    open_hdf5,
    read_key,
    replace_durably,
    seal,
    write_graph,
)
from activelsd.errors import CacheError, DataError

Pictures = Mapping[str, NDArray[np.uint8]]
"""Rows of a block by the field of the graph, such as `frames`."""

_LOG = logging.getLogger("activelsd")
_DONE, _NAMES = "done", "block_names"
_KEY = "partial_key"
_FLUSH_SECONDS = 2.0
_TITLE = 160  # letters of a title in a file's name, which has 255 at most
_COMMAND = 120  # characters of a command line that others are told


def default_cache() -> Path:
    """Where rendered views are kept: $ACTIVELSD_CACHE, or `activelsd` in the user's cache folder."""
    if "ACTIVELSD_CACHE" in os.environ:
        return Path(os.environ["ACTIVELSD_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "activelsd"


def cache_file(cache: Path, title: str, size: int, key: Mapping[str, Any]) -> Path:
    """The file of views of a title and size; its name carries a digest of what they are made from."""
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:12]
    word = re.sub(r"[^A-Za-z0-9_.+-]", "_", title)[:_TITLE]
    return cache / f"{word}-{size}px-{digest}.h5"


def make_once(path: Path, key: Mapping[str, Any], make: Callable[[], None]) -> Path:
    """The file of a graph, made by `make` unless it is there with this key; one process makes it at a time.

    Raises:
        DataError: raised by `make`, or the cache cannot be written; an empty cache is removed again.
    """
    if read_key(path) == key:
        return path
    try:
        with alone(path):
            if read_key(path) != key:
                make()
    except DataError:
        with suppress(OSError):  # there is something else in it
            path.parent.rmdir()
        raise
    return path


def fill(
    path: Path,
    graph: ViewGraph,
    key: Mapping[str, Any],
    ends: Mapping[str, NDArray[np.int64]],
    make: Callable[[list[int]], Generator[tuple[int, Pictures], None, None]],
    *,
    names: Sequence[str] | None = None,
    check: Callable[[list[int]], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Make the pictures of a graph that are not there yet, and the file of it all.

    Whatever ends it early, KeyboardInterrupt included, what is done stays for the next time: for this file,
    and under its names for others. Blocks without names are dropped after a DataError, since without what is
    broken the data are others.

    Args:
        path: of the file.
        graph: see `PartialGraph`, as `key` and `ends`.
        key: what the graph is made from.
        ends: rows of the blocks.
        make: makes the blocks of these numbers, in any order; closed at the end.
        names: (n,) per block a name that no other frames have; frames of these names are copied from files of
            the same title and size, unfinished ones too. Blocks are scenes then, and have no crops.
        check: called with the numbers of the blocks that `make` is to make, before anything is made.
        progress: called with the number of blocks done and of all, at the start and after every block.
    """
    report = progress or (lambda done, total: None)
    partial = PartialGraph(path, graph, key, ends, names)
    try:
        todo, total = set(np.flatnonzero(~partial.done).tolist()), len(partial.done)
        known = _elsewhere(path, {name: i for i, name in enumerate(names or ()) if i in todo})
        todo -= known.keys()
        if check is not None:
            check(sorted(todo))
        for block, frames in _frames(known):
            partial.write(block, frames=frames)
        report(total - len(todo), total)
        with closing(make(sorted(todo))) as made:
            for block, pictures in made:
                partial.write(block, **pictures)
                todo.remove(block)
                report(total - len(todo), total)
    except BaseException as error:
        broken = isinstance(error, DataError) and not isinstance(error, CacheError)
        partial.leave(keep=names is not None or not broken)
        raise
    partial.finish()
    _tidy(path, set(names or ()))


def _elsewhere(path: Path, wanted: dict[str, int]) -> dict[int, tuple[Path, int]]:
    """By number of the blocks wanted by name: the other file that has it, and its number there."""
    found = {}
    for file in _files_beside(path, "*.h5") + _files_beside(path, "*.h5.partial"):
        for number, name in enumerate(read_names(file) if wanted else ()):
            if name in wanted:
                found[wanted.pop(name)] = file, number
    return found


def _files_beside(path: Path, ending: str) -> list[Path]:
    """Other files of the same title and size."""
    found = sorted(path.parent.glob(f"{path.name.rpartition('-')[0]}-{ending}"))
    return [file for file in found if file.name.removesuffix(".partial") != path.name]


def _frames(known: Mapping[int, tuple[Path, int]]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Blocks with their frames from the files that have them."""
    by_file: dict[Path, list[tuple[int, int]]] = {}
    for block, (file, number) in known.items():
        by_file.setdefault(file, []).append((block, number))
    for file, blocks in by_file.items():
        with open_hdf5(file) as content:
            data, scene_of = content["frames"], content["scene_of"][:]
            offset, shape = data.id.get_offset(), data.shape
        frames = np.memmap(file, np.uint8, "r", offset, shape)
        for block, number in blocks:
            first, end = np.searchsorted(scene_of, [number, number + 1])
            yield block, frames[first:end]


def _tidy(path: Path, names: AbstractSet[str]) -> None:
    """Removes unfinished files that nobody works on and that hold nothing but what a finished one has."""
    for file in _files_beside(path, "*.h5.partial"):
        held = set(read_names(file)) - {""}
        locks = file.parent.glob(f"{file.stem}.lock*")
        if held and held <= names and not any(locks):
            with suppress(OSError):
                file.unlink()


class PartialGraph:
    """A graph whose pictures arrive in blocks: all frames of an object, or a photograph and its crops.

    Attributes:
        done: bool (n,), the blocks whose bytes have reached the disk.
    """

    def __init__(
        self,
        path: Path,
        graph: ViewGraph,
        key: Mapping[str, Any],
        ends: Mapping[str, NDArray[np.int64]],
        names: Sequence[str] | None = None,
    ) -> None:
        """Go on with the file, or begin it if there is none of this key that can be read.

        Args:
            path: of the finished file; the unfinished one is beside it.
            graph: all of it but the pictures, of which only the shape counts.
            key: what the graph is made from.
            ends: per field of pictures (n,) the row that each of the n blocks ends before, in order.
            names: (n,) of the blocks, kept in the file if given.

        Raises:
            CacheError: here and below, the file cannot be written.
        """
        self._path = path
        self._key = key
        self._partial = path.with_name(path.name + ".partial")
        self._bounds = {name: np.concatenate([[0], rows]) for name, rows in ends.items()}
        self._row_bytes = math.prod(graph.frames.shape[1:])
        blocks = len(next(iter(ends.values())))
        with writing(path.parent):
            self._at = self._places() or self._begin(graph, blocks, names)
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
        """Bring the pictures to the disk, and only then mark them as done."""
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
            with open_hdf5(self._partial, "r+") as file:
                del file[_DONE], file.attrs[_KEY]
                seal(file, self._key)
            replace_durably(self._partial, self._path)

    def leave(self, *, keep: bool) -> None:
        """Stop here; what is done stays for the next time if `keep` and there is any."""
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
        """Offsets of pictures and done marks in the file; None if there is none to go on with."""
        try:
            with open_hdf5(self._partial) as file:
                if file.attrs.get(_KEY) != json.dumps(self._key, sort_keys=True):
                    return None
                return {name: file[name].id.get_offset() for name in (*self._bounds, _DONE)}
        except OSError:
            return None

    def _begin(self, graph: ViewGraph, blocks: int, names: Sequence[str] | None) -> dict[str, int]:
        with open_hdf5(self._partial, "w") as file:
            write_graph(file, graph, skip=frozenset(self._bounds))
            if names is not None:
                file.create_dataset(_NAMES, data=np.array(names, np.bytes_))
            places = {name: _allot(file, name, getattr(graph, name).shape) for name in self._bounds}
            places[_DONE] = _allot(file, _DONE, (blocks,))
            file.attrs[_KEY] = json.dumps(self._key, sort_keys=True)
        return places


def _allot(file: h5py.File, name: str, shape: tuple[int, ...]) -> int:
    """Make a contiguous dataset of zeros and return its offset in the file."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_obj_track_times(False)  # the same views make the same bytes, whenever
    space = h5py.h5s.create_simple(shape)
    dataset = h5py.h5d.create(file.id, name.encode(), h5py.h5t.NATIVE_UINT8, space, dcpl=properties)
    place: int = dataset.get_offset()
    return place


def read_names(path: Path) -> list[str]:
    """Names of the blocks of a file, empty for those that are not done; none if it has no names."""
    try:
        with open_hdf5(path) as file:
            if _NAMES not in file or not (file.attrs.get("format") == FORMAT or _DONE in file):
                return []
            names = [name.decode() for name in file[_NAMES][:].tolist()]
            done = file[_DONE][:].tolist() if _DONE in file else [1] * len(names)
            return [name if there else "" for name, there in zip(names, done, strict=True)]
    except OSError:  # no such file, or not whole
        return []


@contextmanager
def writing(cache: Path) -> Iterator[None]:
    """Turn an OSError inside into a CacheError that names the cache folder."""
    try:
        yield
    except OSError as error:
        reason = f"The cache {cache} cannot be written ({error.strerror or error})"
        raise CacheError(f"{reason}; make room there or choose another by env.cache.") from None


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Keep other processes from preparing the same file; wait as long as another one does.

    The folder is made if need be. After waiting, the file may be there.

    Raises:
        CacheError: the lock's file cannot be written.
    """

    def waiting(holder: str) -> None:
        _LOG.warning("Waiting for %s, which is preparing %s.", holder, path)

    lock = path.with_name(path.name + ".lock")
    with ExitStack() as held:
        with writing(path.parent):
            note = f"process {os.getpid()} ({_command()})"
            held.enter_context(locked(lock, note, waiting))
        yield


def _command() -> str:
    """The command line of this process in one line, cut if it is long."""
    command = " ".join(" ".join(sys.argv).split())
    return command if len(command) <= _COMMAND else f"{command[:_COMMAND]}…"
