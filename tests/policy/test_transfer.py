"""Weights carried over by names: what both know is kept to the byte, all else is as fresh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from activelsd.envs.actions import ActionTree
from activelsd.errors import RunError
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.policy.memories import State
from activelsd.policy.transfer import head_rows, narrow, transfer
from activelsd.train.trainer import new_network

SHAPE = NetworkShape(size=16, trunk_settings={"features": 8})
WORDS = st.lists(st.sampled_from("abcdefg"), min_size=1, unique=True)
MOVES = st.dictionaries(st.sampled_from(["navigate", "tilt", "walk"]), WORDS, min_size=1)
TREES = st.builds(lambda classes, moves: ActionTree.answer_or_move(classes, moves), WORDS, WORDS | MOVES)


def network(tree: ActionTree, seed: int, **shape: Any) -> LSDNet:
    """With something in every row of its outputs, which a fresh network has not."""
    made = new_network(tree, replace(SHAPE, **shape), seed)
    drawn = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        made.policy.bias.normal_(generator=drawn)
        if made.surroundings is not None:
            made.surroundings.outputs.weight.normal_(generator=drawn)
            made.surroundings.outputs.bias.normal_(generator=drawn)
    return made


def look(batch: int = 5, frames: int = 1, *, crops: bool = False, seed: int = 0) -> dict[str, Tensor]:
    """One observation, (1, batch, ...)."""
    drawn = torch.Generator().manual_seed(seed)

    def picture() -> Tensor:
        return torch.randint(0, 256, (1, batch, frames, 16, 16), dtype=torch.uint8, generator=drawn)

    seen = {"frames": picture(), "target": torch.rand(1, batch, frames, 5, generator=drawn)}
    return seen | ({"crops": picture()} if crops else {})


def outputs(net: LSDNet, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor, State]:
    batch = seen["frames"].shape[1]
    with torch.no_grad():
        output = net(seen, net.initial_state(batch), torch.ones(1, batch, dtype=torch.bool))
    return output.logits, output.value, output.state


@settings(max_examples=40)
@given(
    old=TREES,
    new=TREES,
    memory=st.sampled_from(["pool", "lstm", "stack"]),
    head=st.sampled_from(["tree", "flat"]),
    crops=st.booleans(),
)
def test_rows_of_names_both_know_are_kept_and_the_others_are_fresh(
    old: ActionTree, new: ActionTree, memory: str, head: str, crops: bool
) -> None:
    shape = {"memory": memory, "head": head, "crops": crops}
    source, fresh = (network(tree, seed, **shape) for tree, seed in ((old, 1), (new, 2)))
    before = [{k: v.clone() for k, v in one.state_dict().items()} for one in (source, fresh)]
    state, rows = transfer(source, fresh)
    for one, was in zip((source, fresh), before, strict=True):
        assert all(torch.equal(value, was[name]) for name, value in one.state_dict().items())

    again = network(new, 2, **shape)
    again.load_state_dict(state)
    for name, value in again.state_dict().items():
        if not name.startswith(("policy.", "surroundings.outputs.")):
            assert torch.equal(value, source.state_dict()[name]), name
    # The rows by name, counted a second time from the trees.
    names = [*(new.branches if head == "tree" else ()), *(f"{b}/{x}" for b, x in new.names)]
    known = {*(old.branches if head == "tree" else ()), *(f"{b}/{x}" for b, x in old.names)}
    theirs = list(head_rows(source))
    for row, name in enumerate(names):
        origin, at = (source, theirs.index(name)) if name in known else (fresh, row)
        assert torch.equal(again.policy.weight[row], origin.policy.weight[at])
        assert torch.equal(again.policy.bias[row], origin.policy.bias[at])
    if crops:
        steering = [[name for name in rows if not name.startswith("classify/")] for rows in (names, theirs)]
        for row, name in enumerate([*steering[0], "value"]):
            origin, at = (fresh, row)
            if name in known or name == "value":
                origin, at = source, [*steering[1], "value"].index(name)
            for kind in ("weight", "bias"):
                ours, whose = (getattr(net.surroundings.outputs, kind) for net in (again, origin))
                assert torch.equal(ours[row], whose[at])
    assert rows.kept == tuple(name for name in names if name in known)
    assert rows.fresh == tuple(name for name in names if name not in known)
    assert set(rows.dropped) == known - set(names)


TREE = ActionTree.answer_or_move(("cup", "vase"), ("left", "right"))


@pytest.mark.parametrize("frames", [1, 3])
def test_a_network_of_frames_begins_as_itself_looking_at_crops(frames: int) -> None:
    source = network(TREE, 1, frames=frames)
    fresh = new_network(TREE, replace(SHAPE, frames=frames, crops=True), 2)
    state, rows = transfer(source, fresh)
    fresh.load_state_dict(state)
    assert rows.around == "fresh"
    seen = look(frames=frames, crops=True)
    expected = outputs(source, {"frames": seen["crops"], "target": seen["target"]})
    for ours, theirs in zip(outputs(fresh, seen), expected, strict=True):
        torch.testing.assert_close(ours, theirs)
    # A picture without a crop of its own is its crop, and the way back is the way there.
    alone = {name: seen[name] for name in ("frames", "target")}
    for ours, theirs in zip(outputs(fresh, alone), outputs(source, alone), strict=True):
        torch.testing.assert_close(ours, theirs)
    back, rows = transfer(fresh, network(TREE, 3, frames=frames))
    assert rows.around == "dropped"
    assert all(torch.equal(value, back[name]) for name, value in source.state_dict().items())


def test_surroundings_that_begin_at_zero_still_learn() -> None:
    fresh = new_network(TREE, replace(SHAPE, crops=True), 2)
    output = fresh(look(crops=True), fresh.initial_state(5), torch.ones(1, 5, dtype=torch.bool))
    output.logits.square().sum().backward()
    assert fresh.surroundings is not None
    outputs = fresh.surroundings.outputs.weight
    assert float(outputs.detach().abs().max()) == 0.0
    assert float(outputs.grad.abs().max()) > 0.0


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        (
            {"memory": "lstm"},
            r"^A network with policy\.memory=pool cannot start one with policy\.memory=lstm;",
        ),
        (
            {"trunk_settings": {"features": 16}},
            r"with policy\.trunk\.features=16; set policy\.trunk\.features=8, or leave policy\.init out",
        ),
        ({"size": 32}, r"env\.size=16 cannot start one with env\.size=32; set env\.size=16, or leave"),
        ({"frames": 2}, r"policy\.frames=1"),
        ({"head": "flat"}, r"policy\.head=tree"),
    ],
)
def test_networks_that_differ_in_more_than_names(changed: dict[str, Any], sentence: str) -> None:
    with pytest.raises(RunError, match=sentence):
        transfer(network(TREE, 1), network(TREE, 2, **changed))


WIDE = ActionTree.answer_or_move(("cup", "desk", "vase", "bed"), ("left", "up", "right"))
FEW = ActionTree.answer_or_move(("bed", "cup"), ("right", "left"))


@pytest.mark.parametrize("crops", [False, True])
@pytest.mark.parametrize("head", ["tree", "flat"])
def test_a_narrowed_network_is_the_wide_one_where_no_more_is_legal(head: str, crops: bool) -> None:
    wide = network(WIDE, 4, head=head, crops=crops)
    few = narrow(wide, FEW)
    actions = [WIDE.index(*name) for name in FEW.names]
    mask = torch.zeros(WIDE.n, dtype=torch.bool)
    mask[actions] = True
    logits, value, state = outputs(wide, look(64, crops=crops))
    narrow_logits, narrow_value, narrow_state = outputs(few, look(64, crops=crops))
    torch.testing.assert_close(value, narrow_value)
    torch.testing.assert_close(state, narrow_state, rtol=0, atol=0)
    theirs = wide.distribution(logits, mask.expand(1, 64, -1))
    ours = few.distribution(narrow_logits, torch.ones(1, 64, FEW.n, dtype=torch.bool))
    torch.testing.assert_close(ours.probs, theirs.probs[..., actions])
    assert wide.tree == WIDE
    assert narrow(wide, WIDE) is wide
    with pytest.raises(RunError, match="not trained for classify/spoon"):
        narrow(wide, ActionTree.answer_or_move(("spoon",), ("left",)))
