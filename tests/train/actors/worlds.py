"""GA3C's actors on rings of views."""

from __future__ import annotations

from typing import Any

from activelsd.envs.graphenv import tree_of
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.settings import GA3CSettings
from activelsd.train.trainer import new_network
from tests.train.actors.mischief import GRAPH, ID, Mischief


def network(memory: str = "pool", seed: int = 1) -> LSDNet:
    return new_network(
        tree_of(GRAPH), NetworkShape(memory=memory, size=GRAPH.size, trunk_settings={"features": 16}), seed
    )


def spec(**kwargs: Any) -> EnvSpec:
    return EnvSpec(id=ID, kwargs=kwargs, tree=tree_of(GRAPH))


def actors(
    kind: str = "threads", net: LSDNet | None = None, *, seed: int = 3, length: int = 4, **settings: Any
) -> GA3CActors:
    """Actors on the ring; settings that are neither theirs nor GA3C's are the environment's."""
    varied = {name: settings.pop(name) for name in ("mirror", "dropout") if name in settings}
    own = {name: settings.pop(name) for name in list(settings) if name in GA3CSettings.model_fields}
    world = spec(**settings) if kind == "processes" else lambda: Mischief(**settings)
    chosen = GA3CSettings(**{"agents": 2, **own})
    return GA3CActors(world, net or network(), chosen, length, seed, **varied)
