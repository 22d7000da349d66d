"""Recorded worlds that a Ray worker opens by their functions' names, and some that it cannot."""

from __future__ import annotations

from activelsd.envs.episode import PRESETS
from activelsd.envs.joint import OpenWorld
from activelsd.errors import DataError
from tests.graphs import ring_graph, room_graph
from tests.train.actors.mischief import GRAPH


def rings() -> list[OpenWorld]:
    return [OpenWorld("rings", GRAPH, PRESETS["V4"])]


def rooms() -> list[OpenWorld]:
    """With boxes, so that the way to a good look is known."""
    return [OpenWorld("rooms", room_graph(size=GRAPH.size, crops=False), PRESETS["V4"])]


def two_worlds() -> list[OpenWorld]:
    """Rings of other classes, and with other moves."""
    other = ring_graph(classes=3, moves=("orbit_cw", "orbit_cw_90"), seed=1)
    return [*rings(), OpenWorld("others", other, PRESETS["V4"])]


def broken() -> list[OpenWorld]:
    raise RuntimeError("the shelf fell over")


def missing() -> list[OpenWorld]:
    raise DataError("There are no views on this node.")


class Idle:
    """Something else that takes a place in a cluster."""

    def ready(self) -> None:
        pass
