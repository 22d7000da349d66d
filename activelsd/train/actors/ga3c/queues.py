"""A queue that is emptied in batches: bounded by size and by the age of what waits longest."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class ClosedError(Exception):
    """Raised to whoever waits at a queue that is closed."""


class BatchQueue(Generic[Item]):
    """First in, first out, many at a time."""

    def __init__(self, limit: int | None = None) -> None:
        """Let `put` wait while as many as `limit` are in."""
        self._limit, self._closed = limit, False
        self._items: deque[tuple[float, Item]] = deque()  # when it was put, and it
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> None:
        """Append an item, as soon as there is room. Raises ClosedError."""
        with self._changed:
            while self._limit is not None and len(self._items) >= self._limit and not self._closed:
                self._changed.wait()
            if self._closed:
                raise ClosedError
            self._items.append((time.monotonic(), item))
            self._changed.notify_all()

    def take(self, least: int, most: int, patience: float = 0.0) -> list[Item]:
        """Up to `most` items, as soon as there are so many, or `least` and the oldest has waited long enough.

        Args:
            least: wait for so many without limit.
            most: take no more than that.
            patience: seconds the oldest item may wait for more to come.

        Raises:
            ClosedError: the queue was closed.
        """
        with self._changed:
            while not self._closed and len(self._items) < most:
                left = None
                if len(self._items) >= least:
                    left = self._items[0][0] + patience - time.monotonic()
                    if left <= 0:
                        break
                self._changed.wait(left)
            if self._closed:
                raise ClosedError
            taken = [self._items.popleft()[1] for _ in range(min(most, len(self._items)))]
            self._changed.notify_all()
            return taken

    def close(self) -> None:
        """Wake everyone who waits, now and from now on, with ClosedError."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
