"""Players that follow a schedule, against the orders that a person would write down, and their stops."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.players import Trained, make_player
from activelsd.evaluate.protocol import episodes_of, play
from activelsd.evaluate.schedules import Places
from activelsd.registry import UnknownPartError
from tests.evaluate.worlds import Checked, network, ring

AROUND = ("cw", "ccw", "orbit_ccw_90", "orbit_cw_90", "half")
RULES = EpisodeRules(max_views=8)


def circle(moves: tuple[str, ...] = AROUND, elevation: float = 30.0) -> ViewGraph:
    """Rings of twelve views, 30 degrees apart."""
    graph = ring(views=12, moves=("cw",))
    angle, first = np.arange(len(graph.frames)) % 12, np.arange(len(graph.frames)) // 12 * 12
    by = {"cw": -1, "ccw": 1, "orbit_ccw_90": 3, "orbit_cw_90": -3, "half": 6}
    leads = [first + (angle + by[move]) % 12 for move in moves]
    directions = np.stack([30.0 * angle, np.full(len(angle), elevation)], 1).astype(np.float32)
    return replace(graph, moves=np.stack(leads, 1).astype(np.int32), move_names=moves, directions=directions)


def orders(name: str, graph: ViewGraph, rules: EpisodeRules = RULES) -> set[tuple[int, ...]]:
    """Views seen by a player that never answers by itself, in degrees from the first, over all episodes."""
    player = make_player(name, network(graph), graph, 0)
    assert isinstance(player, Trained)
    player.stop.thresholds = torch.tensor([2.0])
    checked = Checked(player, graph)
    rows = play(checked, graph, rules, episodes_of(graph, "test"), world="rings", backend="random")
    seen = [[int(view[1:]) for view in row.path] for row in rows]
    return {tuple((view - path[0]) * 30 % 360 for view in path) for path in seen}


def test_quarters_come_first_and_then_what_is_farthest() -> None:
    assert orders("quarter", circle()) == {(0, 90, 180, 270, 240, 330, 60, 150)}
    clockwise = circle(("cw", "ccw", "orbit_cw_90"))
    assert {order[:4] for order in orders("quarter", clockwise)} == {(0, 270, 180, 90)}
    with pytest.raises(ConfigError, match=r"quarter needs the move orbit_ccw_90 or orbit_cw_90, and this"):
        make_player("quarter", network(circle(("cw",))), circle(("cw",)), 0)


def test_spread_makes_the_move_that_leads_farthest_from_all_seen() -> None:
    graph = circle()
    for order in orders("spread", graph):
        for n in range(1, len(order)):
            reached = [(order[n - 1] + turn) % 360 for turn in (-30, 30, 90, -90, 180)]
            gap = {to: min(min((to - a) % 360, (a - to) % 360) for a in order[:n]) for to in reached}
            assert gap[order[n]] == max(gap.values())
    assert {order[:4] for order in orders("spread", graph)} == {(0, 180, 270, 90)}
    assert orders("spread", circle(("cw",))) == {(0, 330, 300, 270, 240, 210, 180, 150)}


def test_distances_are_along_the_circle_at_its_elevation_and_metres_in_rooms() -> None:
    level, high = (Places(circle(elevation=e), torch.device("cpu")) for e in (0.0, 60.0))
    zero, views = torch.zeros(7, dtype=torch.int64), torch.arange(7)
    torch.testing.assert_close(level.apart(zero, views), 30.0 * views.double())
    assert float(high.apart(zero[:1], views[6:])) == pytest.approx(60.0), "over the pole"
    poses = np.array([[0, 0, 10], [3, 4, 350], [0, 0, 350]], np.float32)
    room = Places(replace(circle(), directions=None, poses=poses), torch.device("cpu"))
    apart = room.apart(torch.zeros(3, dtype=torch.int64), torch.arange(3)).tolist()
    assert apart == pytest.approx([0.0, 5.02, 0.02])
    with pytest.raises(ConfigError, match="does not say where its cameras stand; leave out spread"):
        Places(ring(), torch.device("cpu"))
    poses[1] = np.nan
    with pytest.raises(ConfigError, match="not known where 1 of 3 views were taken; leave out spread"):
        Places(replace(circle(), directions=None, poses=poses), torch.device("cpu"))


def test_views_seen_before_are_left_out_where_the_rules_say_so() -> None:
    rules = replace(RULES, revisit=False)
    for name in ("random+learned", "spread", "quarter", "learned+confidence"):
        assert all(len(set(order)) == len(order) for order in orders(name, circle(), rules))
    assert any(len(set(order)) < len(order) for order in orders("random+learned", circle()))


def test_a_stop_answers_at_its_threshold_for_that_number_of_views() -> None:
    graph = circle()
    player = make_player("spread+confidence", network(graph), graph, 0)
    assert isinstance(player, Trained)
    for thresholds, views in (([0.0], 1), ([2.0, 2.0, 0.0], 3), ([2.0, 0.0, 2.0], 2), ([2.0], 8)):
        player.stop.thresholds = torch.tensor(thresholds)
        rows = play(player, graph, RULES, episodes_of(graph, "test"), world="rings", backend="random")
        assert {row.views for row in rows} == {views}


def test_moves_and_stops_combine_by_name_and_others_are_refused() -> None:
    graph, net = circle(), network(circle())
    rows = {
        name: [
            replace(row, player="")
            for row in play(
                make_player(name, net, graph, 0),
                graph,
                RULES,
                episodes_of(graph, "test"),
                world="",
                backend="",
            )
        ]
        for name in ("random_walk", "random+learned", "confidence", "learned+confidence", "next_best_move")
    }
    assert rows["random_walk"] == rows["random+learned"]
    assert rows["confidence"] == rows["learned+confidence"] == rows["next_best_move"]
    with pytest.raises(UnknownPartError, match="There is no stop 'confidense'; did you mean confidence"):
        make_player("spread+confidense", net, graph, 0)
    with pytest.raises(UnknownPartError, match="There is no player 'sprad'; did you mean spread"):
        make_player("sprad+confidence", net, graph, 0)
    with pytest.raises(ConfigError, match=r"^all_views decides by itself when to answer; write all_views in"):
        make_player("all_views+confidence", net, graph, 0)


def test_where_a_quarter_turn_is_blocked_it_spreads_in_any_batch() -> None:
    graph = circle()
    moves = graph.moves.copy()
    moves[::2, AROUND.index("orbit_ccw_90")] = -1
    walled = replace(graph, moves=moves)
    games = []
    for batch in (1, 7, 36):
        player = make_player("quarter", network(graph), walled, 0)
        assert isinstance(player, Trained)
        player.stop.thresholds = torch.tensor([2.0])
        rows = play(player, walled, RULES, episodes_of(graph, "test"), world="", backend="", batch=batch)
        games.append([row.path for row in rows])
    assert games[0] == games[1] == games[2]
    assert all(a != b for path in games[0] for a, b in pairwise(path))
