"""Worlds side by side: exactly each world stepped alone, and nothing of another legal in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from activelsd.envs.actions import ActionTree
from activelsd.envs.episode import PRESETS
from activelsd.envs.joint import JointVectorEnv, OpenWorld, play_recordings, union
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, DataError
from tests.graphs import ring_graph, room_graph

RING = replace(ring_graph(objects=6, classes=3, size=4), classes=("bed", "cup", "vase"))  # cup is in both
ROOM = room_graph(size=4)
PLAIN = room_graph(size=4, crops=False)
GRAPHS = {"ring": RING, "room": ROOM, "plain": PLAIN}
RULES = {
    "ring": PRESETS["V4"],
    "room": replace(PRESETS["V2"], max_views=3, move=-0.1, blocked=-0.3),
    "plain": PRESETS["V6"],
}


def part(name: str, num_envs: int, frames: int = 2, device: str = "cpu") -> ViewGraphVectorEnv:
    return ViewGraphVectorEnv(GRAPHS[name], RULES[name], num_envs=num_envs, frames=frames, device=device)


def joint(*names: str, num_envs: int = 3, device: str = "cpu") -> JointVectorEnv:
    return JointVectorEnv({name: part(name, num_envs, device=device) for name in names})


def legal(mask: Tensor, seed: int) -> Tensor:
    """(B,) any legal actions."""
    weights = mask * torch.rand(mask.shape, generator=torch.Generator().manual_seed(seed))
    return weights.argmax(1)


@settings(max_examples=30)
@given(
    names=st.lists(st.sampled_from(sorted(GRAPHS)), min_size=1, unique=True),
    shares=st.lists(st.integers(1, 4), min_size=3, max_size=3),
    seed=st.integers(0, 99),
)
def test_it_is_exactly_its_parts_stepped_alone(names: list[str], shares: list[int], seed: int) -> None:
    both = JointVectorEnv({name: part(name, n) for name, n in zip(names, shares, strict=False)})
    alone = {name: part(name, n) for name, n in zip(names, shares, strict=False)}
    both.begin(seed)
    first = 0
    for name, env in alone.items():
        env.begin(seed + first)
        assert both.places[name] == slice(first, first + env.num_envs)
        first += env.num_envs
    assert first == both.num_envs
    crops = "room" in names
    for t in range(20):
        seen, mask, labels = both.observe(), both.mask(), both.labels
        actions = legal(mask, t)
        step = both.advance(actions)
        assert seen.keys() == {"frames", "target", *(["crops"] if crops else [])}
        for name, env in alone.items():
            place, graph, tree = both.places[name], GRAPHS[name], env.tree
            own = env.observe()
            assert torch.equal(seen["frames"][place], own["frames"])
            assert torch.equal(seen["target"][place], own["target"])
            if crops:
                assert torch.equal(seen["crops"][place], own.get("crops", own["frames"]))
            named = [both.tree.leaves[0][i] for i in labels[place].tolist()]
            assert named == [graph.classes[i] for i in env.labels.tolist()]

            # By name: the union's action, the world's action.
            done = [both.tree.names[a] for a in actions[place].tolist()]
            theirs = env.advance(torch.tensor([tree.index(*name) for name in done]))
            answers = step.answer[place].tolist()
            for answer, own_answer in zip(answers, theirs.answer.tolist(), strict=True):
                assert (answer < 0) == (own_answer < 0)
                assert answer < 0 or both.tree.leaves[0][answer] == graph.classes[own_answer]
            for field in ("reward", "terminated", "truncated", "moved", "views", "row"):
                assert torch.equal(getattr(step, field)[place], getattr(theirs, field)), field


def test_masks_leave_each_row_its_own_worlds_actions() -> None:
    env = joint("ring", "room", "plain")
    env.begin(0)
    closed: set[bool] = set()
    for t in range(40):
        mask = env.mask()
        for name, place in env.places.items():
            part = env.parts[name]
            own = [env.tree.index(*action) for action in part.tree.names]
            assert torch.equal(mask[place][:, own], part.mask())
            others = [i for i in range(env.tree.n) if i not in own]
            assert not mask[place][:, others].any()
            closed.update(part.mask()[:, -1].tolist())
        env.advance(legal(mask, t))
    assert closed == {True, False}


def test_nearer_is_each_worlds_own_and_none_where_there_are_no_boxes() -> None:
    env, found = joint("ring", "room", num_envs=8), 0
    env.begin(0)
    for t in range(10):
        nearer = env.nearer()
        assert not nearer[env.places["ring"]].any()
        room, place = env.parts["room"], env.places["room"]
        own = [env.tree.index(*action) for action in room.tree.names]
        assert torch.equal(nearer[place][:, own], room.nearer())
        found += int(nearer.sum())
        assert int(nearer.sum()) == int(room.nearer().sum())
        env.advance(legal(env.mask(), t))
    assert found


def test_another_worlds_action_is_an_error() -> None:
    env = joint("ring", "room")
    env.begin(0)
    actions = legal(env.mask(), 0)
    actions[0] = env.tree.index("navigate", "forward")
    with pytest.raises(IndexError):
        env.advance(actions)


def test_the_union_of_trees_keeps_the_order_names_come_in() -> None:
    one = ActionTree({"classify": ["cup", "bed"], "navigate": ["left"]})
    other = ActionTree({"classify": ["desk", "cup"], "navigate": ["left", "up"], "grasp": ["pull"]})
    assert union([one, other]).to_dict() == {
        "classify": ["cup", "bed", "desk"],
        "navigate": ["left", "up"],
        "grasp": ["pull"],
    }
    assert union([one]) == one


def test_state_goes_on_where_it_was_taken() -> None:
    env, other = joint("ring", "room"), joint("ring", "room")
    env.begin(3)
    for t in range(10):
        env.advance(legal(env.mask(), t))
    other.load_state({name: value.clone() for name, value in env.state().items()})
    for t in range(20):
        actions = legal(env.mask(), t)
        for mine, theirs in zip(env.advance(actions), other.advance(actions), strict=True):
            assert torch.equal(mine, theirs)
        assert torch.equal(env.mask(), other.mask())
        for name, value in env.observe().items():
            assert torch.equal(value, other.observe()[name])


def test_nothing_waits_for_the_device() -> None:
    env = joint("ring", "room", device="meta")
    env.begin(0)
    for _ in range(3):
        assert env.observe()["crops"].shape == (6, 2, 4, 4)
        assert (env.mask().shape, env.labels.shape) == ((6, env.tree.n), (6,))
        assert env.advance(torch.zeros(6, dtype=torch.int64, device="meta")).reward.shape == (6,)


def recordings(*graphs: ViewGraph) -> list[OpenWorld]:
    return [OpenWorld(f"world_{i}", graph, PRESETS["V4"]) for i, graph in enumerate(graphs)]


def test_environments_are_shared_out_evenly_and_one_world_stays_as_it_is() -> None:
    env = play_recordings(recordings(RING, ROOM, PLAIN), num_envs=8, frames=1)
    assert isinstance(env, JointVectorEnv)
    assert [part.num_envs for part in env.parts.values()] == [3, 3, 2]
    alone = play_recordings(recordings(ROOM), num_envs=8, frames=1)
    assert isinstance(alone, ViewGraphVectorEnv)
    assert alone.num_envs == 8


def test_worlds_that_do_not_fit_together() -> None:
    with pytest.raises(ConfigError, match=r"need frames of one size, not world_0 4, world_1 8 pixels;"):
        play_recordings(recordings(RING, room_graph(size=8)), num_envs=4, frames=1)
    with pytest.raises(ConfigError, match=r"^train\.envs=1 is too few for 2 worlds; set it to at least 2\.$"):
        play_recordings(recordings(RING, ROOM), num_envs=1, frames=1)
    only_test = replace(ROOM, start_split=np.full_like(ROOM.start_split, 2))
    with pytest.raises(DataError, match="'train' split has no episode"):
        play_recordings(recordings(RING, only_test), num_envs=4, frames=1)
