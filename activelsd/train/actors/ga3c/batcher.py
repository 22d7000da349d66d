"""Trainers, as GA3C calls them: they batch trajectories for the learner, which alone changes the weights."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.trajectory import Trajectory
from activelsd.train.rollout import Rollout


class Batch(NamedTuple):
    """What the learner is handed."""

    rollout: Rollout
    versions: NDArray[np.int64]  # (L, B) of the weights that each step was played with


class BatcherThread(threading.Thread):
    """Fills the learner's orders: of several trainers, all but one have a batch ready ahead of it."""

    def __init__(
        self,
        make: Callable[[Sequence[Trajectory]], Batch],
        orders: BatchQueue[None],
        full: BatchQueue[Trajectory],
        ready: BatchQueue[Batch],
        *,
        size: int,
        fail: Callable[[Exception], None],
    ) -> None:
        """Move from the training queue to the learner.

        Args:
            make: puts trajectories side by side.
            orders: one for each batch that is to be made; what lies ready without one would grow old.
            full: the training queue.
            ready: where the learner takes batches.
            size: trajectories of a batch.
            fail: called with what ends the training.
        """
        super().__init__(name="trainer", daemon=True)
        self._make, self._orders, self._full, self._ready = make, orders, full, ready
        self._size, self._fail = size, fail
        self._stopping = False

    def stop(self) -> None:
        """End after the next batch."""
        self._stopping = True

    def run(self) -> None:
        """Batch until stopped."""
        try:
            while not self._stopping:
                self._orders.take(1, 1)
                self._ready.put(self._make(self._full.take(self._size, self._size)))
        except ClosedError:
            pass
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._fail(error)
