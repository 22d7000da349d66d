"""Recorded worlds that a Ray worker opens by their functions' names, and some that it cannot."""

from __future__ import annotations

from pathlib import Path

from activelsd.envs.episode import PRESETS
from activelsd.envs.joint import Recording
from activelsd.errors import DataError
from tests.graphs import ring_graph, room_graph
from tests.train.actors.mischief import GRAPH


def rings() -> list[Recording]:
    return [Recording("rings", GRAPH, PRESETS["V4"])]


def rooms() -> list[Recording]:
    """With boxes, so that the way to a good look is known."""
    return [Recording("rooms", room_graph(size=GRAPH.size, crops=False), PRESETS["V4"])]


def two_worlds() -> list[Recording]:
    """Rings of other classes, and with other moves."""
    other = ring_graph(classes=3, moves=("orbit_cw", "orbit_cw_90"), seed=1)
    return [*rings(), Recording("others", other, PRESETS["V4"])]


def broken() -> list[Recording]:
    raise RuntimeError("the shelf fell over")


def missing() -> list[Recording]:
    raise DataError("There are no views on this node.")


def busy(mark: Path) -> list[Recording]:
    """Rings that another process prepares at the first try."""
    from activelsd.envs.cache import CacheBusyError

    if not mark.exists():
        mark.touch()
        raise CacheBusyError("Another process is preparing them.")
    return rings()


class Idle:
    """Something else that takes a place in a cluster."""

    def ready(self) -> None:
        pass
