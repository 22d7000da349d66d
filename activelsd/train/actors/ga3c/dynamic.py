"""Finds the fastest numbers of agents, predictors and trainers by GA3C's random walk (section 4.3)."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class ThreadCounts(NamedTuple):
    """Numbers of threads of each kind."""

    agents: int
    predictors: int
    trainers: int


def neighbour(counts: ThreadCounts, most: ThreadCounts, generator: np.random.Generator) -> ThreadCounts:
    """Counts that differ from these by at most one each, between 1 and `most`."""
    moves = generator.integers(-1, 2, len(counts))
    return ThreadCounts(*(int(min(max(n + d, 1), m)) for n, d, m in zip(counts, moves, most, strict=True)))


class Walk:
    """Tries a neighbour of the best counts so far at every turn, and returns from one that is slower."""

    def __init__(self, counts: ThreadCounts, most: ThreadCounts, seed: int) -> None:
        self.best, self._rate = counts, 0.0
        self._tried = counts
        self._most, self._generator = most, np.random.default_rng(seed)

    def turn(self, rate: float) -> ThreadCounts:
        """The counts to use next, given the rate of those used last."""
        if self._tried == self.best or rate > self._rate:
            # The best is measured again when it was used: a machine's speed changes.
            self.best, self._rate = self._tried, rate
            self._tried = neighbour(self.best, self._most, self._generator)
        else:
            self._tried = self.best
        return self._tried


class Adjuster(threading.Thread):
    """Takes a turn of the walk every so many seconds."""

    def __init__(
        self,
        walk: Walk,
        *,
        every: float,
        steps: Callable[[], int],
        resize: Callable[[ThreadCounts], None],
        fail: Callable[[Exception], None],
    ) -> None:
        """Set up.

        Args:
            walk: chooses the counts.
            every: seconds between two turns.
            steps: returns how many steps were learned from so far.
            resize: starts and ends threads.
            fail: called with the error that ends the training.
        """
        super().__init__(name="adjuster", daemon=True)
        self._walk, self._every, self._steps = walk, every, steps
        self._resize, self._fail = resize, fail
        self._end = threading.Event()

    def stop(self) -> None:
        """End now."""
        self._end.set()

    def run(self) -> None:
        """Adjust until stopped."""
        before = self._steps()
        try:
            while not self._end.wait(self._every):
                now = self._steps()
                self._resize(self._walk.turn((now - before) / self._every))
                before = self._steps()
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._fail(error)
