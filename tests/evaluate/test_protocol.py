"""Every episode is played once, as a single environment plays it, and ends with one answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import DataError
from activelsd.evaluate.players import Trained
from activelsd.evaluate.protocol import EpisodeRow, Player, episodes_of, play
from tests.evaluate.worlds import CLASSES, RULES, Checked, Scripted, network, ring

GRAPH = ring()
CW, HALF = 4, 5


def played(
    player: Player, graph: ViewGraph = GRAPH, rules: EpisodeRules = RULES, **more: object
) -> list[EpisodeRow]:
    episodes = episodes_of(graph, "test")
    return play(player, graph, rules, episodes, world="rings", backend="random", **more)  # type: ignore[arg-type]


@torch.inference_mode()
def one_by_one(
    player: Player, graph: ViewGraph, rules: EpisodeRules, start: int
) -> tuple[int, list[str], bool]:
    """Class named, views seen and whether it was forced, by the Gymnasium environment of one episode."""
    env = ViewGraphEnv(graph, rules.for_evaluation(), split="test", frames=player.frames)
    observation, info = env.reset(seed=0, options={"episode": graph.episode(start).id})
    player.begin(1)
    path = [env._view]
    first = torch.tensor([True])
    while True:
        mask = torch.from_numpy(info["action_mask"])[None]
        tensors = {name: torch.from_numpy(value)[None] for name, value in observation.items()}
        action = int(player.act(tensors, mask, first))
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            assert info["views"] == len(path)
            return action, [graph.view_names[view] for view in path], not bool(mask[0, len(CLASSES) :].any())
        path.append(env._view)
        first = torch.tensor([False])


@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
@pytest.mark.parametrize("batch", [1, 5, 18, 100])
def test_playing_is_what_single_environments_give(memory: str, batch: int) -> None:
    player = Trained(network(GRAPH, memory))
    episodes = episodes_of(GRAPH, "test")
    rows = played(Checked(player, GRAPH), batch=batch)
    assert [row.start for row in rows] == [GRAPH.episode(int(start)).start for start in episodes]
    for start, row in zip(episodes.tolist(), rows, strict=True):
        answer, path, forced = one_by_one(player, GRAPH, RULES, start)
        assert (row.answer, list(row.path), row.forced) == (CLASSES[answer], path, forced)
        assert row.right == (answer == GRAPH.episode(start).label)
    lengths = {row.views for row in rows}
    assert len(lengths) > 1, "a network that always does the same shows nothing"


@pytest.mark.parametrize("batch", [1, 2, 4, 7, 17, 18])
def test_each_episode_is_there_once_and_in_order(batch: int) -> None:
    """Lengths that differ by episode let some places of the batch run far ahead of others."""
    graph = ring(27, views=3)
    player = Checked(
        Scripted(lambda seen, free: CW if free and len(seen) <= seen[0] % 5 else seen[0] % 3), graph
    )
    rows = played(player, graph, EpisodeRules(max_views=9), batch=batch)
    listed = [graph.episode(int(start)) for start in episodes_of(graph, "test")]
    assert [(row.target, row.start) for row in rows] == [(one.target, one.start) for one in listed]
    for row, start in zip(rows, episodes_of(graph, "test").tolist(), strict=True):
        look = int(graph.frames[graph.start_view[start]].astype(int).sum())
        assert row.views == 1 + look % 5
        assert row.answer == CLASSES[look % 3]
        assert not row.forced
        assert row.answers[-1] == row.answer
        assert len(row.path) == len(row.answers) == row.views
        assert (row.player, row.world, row.backend) == ("scripted", "rings", "random")


def test_at_the_last_view_only_an_answer_is_left() -> None:
    rows = played(Checked(Scripted(lambda seen, free: CW if free else 1), GRAPH), batch=5)
    assert {row.views for row in rows} == {RULES.max_views}
    assert all(row.forced for row in rows)
    assert {row.answer for row in rows} == {"door"}
    assert all(len(set(row.path)) == 6 for row in rows)


def test_without_moves_every_answer_is_forced() -> None:
    rules = EpisodeRules(can_move=False)
    rows = played(Checked(Scripted(lambda seen, free: CW if free else 0), GRAPH), rules=rules)
    assert all(row.forced and row.views == 1 for row in rows)


def test_the_first_class_ends_an_episode_whatever_it_was_trained_by() -> None:
    for rules in (EpisodeRules(ends_on_right=False), EpisodeRules(), EpisodeRules(ends_on_wrong=True)):
        rows = played(Scripted(lambda seen, free: 0), rules=rules)
        assert all(row.views == 1 for row in rows)
        assert sum(row.right for row in rows) == len(rows) / 3


def test_blocked_moves_are_views_of_the_same() -> None:
    twice = Scripted(lambda seen, free: 3 if len(seen) < 3 else 0, "twice")
    rows = played(twice, rules=replace(RULES, try_again=True))
    by_start = {row.start: row.path for row in rows}
    assert by_start["a0"] == ("a0", "a0", "a0")
    assert by_start["a2"] == ("a2", "a4", "a4")
    with pytest.raises(ValueError, match="'twice' took an action that the mask forbids"):
        played(twice)


def test_an_illegal_action_is_refused() -> None:
    with pytest.raises(ValueError, match="'mover' took an action that the mask forbids"):
        played(Scripted(lambda seen, free: HALF, "mover"))


def test_progress_grows_to_the_whole() -> None:
    told: list[tuple[int, int]] = []
    played(Trained(network(GRAPH)), batch=4, progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert told[-1] == (18, 18)


def test_playing_leaves_torch_and_the_network_as_they_were() -> None:
    """A run that looks at its validation split goes on to the bit as one that does not."""
    net = network(GRAPH)
    before, weights = torch.get_rng_state(), {k: v.clone() for k, v in net.state_dict().items()}
    played(Trained(net))
    assert torch.equal(before, torch.get_rng_state())
    assert all(torch.equal(weights[name], value) for name, value in net.state_dict().items())
    assert net.training


def test_the_list_of_episodes_is_every_start_or_so_many_of_each() -> None:
    every = episodes_of(GRAPH, "test")
    assert sorted(every.tolist()) == np.flatnonzero(GRAPH.start_split == 2).tolist()
    drawn = episodes_of(GRAPH, "test", per_object=20, seed=1)
    targets, counts = np.unique(GRAPH.start_target[drawn], return_counts=True)
    assert targets.tolist() == np.unique(GRAPH.start_target[every]).tolist()
    assert counts.tolist() == [20] * 3
    assert set(drawn.tolist()) <= set(every.tolist())
    assert np.array_equal(drawn, episodes_of(GRAPH, "test", per_object=20, seed=1))
    assert not np.array_equal(drawn, episodes_of(GRAPH, "test", per_object=20, seed=2))
    assert len(play(Scripted(lambda s, f: 0), GRAPH, RULES, drawn, world="w", backend="b")) == 60


def test_a_split_without_episodes_is_one_sentence() -> None:
    with pytest.raises(DataError, match="'test' split has no episode"):
        episodes_of(ring(3), "test")
    with pytest.raises(DataError, match="no split 'tset'"):
        episodes_of(GRAPH, "tset")
