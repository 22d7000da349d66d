"""Carries weights from a network to one with other actions, by the actions' names."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, NamedTuple

from torch import Tensor, nn

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.errors import RunError
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.policy.trunks import ViewTrunk


class Transfer(NamedTuple):
    """Which rows of the head a new network takes from an old one, named `branch` or `branch/leaf`."""

    kept: tuple[str, ...]  # rows that both have
    fresh: tuple[str, ...]  # rows that only the new network has
    dropped: tuple[str, ...]  # rows that only the old network has
    around: str  # whether `Surroundings` was kept, fresh, dropped or none


def transfer(source: LSDNet, fresh: LSDNet) -> tuple[dict[str, Tensor], Transfer]:
    """The state of `fresh` with the weights that `source` has for it; neither network is changed.

    Trunk, memory and value are taken whole, and every row of the head whose name both networks have. A
    trunk that learned from frames filled by their target goes on with crops; `Surroundings`, which then
    sees the frames, begins at zero, so the network begins with the outputs it had.

    Raises:
        RunError: the networks differ in more than their actions and in whether they see crops.
    """
    _check_trunks(source.trunk, fresh.trunk)
    old_settings, new_settings = dict(_settings(source)), dict(_settings(fresh))
    for key in [*new_settings, *(old_settings.keys() - new_settings.keys())]:
        theirs, ours = old_settings.get(key), new_settings.get(key)
        if theirs != ours:
            raise RunError(
                f"A network with {key}={theirs} cannot start one with {key}={ours}; set {key}={theirs}, "
                "or leave policy.init out."
            )
    learned, state = source.state_dict(), {name: x.clone() for name, x in fresh.state_dict().items()}
    old, new = _layers(source), _layers(fresh)
    for name in state.keys() & learned.keys():
        layer = name.rpartition(".")[0]
        if layer not in new:
            state[name] = learned[name].clone()
        else:
            for row in new[layer].keys() & old[layer].keys():
                state[name][new[layer][row]] = learned[name][old[layer][row]]
    theirs, ours = head_rows(source), head_rows(fresh)
    around = {(True, True): "kept", (False, True): "fresh", (True, False): "dropped", (False, False): "none"}
    rows = Transfer(
        kept=tuple(row for row in ours if row in theirs),
        fresh=tuple(row for row in ours if row not in theirs),
        dropped=tuple(row for row in theirs if row not in ours),
        around=around[source.shape.crops, fresh.shape.crops],
    )
    return state, rows


def narrow(network: LSDNet, tree: ActionTree) -> LSDNet:
    """A copy of a network with some of its actions, equal to the network with all others illegal.

    Raises:
        RunError: the tree has an action that the network does not have.
    """
    if network.tree == tree:
        return network
    old = head_rows(network)
    wanted = head_rows(network, tree)
    missing = [row for row in wanted if row not in old]
    if missing:
        raise RunError(
            f"The network was not trained for {missing[0]}; name the worlds that it was trained in."
        )
    few = copy.deepcopy(network)
    few.tree = tree
    for layer, rows in _layers(network, tree).items():
        old = _layers(network)[layer]
        kept, part = [old[row] for row in rows], few.get_submodule(layer)
        assert isinstance(part, nn.Linear)
        part.out_features = len(kept)
        part.weight, part.bias = (
            nn.Parameter(part.weight.detach()[kept]),
            nn.Parameter(part.bias.detach()[kept]),
        )
    return few


def head_rows(network: LSDNet, tree: ActionTree | None = None) -> dict[str, int]:
    """Index of every row of a network's head by name: `branch` for a tree, then `branch/leaf`."""
    tree = tree or network.tree
    branches = tree.branches if network.shape.head == "tree" else ()
    names = [*branches, *("/".join(pair) for pair in tree.names)]
    return {name: row for row, name in enumerate(names)}


def _check_trunks(source: nn.Module, fresh: nn.Module) -> None:
    """Check that views look to the new trunk as they did to the old one, when it begins."""
    if not isinstance(source, ViewTrunk) or not isinstance(fresh, ViewTrunk):
        return
    if fresh.frozen and not source.frozen:
        raise RunError(
            "policy.trunk.freeze=all would drop what the other run's trunk has learned; set"
            " policy.trunk.freeze=none, or leave policy.init out."
        )
    if source.digest() != fresh.digest():
        raise RunError(
            f"A network on the trunk '{source.digest()}' cannot start one on '{fresh.digest()}'; name the"
            " same weights and the same input, or leave policy.init out."
        )


def _settings(network: LSDNet) -> Iterator[tuple[str, Any]]:
    """What must be equal in two networks, by the key of the setting; the part's name before its settings."""
    free = [f"policy.trunk.{key}" for key in getattr(network.trunk, "free", ())]
    for key, value in _all_settings(network.shape):
        if key not in free:
            yield key, value


def _all_settings(shape: NetworkShape) -> Iterator[tuple[str, Any]]:
    for name, value in asdict(shape).items():
        if name.endswith("_settings"):
            part = name.removesuffix("_settings")
            yield from ((f"policy.{part}.{key}", one) for key, one in value.items())
        elif name == "channels":
            yield "env.colour", "gray" if value == 1 else "rgb"
        elif name not in ("crops", "certainty"):
            yield "env.size" if name == "size" else f"policy.{name}", value


def _layers(network: LSDNet, tree: ActionTree | None = None) -> dict[str, dict[str, int]]:
    """The layers whose rows stand for actions, with the index of each row by name."""
    rows = head_rows(network, tree)
    layers = {"policy": rows}
    names = [*(row for row in rows if not row.startswith(f"{CLASSIFY}/")), "value"]
    steering = {name: row for row, name in enumerate(names)}
    if network.surroundings is not None:
        layers["surroundings.outputs"] = steering
    if network.certainty is not None:
        layers["certainty.outputs"] = steering
    return layers
