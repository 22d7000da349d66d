"""A queue that is emptied in batches, limited by their size and by the age of the oldest item."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class ClosedError(Exception):
    """Raised in every thread that waits at a queue that was closed."""


class BatchQueue(Generic[Item]):
    """First in, first out, in batches."""

    def __init__(self, limit: int | None = None) -> None:
        """Create it; `put` waits while it holds `limit` items."""
        self._limit, self._closed = limit, False
        self._items: deque[tuple[float, Item]] = deque()  # time of `put`, and the item
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> None:
        """Append an item as soon as there is room. Raises ClosedError."""
        with self._changed:
            while self._limit is not None and len(self._items) >= self._limit and not self._closed:
                self._changed.wait()
            if self._closed:
                raise ClosedError
            self._items.append((time.monotonic(), item))
            self._changed.notify_all()

    def take(self, least: int, most: int, patience: float = 0.0) -> list[Item]:
        """Up to `most` items, as soon as there are that many, or `least` and the oldest is old enough.

        Args:
            least: wait without limit for at least this many.
            most: take at most this many.
            patience: seconds that the oldest item may wait for more.

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
        """Make all pending and later calls raise ClosedError."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
