"""Spreads work over processes: both ends of the pipes between the one that has it and those that do it.

The processes are programs of their own, see `activelsd.subprogram`; the end of their input ends them, so none
outlives the process that started it.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, suppress
from importlib import import_module
from queue import Empty, SimpleQueue
from threading import Thread
from typing import IO, Any, NamedTuple

from activelsd import errors
from activelsd.errors import ActiveLSDError
from activelsd.subprogram import kill, start

Item = Mapping[str, Any]
"""A piece of work in values that JSON holds; messages call it by its `name`."""

Work = Callable[[Item], bytes]
"""Does a piece of work and returns its result."""

_AHEAD = 2
"""Items that a process has at a time, so that it can begin the next while its answer is read."""

_GRACE = 10.0
"""Seconds that a process has to end after its last item."""

_HEAD = struct.Struct("<cQ")
_RESULT, _ERROR, _CRASH = b"r", b"e", b"c"


_WAIT = 0.5
"""Seconds between two looks for Ctrl-C, which does not end a wait on Windows."""


class _Worker(NamedTuple):
    process: subprocess.Popen[bytes]
    given: deque[tuple[int, Item]]  # sent and not answered yet, in order


class _Answer(NamedTuple):
    worker: _Worker
    kind: bytes  # empty if the process has ended
    data: bytes


def spread(
    maker: str, job: Mapping[str, Any], items: Iterable[tuple[int, Item]], *, processes: int
) -> Generator[tuple[int, bytes], None, None]:
    """The results of numbered items, as they get done; close the iterator to kill the processes early.

    Args:
        maker: `module:function` that takes the job and returns a context manager of the function that does
            an item (see `Work`). Each process enters it once, before its first item, and leaves it after
            its last.
        job: what all processes need to know, in values that JSON holds.
        items: the work, each with the number that its result is returned with.
        processes: how many do it; 1 does it in this process. Others find theirs in `subprogram.NUMBER`.

    Yields:
        The number and the result of an item.

    Raises:
        ActiveLSDError: raised by the work, as the same class of `activelsd.errors`; or a process died.
        RuntimeError: the work raised something else; with the traceback.
    """
    if processes == 1:
        with _made(maker, job) as work:
            for number, item in items:
                yield number, work(item)
        return
    queue = iter(items)
    workers: list[_Worker] = []
    answers: SimpleQueue[_Answer] = SimpleQueue()
    readers: list[Thread] = []
    try:
        for number in range(processes):
            workers.append(_Worker(start(__name__, number=number), deque()))
            readers.append(Thread(target=_read_answers, args=(workers[-1], answers), daemon=True))
            readers[-1].start()
            _send(workers[-1], {"maker": maker, "job": job})
        for _ in range(_AHEAD):
            for worker in workers:
                _give(worker, queue)
        yield from _results(workers, answers, queue)
        for worker in workers:
            _pipe(worker.process.stdin).close()
        for worker in workers:
            with suppress(subprocess.TimeoutExpired):
                worker.process.wait(_GRACE)
    finally:
        for worker in workers:
            kill(worker.process)
            _pipe(worker.process.stdin).close()
            worker.process.wait()
        for reader in readers:
            reader.join(_GRACE)


def _made(maker: str, job: Mapping[str, Any]) -> AbstractContextManager[Work]:
    module, _, function = maker.partition(":")
    made: AbstractContextManager[Work] = getattr(import_module(module), function)(job)
    return made


def _results(
    workers: list[_Worker], answers: SimpleQueue[_Answer], queue: Iterator[tuple[int, Item]]
) -> Iterator[tuple[int, bytes]]:
    while any(worker.given for worker in workers):
        answer = _next(answers)
        worker = answer.worker
        data = _result(answer)
        number, _ = worker.given.popleft()
        _give(worker, queue)
        yield number, data


def _next(answers: SimpleQueue[_Answer]) -> _Answer:
    while True:
        with suppress(Empty):
            return answers.get(timeout=_WAIT)


def _send(worker: _Worker, message: object) -> None:
    with suppress(BrokenPipeError):  # it died; reading its answer says how
        _pipe(worker.process.stdin).write(json.dumps(message).encode() + b"\n")


def _give(worker: _Worker, queue: Iterator[tuple[int, Item]]) -> None:
    following = next(queue, None)
    if following is not None:
        worker.given.append(following)
        _send(worker, following[1])


def _result(answer: _Answer) -> bytes:
    """The result of the first item that a worker has."""
    worker, kind, data = answer
    if kind == _ERROR:
        name, _, message = data.decode().partition(":")
        raise getattr(errors, name)(message)
    if kind == _CRASH:
        raise RuntimeError(f"Preparing {worker.given[0][1]['name']} failed:\n{data.decode()}")
    if kind != _RESULT:
        raise ActiveLSDError(
            f"The process that prepared {worker.given[0][1]['name']} ended by itself (code"
            f" {worker.process.wait()}), perhaps because memory ran out; start again to go on from there."
        )
    return data


def _read_answers(worker: _Worker, answers: SimpleQueue[_Answer]) -> None:
    """Put a worker's answers into a queue until it ends; selectors know no pipes on Windows, threads do."""
    with _pipe(worker.process.stdout) as pipe:
        while head := _read(pipe, _HEAD.size):
            kind, length = _HEAD.unpack(head)
            data = _read(pipe, length)
            if length and not data:
                break
            answers.put(_Answer(worker, kind, data))
    answers.put(_Answer(worker, b"", b""))


def _read(pipe: IO[bytes], length: int) -> bytes:
    """So many bytes of a pipe; none if it ends before."""
    data = bytearray()
    while len(data) < length:
        some = pipe.read(length - len(data))
        if not some:
            return b""
        data += some
    return bytes(data)


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe


def main() -> None:
    """Do what standard input asks for, until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get between the answers
    task = json.loads(sys.stdin.buffer.readline())
    work: Work | None = None
    with ExitStack() as stack:
        for line in sys.stdin.buffer:
            try:
                work = work or stack.enter_context(_made(task["maker"], task["job"]))
                kind, data = _RESULT, work(json.loads(line))
            except ActiveLSDError as error:
                known = next(one for one in type(error).__mro__ if one.__module__ == errors.__name__)
                kind, data = _ERROR, f"{known.__name__}:{error}".encode()
            except Exception:  # noqa: BLE001  the parent raises it
                kind, data = _CRASH, traceback.format_exc().encode()
            try:
                answers.write(_HEAD.pack(kind, len(data)) + data)
                answers.flush()
            except BrokenPipeError:  # the parent is gone
                break
    os._exit(0)  # at once, and without a word about answers that nobody reads
