"""Weights carried from a network to one for other actions, by the actions' names."""

from __future__ import annotations

import copy
from dataclasses import fields
from typing import NamedTuple

from torch import Tensor, nn

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.errors import RunError
from activelsd.policy.lsdnet import LSDNet


class Transfer(NamedTuple):
    """What of a new network comes from an old one; head rows are `branch` or `branch/leaf`."""

    kept: tuple[str, ...]  # rows that both know
    fresh: tuple[str, ...]  # rows that only the new network knows
    dropped: tuple[str, ...]  # rows that only the old network knows
    around: str  # what became of the part that sees frames around crops


def transfer(source: LSDNet, fresh: LSDNet) -> tuple[dict[str, Tensor], Transfer]:
    """The state of `fresh` with all that `source` knows of it; neither network is changed.

    Trunk, memory and value are kept whole, and of the head every row whose name both know. The picture of a
    lone object is a crop that fills its frame, so the trunk that learned such frames looks at crops next;
    what then sees the frames around them begins at zero, and the network as what it was.

    Raises:
        RunError: the networks differ in more than their actions and in whether they see crops.
    """
    for field in fields(source.shape):
        theirs, ours = getattr(source.shape, field.name), getattr(fresh.shape, field.name)
        if theirs != ours and field.name != "crops":
            key = "env.size" if field.name == "size" else f"policy.{field.name}"
            raise RunError(
                f"A network of {key}={theirs} cannot start one of {key}={ours}; set {key}={theirs}, "
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
    said = {(True, True): "kept", (False, True): "fresh", (True, False): "dropped", (False, False): "none"}
    rows = Transfer(
        kept=tuple(row for row in ours if row in theirs),
        fresh=tuple(row for row in ours if row not in theirs),
        dropped=tuple(row for row in theirs if row not in ours),
        around=said[source.shape.crops, fresh.shape.crops],
    )
    return state, rows


def narrow(network: LSDNet, tree: ActionTree) -> LSDNet:
    """A copy of a network for some of its actions: what it is where no others are legal.

    Raises:
        RunError: the tree has an action that the network does not know.
    """
    if network.tree == tree:
        return network
    old = head_rows(network)
    wanted = head_rows(network, tree)
    missing = [row for row in wanted if row not in old]
    if missing:
        raise RunError(
            f"The network was not trained for {missing[0]}; give it the worlds that it was trained in."
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
    """Number of every row of a network's head by name: `branch` where it has branches, then `branch/leaf`."""
    tree = tree or network.tree
    branches = tree.branches if network.shape.head == "tree" else ()
    names = [*branches, *("/".join(pair) for pair in tree.names)]
    return {name: row for row, name in enumerate(names)}


def _layers(network: LSDNet, tree: ActionTree | None = None) -> dict[str, dict[str, int]]:
    """The layers whose rows stand for actions, with the number of each row by name."""
    rows = head_rows(network, tree)
    layers = {"policy": rows}
    if network.surroundings is not None:
        names = [*(row for row in rows if not row.startswith(f"{CLASSIFY}/")), "value"]
        layers["surroundings.outputs"] = {name: row for row, name in enumerate(names)}
    return layers
