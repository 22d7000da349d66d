"""Metrics of the time since they were last read; never averages since the start."""

from __future__ import annotations

import threading
import time
from collections import defaultdict


class Gauges:
    """Means, peaks, counts, rates and shares of time, by name; any thread may add to them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clear()

    def _clear(self) -> None:
        self._since = time.monotonic()
        self._means: dict[str, tuple[float, float]] = defaultdict(lambda: (0.0, 0.0))  # sum, count
        self._peaks: dict[str, float] = {}
        self._counts: dict[str, float] = defaultdict(float)
        self._rates: dict[str, float] = defaultdict(float)

    def mean(self, name: str, value: float, times: float = 1.0) -> None:
        """Add a value to a mean, with a weight of `times`."""
        with self._lock:
            total, count = self._means[name]
            self._means[name] = (total + value * times, count + times)

    def peak(self, name: str, value: float) -> None:
        """Keep the greatest value."""
        with self._lock:
            self._peaks[name] = max(value, self._peaks.get(name, value))

    def count(self, **amounts: float) -> None:
        """Add to counts; amounts that are given together are read together."""
        with self._lock:
            for name, amount in amounts.items():
                self._counts[name] += amount

    def rate(self, name: str, amount: float) -> None:
        """Add to a sum that is divided by the time: a rate, or, if it is of seconds, a share of the time."""
        with self._lock:
            self._rates[name] += amount

    def read(self) -> dict[str, float]:
        """Returns the window's metrics and begins the next window."""
        with self._lock:
            seconds = max(time.monotonic() - self._since, 1e-9)
            means = {name: total / count for name, (total, count) in self._means.items() if count}
            rates = {name: amount / seconds for name, amount in self._rates.items()}
            found = means | self._peaks | self._counts | rates
            self._clear()
        return found
