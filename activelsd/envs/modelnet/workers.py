"""Rendering processes: both ends of the pipe between one that prepares a dataset and those that render.

They are programs of their own, see `activelsd.subprogram`; the end of their input ends them, so none outlives
its parent.
"""

from __future__ import annotations

import json
import os
import selectors
import struct
import subprocess
import sys
import traceback
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.sources import Item, Source, source_from
from activelsd.errors import ActiveLSDError, DataError
from activelsd.subprogram import start

_AHEAD = 2
"""Items a process is given at a time, so that it has the next at hand when it is done with one."""

_HEAD = struct.Struct("<cQ")
_VIEWS, _DATA_ERROR, _CRASH = b"v", b"e", b"c"


class _Worker(NamedTuple):
    process: subprocess.Popen[bytes]
    given: deque[tuple[int, Item]]  # asked for and not yet answered, in order


def rendered(
    source: Source,
    items: Iterable[tuple[int, Item]],
    *,
    size: int,
    elevations: Sequence[float],
    processes: int,
) -> Generator[tuple[int, NDArray[np.uint8]], None, None]:
    """The views of numbered items, as they get done; close the iterator to end the processes early.

    Args:
        source: what the items are made from.
        items: with the number each is given back under.
        size: side of the views in pixels.
        elevations: of the cameras in degrees.
        processes: how many render; 1 renders in this one.

    Yields:
        The number and the uint8 (V, size, size) of an item.

    Raises:
        DataError: an item is broken.
        ActiveLSDError: a process died.
    """
    if processes == 1:
        for number, item in items:
            yield number, source.views(item, size=size, elevations=elevations)
        return
    job = {"source": source.spec(), "size": size, "elevations": list(elevations)}
    queue = iter(items)
    crew: list[_Worker] = []
    try:
        with selectors.DefaultSelector() as selector:
            for _ in range(processes):
                crew.append(_Worker(start(__name__), deque()))
                _tell(crew[-1], job)
                for _ in range(_AHEAD):
                    _give(crew[-1], queue)
                selector.register(_pipe(crew[-1].process.stdout), selectors.EVENT_READ, crew[-1])
            while any(worker.given for worker in crew):
                for ready, _ in selector.select():
                    worker = ready.data
                    data = _answer(worker)
                    number, _ = worker.given.popleft()
                    _give(worker, queue)
                    if not worker.given:
                        selector.unregister(ready.fileobj)
                    yield number, np.frombuffer(data, np.uint8).reshape(-1, size, size)
    finally:
        for worker in crew:
            _end(worker)


def _tell(worker: _Worker, message: object) -> None:
    with suppress(BrokenPipeError):  # it died; reading its answer says how
        _pipe(worker.process.stdin).write(json.dumps(message).encode() + b"\n")


def _give(worker: _Worker, queue: Iterator[tuple[int, Item]]) -> None:
    following = next(queue, None)
    if following is not None:
        worker.given.append(following)
        _tell(worker, asdict(following[1]))


def _answer(worker: _Worker) -> bytes:
    """The views of the first item a worker was given."""
    item = worker.given[0][1]
    kind, length = _HEAD.unpack(_read(worker, _HEAD.size))
    data = _read(worker, length)
    if kind == _DATA_ERROR:
        raise DataError(data.decode())
    if kind == _CRASH:
        raise RuntimeError(f"rendering {item.name} failed:\n{data.decode()}")
    return data


def _read(worker: _Worker, length: int) -> bytes:
    data, pipe = bytearray(), _pipe(worker.process.stdout)
    while len(data) < length:
        some = pipe.read(length - len(data))
        if not some:
            raise ActiveLSDError(
                f"The process that rendered {worker.given[0][1].name} ended by itself (code"
                f" {worker.process.wait()}), perhaps for want of memory; start again to go on from there."
            )
        data += some
    return bytes(data)


def _end(worker: _Worker) -> None:
    worker.process.kill()
    for pipe in (worker.process.stdin, worker.process.stdout):
        _pipe(pipe).close()
    worker.process.wait()


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe


def main() -> None:
    """Render what standard input asks for, until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get between the answers
    job = json.loads(sys.stdin.buffer.readline())
    source: Source | None = None
    for line in sys.stdin.buffer:
        item = Item(**{**json.loads(line), "parts": tuple(json.loads(line)["parts"])})
        try:
            source = source or source_from(job["source"])
            views = source.views(item, size=job["size"], elevations=job["elevations"])
            kind, data = _VIEWS, views.tobytes()
        except DataError as error:
            kind, data = _DATA_ERROR, str(error).encode()
        except Exception:  # noqa: BLE001  the parent raises it
            kind, data = _CRASH, traceback.format_exc().encode()
        try:
            answers.write(_HEAD.pack(kind, len(data)) + data)
            answers.flush()
        except BrokenPipeError:  # the parent is gone, and so is anybody to tell
            os._exit(1)
