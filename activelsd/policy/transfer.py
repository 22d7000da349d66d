"""Weights carried from a network to one for other actions, by the actions' names."""

from __future__ import annotations

import copy
from dataclasses import fields
from typing import NamedTuple

import torch
from torch import Tensor, nn

from activelsd.envs.actions import ActionTree
from activelsd.errors import RunError
from activelsd.policy.lsdnet import LSDNet

HEAD = ("policy.weight", "policy.bias")


class Transfer(NamedTuple):
    """What of a new network comes from an old one; head rows are `branch` or `branch/leaf`."""

    kept: tuple[str, ...]  # rows that both know
    fresh: tuple[str, ...]  # rows that only the new network knows
    dropped: tuple[str, ...]  # rows that only the old network knows
    input: str  # what became of the first layer


def transfer(source: LSDNet, fresh: LSDNet) -> tuple[dict[str, Tensor], Transfer]:
    """The state of `fresh` with all that `source` knows of it; neither network is changed.

    Trunk, memory and value are kept whole, and of the head every row whose name both know.

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
    old, new = head_rows(source), head_rows(fresh)
    state = {name: value.detach().clone() for name, value in source.state_dict().items()}
    for name in HEAD:
        state[name] = fresh.state_dict()[name].clone()
        for row in new.keys() & old.keys():
            state[name][new[row]] = source.state_dict()[name][old[row]]
    said = "kept"
    if source.shape.crops != fresh.shape.crops:
        first = _first_layer(source)
        state[first], said = _for_crops(state[first], crops=fresh.shape.crops)
    rows = Transfer(
        kept=tuple(row for row in new if row in old),
        fresh=tuple(row for row in new if row not in old),
        dropped=tuple(row for row in old if row not in new),
        input=said,
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
    rows = [old[row] for row in wanted]
    few.policy.out_features = len(rows)
    few.policy.weight = nn.Parameter(network.policy.weight.detach()[rows])
    few.policy.bias = nn.Parameter(network.policy.bias.detach()[rows])
    return few


def head_rows(network: LSDNet, tree: ActionTree | None = None) -> dict[str, int]:
    """Number of every row of a network's head by name: `branch` where it has branches, then `branch/leaf`."""
    tree = tree or network.tree
    branches = tree.branches if network.shape.head == "tree" else ()
    names = [*branches, *("/".join(pair) for pair in tree.names)]
    return {name: row for row, name in enumerate(names)}


def _first_layer(network: LSDNet) -> str:
    layers = network.trunk.named_modules()
    return next(f"trunk.{name}.weight" for name, layer in layers if isinstance(layer, nn.Conv2d))


def _for_crops(weight: Tensor, *, crops: bool) -> tuple[Tensor, str]:
    """A first layer's weight (out, channels, h, w) with crops added to its input or taken from it.

    Channels lie picture after picture, all frames before all crops. The picture of a lone object is a crop
    that fills its frame. So what was learned of such frames is put to work on crops, and the frames around
    them begin at zero: the network starts as the old one looking at the crop, and learns what the rest of a
    frame is good for. The other way, a frame stands for both, which is the sum.
    """
    if crops:
        return torch.cat([torch.zeros_like(weight), weight], 1), "moved from frames to crops, zero for frames"
    frames, cut = weight.chunk(2, 1)
    return frames + cut, "of frames and crops added"
