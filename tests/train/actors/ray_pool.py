"""Ray's actors as the tests make them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld, union
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.ray.ray_actors import RayActors
from activelsd.train.settings import RaySettings, TrainSettings
from activelsd.train.trainer import new_network
from tests.train.actors import recordings
from tests.train.actors.mischief import GRAPH

EPSILON = Epsilon(0.3, 0.2)
REASON = "needs Ray: pip install 'activelsd[ray]'"


def network_for(worlds: Sequence[OpenWorld]) -> LSDNet:
    tree = union([tree_of(world.graph) for world in worlds])
    return new_network(tree, NetworkShape(size=GRAPH.size, trunk_settings={"features": 16}), 1)


def settings_of(dropout: float = 0.0, **ray: Any) -> TrainSettings:
    chosen = {"workers": 2, "envs_per_worker": 3, **ray}
    terms = {"supervised": 1.0, "guided": 0.5}
    return TrainSettings(actors="ray", length=4, dropout=dropout, terms=terms, ray=RaySettings(**chosen))


def actors(
    open_worlds: Callable[[], Sequence[OpenWorld]] = recordings.rings,
    worlds: Callable[[], Sequence[OpenWorld]] = recordings.rings,
    **ray: Any,
) -> RayActors:
    return RayActors(open_worlds, worlds(), network_for(worlds()), settings_of(**ray), 3)
