"""One conformance suite over every player, and what sets each apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import torch
from torch import Tensor

from activelsd import registry
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.metrics import by_allowed
from activelsd.evaluate.players import Draws, Trained, longest_sweep, make_player
from activelsd.evaluate.protocol import EpisodeRow, Player, episodes_of, play
from activelsd.policy.lsdnet import LSDNet
from tests.evaluate.worlds import CLASSES, RULES, Checked, network, ring, rings

GRAPH = ring()
# The others need a world to walk in, see test_walkers.
NAMES = [
    *("trained", "no_move", "random_walk", "random_policy", "all_views", "next_best_move", "sweep"),
    *("confidence", "random+learned", "sweep+confidence"),
]


def make(name: str, net: LSDNet, graph: ViewGraph = GRAPH, seed: int = 0) -> Player:
    return Trained(net) if name == "trained" else make_player(name, net, graph, seed)


def played(
    player: Player, graph: ViewGraph = GRAPH, rules: EpisodeRules = RULES, batch: int = 7
) -> list[EpisodeRow]:
    return play(
        player, graph, rules, episodes_of(graph, "test"), world="rings", backend="random", batch=batch
    )


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize(
    ("memory", "head"), [("stack", "tree"), ("lstm", "tree"), ("pool", "tree"), ("pool", "flat")]
)
def test_every_player_keeps_the_protocol_in_any_batch(name: str, memory: str, head: str) -> None:
    player = Checked(make(name, network(GRAPH, memory, head)), GRAPH)
    rows = played(player, batch=1)
    for batch in (4, 18):
        assert played(player, batch=batch) == rows, "neither batch nor an earlier game changes a game"
    assert player.name == name
    assert player.begun == 3


def test_what_it_would_have_named_is_what_it_names_with_fewer_views(name: str) -> None:
    """Accuracy against views allowed comes out of one game exactly as out of a game per allowance."""
    graph, net = ring(27), network(ring(), "lstm")
    whole = by_allowed(played(make(name, net, graph), graph), RULES.max_views)
    for allowed in range(1, RULES.max_views + 1):
        rows = played(make(name, net, graph), graph, replace(RULES, max_views=allowed), batch=9)
        one = whole[allowed - 1]
        assert one.right == sum(row.right for row in rows)
        assert one.views == pytest.approx(np.mean([row.views for row in rows]))


def test_moves_that_are_ruled_out_are_not_made(name: str) -> None:
    rows = played(Checked(make(name, network(GRAPH)), GRAPH), rules=EpisodeRules(can_move=False))
    assert {row.views for row in rows} == {1}


def test_no_move_names_what_the_network_sees_first() -> None:
    net = network(GRAPH)
    rows = played(make("no_move", net))
    assert {row.views for row in rows} == {1}
    assert not any(row.forced for row in rows)
    assert [row.answer for row in rows] == [row.answers[0] for row in played(Trained(net))]


@torch.inference_mode()
def test_all_views_sweeps_the_ring_and_then_answers() -> None:
    net = network(GRAPH, "lstm")
    rows = played(make("all_views", net))
    for row in rows:
        assert len(row.path) == len(set(row.path)) == 6
        state = net.initial_state(1)
        for i, view in enumerate(row.path):
            frame = GRAPH.frames[GRAPH.scenes.index(row.scene) * 6 + int(view[1:])]
            looks = {
                "frames": torch.from_numpy(frame)[None, None, None],
                "target": torch.tensor([[[[0.5, 0.5, 1.0, 1.0, 1.0]]]]),
            }
            output = net(looks, state, torch.tensor([[i == 0]]))
            state = output.state
        mask = torch.ones(1, net.tree.n, dtype=torch.bool)
        best = net.distribution(output.logits[0], mask).class_log_probs().argmax(-1)
        assert row.answer == CLASSES[int(best)]


def test_all_views_stops_where_views_end() -> None:
    rows = played(make("all_views", network(GRAPH)), rules=EpisodeRules(max_views=4))
    assert {(row.views, row.forced) for row in rows} == {(4, True)}
    # With more views allowed than the ring has, the sweep ends with the ring.
    rows = played(make("all_views", network(GRAPH)), rules=EpisodeRules(max_views=20))
    assert {(row.views, row.forced) for row in rows} == {(6, False)}


def test_all_views_sees_every_ring_as_a_whole() -> None:
    graph = rings(8, 10, 18, 20)
    net = network(graph)
    for batch in (1, 7):
        rows = played(make("all_views", net, graph), graph, EpisodeRules(max_views=24), batch)
        assert [row.views for row in rows] == [n for n in (8, 10, 18, 20) for _ in range(n)]
        assert all(len(set(row.path)) == row.views and not row.forced for row in rows)


def test_all_views_sees_most_from_where_an_episode_starts() -> None:
    """On a line of four views, one move leads right and the other left."""
    line = np.array([[1, -1], [2, 0], [3, 1], [-1, 2]], np.int32)
    graph = replace(ring(1, 4, moves=("cw", "half")), moves=line, start_split=np.full(4, 2, np.uint8))
    rows = played(make("all_views", network(graph), graph), graph)
    assert [row.path for row in rows] == [
        ("a0", "a1", "a2", "a3"),
        ("a1", "a2", "a3"),
        ("a2", "a1", "a0"),
        ("a3", "a2", "a1", "a0"),
    ]


def test_the_sweep_is_the_move_that_sees_most() -> None:
    assert longest_sweep(GRAPH, 0) == (1, 6)
    assert longest_sweep(ring(moves=("half", "wall")), 0) == (0, 2)
    assert longest_sweep(ring(moves=("wall",)), 0) == (0, 1)


def answering(graph: ViewGraph, chance: float) -> LSDNet:
    """A network whose policy answers at every view with the same chance."""
    net = network(graph)
    with torch.no_grad():
        net.policy.weight.zero_()
        net.policy.bias.zero_()
        net.policy.bias[1] = math.log(1 / chance - 1)
    return net


@pytest.mark.parametrize("chance", [0.02, 0.06, 0.1, 0.2, 0.3, 0.49, 0.51, 0.9])
def test_it_stops_when_half_of_all_drawn_episodes_would_have(chance: float) -> None:
    for name in ("trained", "random_walk"):
        rows = played(make(name, answering(GRAPH, chance)), rules=EpisodeRules(max_views=30))
        assert {row.views for row in rows} == {min(30, math.ceil(math.log(0.5) / math.log(1 - chance)))}


def test_random_walk_draws_moves_uniformly() -> None:
    """Moves of a ring lead to different views, so paths tell them apart."""
    graph = ring(63, views=6, moves=("cw", "half"))
    rows = played(make("random_walk", answering(graph, 0.01)), graph, EpisodeRules(max_views=12), batch=50)
    assert {row.views for row in rows} == {12}
    strides = np.array(
        [[(int(b[1]) - int(a[1])) % 6 for a, b in zip(r.path, r.path[1:], strict=False)] for r in rows]
    )
    assert set(strides.ravel()) == {1, 3}
    draws = strides == 1
    for sample in (draws, draws[:, 0], draws[:, -1], draws[:, 1:] == draws[:, :-1], draws[1:] == draws[:-1]):
        assert abs(sample.mean() - 0.5) < 4 * 0.5 / np.sqrt(sample.size)
    others = played(make("random_walk", answering(graph, 0.01), seed=1), graph, EpisodeRules(max_views=12))
    assert others != rows


def test_random_walk_answers_as_the_network_does() -> None:
    net = network(GRAPH)
    walk, own = played(make("random_walk", net)), played(Trained(net))
    # Up to its first move it is the network itself.
    assert [row.answers[0] for row in walk] == [row.answers[0] for row in own]
    assert [row.views == 1 for row in walk] == [row.views == 1 for row in own]


def test_random_policy_draws_branch_then_leaf() -> None:
    graph = ring(135)
    rows = played(make("random_policy", network(graph)), graph, EpisodeRules(max_views=12), batch=50)
    n = len(rows)
    for views, share in ((1, 1 / 2), (2, 1 / 4), (3, 1 / 8)):
        assert abs(np.mean([row.views == views for row in rows]) - share) < 4 * np.sqrt(
            share * (1 - share) / n
        )
    for label in CLASSES:
        assert abs(np.mean([row.answer == label for row in rows]) - 1 / 3) < 4 * np.sqrt(2 / 9 / n)


def test_draws_are_uniform_over_what_is_open() -> None:
    draws = Draws(3)
    draws.begin(6000)
    draws.look(torch.ones(6000, dtype=torch.bool))
    among = torch.tensor([[True, False, True, True, False]]).expand(6000, -1)
    counts = torch.bincount(draws.choose(among, 0, 2), minlength=5)
    assert counts[[1, 4]].tolist() == [0, 0]
    assert (counts[[0, 2, 3]] - 2000).abs().max() < 4 * np.sqrt(6000 * 2 / 9)
    assert not draws.choose(torch.zeros_like(among), 1, 2).any()
    assert not torch.equal(draws.choose(among, 0, 2), draws.choose(among, 1, 2))


BRANCHES = {"step": ("cw", "half"), "rest": ("wall",)}


@pytest.mark.parametrize("head", ["tree", "flat"])
def test_moves_may_stand_in_several_branches(name: str, head: str) -> None:
    graph = GRAPH.with_moves(BRANCHES)
    player = Checked(make(name, network(graph, head=head), graph), graph)
    rows = played(player, graph, EpisodeRules(max_views=6))
    if name != "no_move":
        assert max(row.views for row in rows) > 1
    if name == "all_views":
        assert {len(set(row.path)) for row in rows} == {6}


def test_the_likeliest_move_is_that_of_all_branches() -> None:
    graph = ring(9, moves=("cw", "half")).with_moves({"step": ("cw",), "jump": ("half",)})
    for liked, stride in (("step", 1), ("jump", 3)):
        net = network(graph)
        with torch.no_grad():
            net.policy.weight.zero_()
            net.policy.bias.zero_()
            net.policy.bias[net.tree.branches.index(liked)] = 5.0
        rows = played(Trained(net), graph, EpisodeRules(max_views=4))
        for row in rows:
            assert (int(row.path[1][1]) - int(row.path[0][1])) % 6 == stride


class Twice(Trained):
    """A player of somebody else's: nothing but `act`."""

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        self.look(observation, mask, first)
        move = self.likeliest_move()
        legal = mask.gather(1, move[:, None]).squeeze(1)
        return torch.where(first & legal, move, self.name_class())


def test_a_player_that_only_acts_is_found_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("twice", f"{__name__}:Twice", "activelsd.players")
    monkeypatch.setattr(registry, "_installed", lambda group: {"twice": entry} if group == "players" else {})
    player = make("twice", network(GRAPH))
    assert player.name == "twice"
    assert {row.views for row in played(Checked(player, GRAPH))} == {2}
    assert {row.views for row in played(player, rules=EpisodeRules(can_move=False))} == {1}
    assert Trained(network(GRAPH), name="run-7").name == "run-7"


def test_an_unknown_player_names_the_nearest() -> None:
    net = network(GRAPH)
    with pytest.raises(ConfigError, match="no player 'randomwalk'; did you mean random_walk"):
        make_player("randomwalk", net, GRAPH, 0)
    with pytest.raises(ConfigError, match="no player 'xyz'; there are no_move, random_walk"):
        make_player("xyz", net, GRAPH, 0)
