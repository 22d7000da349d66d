"""Players that walk: how far they come in a room whose geometry is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from activelsd.envs.avd.starts import BoxScores, starts_by_score
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.oracle import shows_well
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.baselines import make_baseline
from activelsd.evaluate.nextbest import ForwardOnly, NextBestMove, RandomMoves, after_moves, recognise, table
from activelsd.evaluate.players import Trained
from activelsd.evaluate.protocol import EpisodeRow, Insider, Player, episodes_of, play
from activelsd.evaluate.walkers import Look, object_search
from activelsd.policy.lsdnet import LSDNet
from tests.evaluate.lattice import lattice
from tests.evaluate.worlds import Checked, network, ring

ROOM, SMALL = lattice(), lattice(side=4, thing=(1.0, 5.0))
RULES = EpisodeRules(max_views=24)
WALKERS = ("forward", "object_search", "oracle", "next_best_move")


class CheckedInsider(Checked):
    """Watched, and told where it is if it wants to know."""

    def tell(self, views: torch.Tensor, targets: torch.Tensor) -> None:
        assert views.shape == targets.shape == (self._batch,)
        if isinstance(self.player, Insider):
            self.player.tell(views, targets)


def played(
    player: Player, graph: ViewGraph = ROOM, rules: EpisodeRules = RULES, batch: int = 37
) -> list[EpisodeRow]:
    rows = episodes_of(graph, "test")
    return play(player, graph, rules, rows, world="room", backend="lattice", batch=batch)


@pytest.mark.parametrize("name", WALKERS)
def test_walkers_keep_the_protocol_in_any_batch(name: str) -> None:
    graph = lattice(side=3, thing=(1.0, 3.5), walls=[(1, 1)])
    player = CheckedInsider(make_baseline(name, network(graph), graph, 0), graph)
    rows = played(player, graph, batch=1)
    assert len(rows) == len(graph.start_view)
    for batch in (5, 96):
        assert played(player, graph, batch=batch) == rows


@pytest.mark.parametrize("name", WALKERS)
def test_the_last_view_and_rules_without_moves_are_obeyed(name: str) -> None:
    for rules in (EpisodeRules(max_views=2), EpisodeRules(can_move=False)):
        rows = played(CheckedInsider(make_baseline(name, network(ROOM), ROOM, 0), ROOM), rules=rules)
        assert max(row.views for row in rows) == (2 if rules.can_move else 1)


def wells(graph: ViewGraph) -> set[str]:
    """Names of the views that show the target well."""
    assert graph.pair_of is not None
    good = np.append(shows_well(graph), False)[graph.pair_of[:, 0]]
    return {graph.view_names[view] for view in np.flatnonzero(good)}


def test_the_oracle_takes_the_fewest_views_there_are() -> None:
    rows = played(make_baseline("oracle", network(ROOM), ROOM, 0))
    assert ROOM.oracle_views is not None
    assert [row.views for row in rows] == ROOM.oracle_views.tolist()
    assert {row.path[-1] for row in rows} <= wells(ROOM)
    assert max(row.views for row in rows) > 6


def test_the_oracle_answers_at_once_where_no_way_leads() -> None:
    shut = replace(ROOM, moves=np.full_like(ROOM.moves, -1))
    assert {row.views for row in played(make_baseline("oracle", network(shut), shut, 0), shut)} == {1}


@pytest.mark.parametrize("walls", [(), [(3, 5)], [(2, 4), (3, 4)]])
def test_object_search_ends_near_the_target(walls: list[tuple[int, int]]) -> None:
    """It sees no map: nearly every episode ends at a view about as good as the best, obstacles or not."""
    graph = lattice(walls=walls)
    rows = played(make_baseline("object_search", network(graph), graph, 0), graph)
    good = wells(graph)
    arrived = np.mean([row.path[-1] in good for row in rows])
    started = np.mean([row.start in good for row in rows])
    assert started < 0.1
    assert arrived > 0.9, f"{arrived:.2f}"
    assert graph.oracle_views is not None
    assert np.mean([row.views for row in rows]) < 2.5 * graph.oracle_views.mean()


def searched(looks: list[Look], first: Look, *, tilts: bool = False) -> list[str]:
    """What the search does when it sees these one after the other; it must end with the last."""
    search = object_search(first, tilts=tilts)
    moves = [next(search), *(search.send(look) for look in looks[:-1])]
    with pytest.raises(StopIteration):
        search.send(looks[-1])
    return moves


def look(
    middle: float = 0.0, area: float = 0.0, stuck: bool = False, cut: bool = False, height: float = 0.0
) -> Look:
    return Look(middle, height, area, cut, stuck)


def test_object_search_goes_by_its_rules() -> None:
    # Turn until seen, centre, approach, and take back the step that loses it.
    assert searched(
        [look(), look(0.4, 0.1), look(-0.1, 0.1), look(0, 0.2), look(), look(0, 0.2)], look()
    ) == ["rotate_cw", "rotate_cw", "rotate_cw", "forward", "forward", "backward"]
    # A step so near that the frame cuts it off is taken back; a start so near, too.
    near = look(0, 0.3, cut=True)
    assert searched([near, look(0, 0.2)], look(0, 0.2)) == ["forward", "backward"]
    assert searched([near, look(0, 0.2)], near) == ["backward", "backward"]
    assert searched([look(0, 0.3, True, True)], near) == ["backward"]
    # A turn that does not help is taken back.
    assert searched([look(-0.45, 0.1), look(-0.4, 0.1), look(-0.4, 0.1)], look(-0.4, 0.1)) == [
        "rotate_ccw",
        "rotate_cw",
        "forward",
    ]
    # Blocked: aside, to where the target is first, and on; when it grows no more, it is over.
    wall, free = look(0.1, 0.1, True), look(0.1, 0.1)
    moves = searched([wall, wall, free, look(0.1, 0.2), look(0.1, 0.2)], free)
    assert moves == ["forward", "right", "left", "forward", "forward"]
    # A step aside that gains nothing is taken back, and the other side tried.
    moves = searched([wall, look(0.1, 0.05), look(0.1, 0.05, True), free, wall], free)
    assert moves == ["forward", "right", "forward", "left", "left"]
    # One that shows the target larger is not.
    moves = searched([wall, look(0, 0.2), look(0, 0.2, True)], free)
    assert moves == ["forward", "right", "forward"]
    # Shut in: over.
    assert searched([look(0, 0.1, True)] * 3, look(0, 0.1)) == ["forward", "left", "right"]
    # Nothing in sight all around: somewhere else, and around again.
    moves = searched([look()] * 11 + [look(stuck=True), look(), look(0, 0.5), look(0, 0.4)], look())
    assert moves == ["rotate_cw"] * 11 + ["forward", "left", "rotate_cw", "forward"]


def test_object_search_tilts_where_it_can() -> None:
    low, level = look(0.4, 0.1, height=0.4), look(0, 0.1, height=0.4)
    assert searched([level, look(0, 0.2), look(0, 0.1)], low) == ["rotate_cw", "forward", "forward"]
    moves = searched([level, look(0, 0.1, height=0.1), look(0, 0.1)], low, tilts=True)
    assert moves == ["rotate_cw", "look_down", "forward"]
    # One that does not help is taken back; one that is blocked is not tried again.
    high = look(0, 0.1, height=-0.4)
    assert searched([look(0, 0.1, height=0.45), high, high], high, tilts=True) == [
        "look_up",
        "look_down",
        "forward",
    ]
    blocked = look(0, 0.1, stuck=True, height=-0.4)
    assert searched([blocked, look(0, 0.1)], high, tilts=True) == ["look_up", "forward"]


def test_forward_walks_on_and_turns_where_it_is_blocked() -> None:
    rows = played(make_baseline("forward", network(ROOM), ROOM, 0))
    assert {(row.views, row.forced) for row in rows} == {(24, True)}
    start = next(row for row in rows if row.start == "0_0_0")
    assert start.path[:9] == (*(f"0_{y}_0" for y in range(7)), "0_6_0", "0_6_30")


def test_players_need_moves_and_boxes_that_a_ring_has_not() -> None:
    graph = ring()
    for name, sentence in (
        ("forward", "forward needs the move 'forward', and this world's are wall, cw, half; leave it out"),
        ("object_search", "object_search needs the move 'forward'"),
        ("oracle", "oracle needs a world whose targets have boxes"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            make_baseline(name, network(graph), graph, 0)


def with_bias(graph: ViewGraph, classes: float) -> LSDNet:
    """A network whose first class scores `classes` logits above the other, whatever it sees."""
    net = network(graph, "stack")
    with torch.no_grad():
        net.policy.weight.zero_()
        net.policy.bias.zero_()
        net.policy.bias[2] = classes
        net.policy.bias[4 + 4] = 1.0  # rotate_cw
    return net


def test_next_best_move_goes_on_until_it_is_sure() -> None:
    again = replace(RULES, try_again=True)
    for player in (NextBestMove, lambda net: RandomMoves(net, 0), ForwardOnly):
        assert {row.views for row in played(player(with_bias(SMALL, 2.0)), SMALL, again)} == {24}  # 0.88
        assert {row.views for row in played(player(with_bias(SMALL, 2.5)), SMALL, again)} == {1}  # 0.92
    rows = played(NextBestMove(with_bias(SMALL, 0.0)), SMALL)
    assert rows[0].path[:3] == ("0_0_0", "0_0_30", "0_0_60")
    rows = played(ForwardOnly(with_bias(SMALL, 0.0)), SMALL, again)
    assert rows[0].path == (*(f"0_{y}_0" for y in range(4)), *["0_3_0"] * 20)
    ways = [
        pair for row in played(RandomMoves(with_bias(SMALL, 0.0), 0), SMALL) for pair in pairwise(row.path)
    ]
    assert len({(a.split("_")[2] == b.split("_")[2], a == b) for a, b in ways}) == 3


def test_the_table_counts_what_was_reached_after_so_many_moves() -> None:
    rows = played(NextBestMove(network(ROOM, "stack")), rules=EpisodeRules(max_views=21))
    for moves, accuracy in zip((0, 3, 5, 10, 20), after_moves(rows), strict=True):
        reached = [row.answers[min(moves, row.views - 1)] == row.label for row in rows]
        assert accuracy == pytest.approx(np.mean(reached))
    printed = table({"next_best_move": rows}, "split 1")
    assert printed.splitlines()[1].split() == ["moves", "0", "3", "5", "10", "20"]
    assert printed.splitlines()[2].split()[0] == "next_best_move"


def test_recognising_is_what_an_episode_that_starts_there_answers() -> None:
    net = network(ROOM, "stack")
    scores = recognise(net, ROOM)
    rows = played(Trained(net))
    assert ROOM.pair_of is not None
    for row, view in zip(rows, ROOM.start_view, strict=True):
        pair = ROOM.pair_of[view, 0]
        if pair >= 0:
            assert scores.right[pair] == (row.answers[0] == row.label)
    assert 0.5 <= scores.score.min() < scores.score.max() <= 1


def test_starts_by_score_are_unsure_views_of_targets_that_are_named_both_ways() -> None:
    n = len(ROOM.boxes) if ROOM.boxes is not None else 0
    score, right = np.linspace(0, 1, n, dtype=np.float32), np.arange(n) % 2 == 0
    both = replace(ROOM, start_split=np.arange(len(ROOM.start_view), dtype=np.uint8) % 3)
    found = starts_by_score(both, BoxScores(score, right), 0.9)
    assert found.pair_of is not None
    pairs = found.pair_of[found.start_view, found.start_target]
    assert sorted(pairs.tolist()) == [pair for pair in range(n) if score[pair] < 0.9]
    for all_alike in (np.ones(n, bool), np.zeros(n, bool)):
        assert not len(starts_by_score(both, BoxScores(score, all_alike), 0.9).start_view)
