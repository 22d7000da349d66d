"""How often per second something is done: contestants measured in turns, so that noise is shared by all."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

Step = Callable[[], int]
"""Does a piece of work; gives how much that was."""

Name = TypeVar("Name")


class Rate(NamedTuple):
    """Work done per second."""

    wall: float  # of wall time
    cpu: float  # of this process's CPU time


def rate(step: Step, seconds: float) -> Rate:
    """The rate of a step repeated for some seconds, after a few that do not count."""
    for _ in range(3):
        step()
    wall, cpu, done = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - wall < seconds:
        done += step()
    return Rate(done / (time.perf_counter() - wall), done / (time.process_time() - cpu))


def in_turns(contestants: Mapping[Name, Step], seconds: float, rounds: int) -> dict[Name, Rate]:
    """The median rate of each over rounds in which all have their turn."""
    rates: dict[Name, list[Rate]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, step in contestants.items():
            rates[name].append(rate(step, seconds))
    return {name: Rate(*map(statistics.median, zip(*found, strict=True))) for name, found in rates.items()}
