"""Measures rates of work of several contestants in turns, so that all share the machine's noise."""

from __future__ import annotations

import multiprocessing
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from multiprocessing.connection import Connection
from typing import NamedTuple, TypeVar

import torch

Step = Callable[[], int]
"""Does a piece of work and returns the amount."""

MakeStep = Callable[[], AbstractContextManager[Step]]
"""Makes a step and cleans up after it; must be picklable for `in_processes`."""

Name = TypeVar("Name")


class Rate(NamedTuple):
    """Work done per second."""

    wall: float  # of wall time
    cpu: float  # of this process's CPU time


def rate(step: Step, seconds: float) -> Rate:
    """The rate of a step repeated for some seconds, after a few that do not count."""
    for _ in range(3):
        step()
    _finish()
    wall, cpu, done = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - wall < seconds:
        done += step()
    _finish()
    return Rate(done / (time.perf_counter() - wall), done / (time.process_time() - cpu))


def _finish() -> None:
    """Wait until a GPU has done its work."""
    if torch.cuda.is_initialized():  # type: ignore[no-untyped-call]
        torch.cuda.synchronize()


def in_turns(contestants: Mapping[Name, Step], seconds: float, rounds: int) -> dict[Name, Rate]:
    """The median rate of each contestant over the rounds."""
    return _medians({name: rate(step, seconds) for name, step in contestants.items()} for _ in range(rounds))


def in_processes(
    contestants: Mapping[Name, MakeStep], threads: int, seconds: float, rounds: int
) -> dict[Name, Rate]:
    """Like `in_turns`, with each contestant in a process of its own that has so many PyTorch threads.

    They share neither heap nor interpreter, so neither memory nor threads that one leaves slow another.
    """
    with ExitStack() as stack:
        pipes = {name: stack.enter_context(_contestant(make, threads)) for name, make in contestants.items()}

        def turn(pipe: Connection) -> Rate:
            pipe.send(seconds)
            found: Rate = pipe.recv()
            return found

        return _medians({name: turn(pipe) for name, pipe in pipes.items()} for _ in range(rounds))


@contextmanager
def _contestant(make: MakeStep, threads: int) -> Iterator[Connection]:
    """A process that measures a step for the seconds that it is sent, until the pipe is closed."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_measure, args=(make, threads, there))
    process.start()
    there.close()
    with here:
        here.recv()  # it is ready
        yield here
    process.join()


def _measure(make: MakeStep, threads: int, pipe: Connection) -> None:
    """Make a step and measure it for each number of seconds that the pipe brings."""
    torch.set_num_threads(threads)
    with make() as step:
        pipe.send(None)
        try:
            while True:
                pipe.send(rate(step, pipe.recv()))
        except EOFError:
            return


def _medians(rounds: Iterator[dict[Name, Rate]]) -> dict[Name, Rate]:
    every = list(rounds)
    return {
        name: Rate(*map(statistics.median, zip(*(one[name] for one in every), strict=True)))
        for name in every[0]
    }
