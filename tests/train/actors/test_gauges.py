"""Measures are of a window: what was before the last reading is not in them."""

from __future__ import annotations

import time

import pytest

from activelsd.train.actors.gauges import Gauges


def test_each_kind_of_measure_and_a_fresh_window_after_reading() -> None:
    began = time.monotonic()
    gauges = Gauges()
    for _ in range(2):
        gauges.mean("batch", 2.0)
        gauges.mean("batch", 4.0, times=3)
        gauges.peak("lag", -3.0)
        gauges.peak("lag", -5.0)
        gauges.count(lost=2)
        gauges.count(lost=3)
        gauges.rate("steps", 10)
        time.sleep(0.05)
        before = time.monotonic()
        found = gauges.read()
        seconds, began = time.monotonic() - began, before
        assert found["batch"] == pytest.approx(3.5)
        assert found["lag"] == -3.0
        assert found["lost"] == 5
        assert 10 / seconds <= found["steps"] <= 10 / 0.05
    assert gauges.read() == {}
