"""Baselines by name: what a trained run is compared with."""

from __future__ import annotations

from collections.abc import Callable

from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, did_you_mean
from activelsd.evaluate.nextbest import NextBestMove
from activelsd.evaluate.players import AllViews, NoMove, RandomPolicy, RandomWalk
from activelsd.evaluate.protocol import Player
from activelsd.evaluate.walkers import Forward, ObjectSearch, Oracle
from activelsd.policy.lsdnet import LSDNet

BASELINES: dict[str, Callable[[LSDNet, ViewGraph, int], Player]] = {
    "no_move": lambda network, graph, seed: NoMove(network),
    "random_walk": lambda network, graph, seed: RandomWalk(network, seed),
    "random_policy": lambda network, graph, seed: RandomPolicy(network.tree, seed),
    "all_views": lambda network, graph, seed: AllViews(network, graph),
    "forward": lambda network, graph, seed: Forward(network),
    "object_search": lambda network, graph, seed: ObjectSearch(network),
    "oracle": lambda network, graph, seed: Oracle(network, graph),
    "next_best_move": lambda network, graph, seed: NextBestMove(network),
}
"""Makers of baselines by name, from a trained network, the world and a seed."""


def check_baseline(name: str) -> None:
    """Raise ConfigError where there is no baseline of that name."""
    if name not in BASELINES:
        raise ConfigError(f"There is no baseline '{name}'; {did_you_mean(name, BASELINES)}")


def make_baseline(name: str, network: LSDNet, graph: ViewGraph, seed: int) -> Player:
    """A baseline by name.

    Raises:
        ConfigError: there is none of that name, or it needs moves or boxes that the world has not.
    """
    check_baseline(name)
    return BASELINES[name](network, graph, seed)
