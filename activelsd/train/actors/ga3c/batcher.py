"""GA3C's trainers: they batch trajectories for the learner, which alone changes the weights."""

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
    """A rollout for the learner."""

    rollout: Rollout
    versions: NDArray[np.int64]  # (L, B) of the weights that chose each action


class BatcherThread(threading.Thread):
    """Makes the batches that the learner orders; with several trainers, some are made ahead of time."""

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
        """Connect the training queue to the learner.

        Args:
            make: puts trajectories side by side.
            orders: one for each batch to make; without orders, ready batches would grow old.
            full: the training queue.
            ready: the queue from which the learner takes batches.
            size: trajectories of a batch.
            fail: called with the error that ends the training.
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
