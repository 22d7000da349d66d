"""Players that walk: how far they come in a room whose geometry is known."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activelsd import registry
from activelsd.envs.avd.starts import BoxScores, starts_by_score
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.oracle import shows_well
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.players import make_player
from activelsd.evaluate.protocol import EpisodeRow, Player, episodes_of, play
from activelsd.evaluate.walkers import Look, object_search
from tests.evaluate.lattice import lattice
from tests.evaluate.worlds import Checked, network, ring

ROOM, SMALL = lattice(), lattice(side=4, thing=(1.0, 5.0))
RULES = EpisodeRules(max_views=24)
WALKERS = ("forward", "object_search", "oracle", "next_best_move")


def played(
    player: Player, graph: ViewGraph = ROOM, rules: EpisodeRules = RULES, batch: int = 37
) -> list[EpisodeRow]:
    rows = episodes_of(graph, "test")
    return play(player, graph, rules, rows, world="room", backend="lattice", batch=batch)


@pytest.mark.parametrize("name", WALKERS)
def test_walkers_keep_the_protocol_in_any_batch(name: str) -> None:
    graph = lattice(side=3, thing=(1.0, 3.5), walls=[(1, 1)])
    player = Checked(make_player(name, network(graph), graph, 0), graph)
    rows = played(player, graph, batch=1)
    assert len(rows) == len(graph.start_view)
    for batch in (5, 96):
        assert played(player, graph, batch=batch) == rows


@pytest.mark.parametrize("graph", [ring(), ROOM, ring().with_moves({"a": ("cw",), "b": ("half",)})])
def test_the_documented_player_and_figure_work_in_any_world(
    graph: ViewGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "players.md").read_text()
    for kind in (registry.players, registry.figures):
        monkeypatch.setattr(kind, "_added", {})
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(block, {"__name__": "documented"})
    rows = played(Checked(make_player("two_views", network(graph), graph, 0), graph), graph)
    assert {row.views for row in rows} == {2}
    same = np.mean([row.answers[0] == row.answers[1] for row in rows])
    assert registry.figures.get("moved_in_vain")(rows) == pytest.approx(same)


@pytest.mark.parametrize("name", WALKERS)
def test_walkers_find_their_moves_in_any_branch(name: str) -> None:
    """The same moves in two branches, in the same order: the same paths."""
    graph = lattice(side=4, thing=(1.0, 5.0))
    split = graph.with_moves({"step": graph.move_names[:4], "turn": graph.move_names[4:]})
    rows = played(Checked(make_player(name, network(split), split, 0), split), split)
    assert max(row.views for row in rows) > 3
    if name != "next_best_move":  # the network itself chooses its moves, by branch
        whole = played(make_player(name, network(graph), graph, 0), graph)
        assert [row.path for row in rows] == [row.path for row in whole]


@pytest.mark.parametrize("name", WALKERS)
def test_the_last_view_and_rules_without_moves_are_obeyed(name: str) -> None:
    for rules in (EpisodeRules(max_views=2), EpisodeRules(can_move=False)):
        rows = played(Checked(make_player(name, network(ROOM), ROOM, 0), ROOM), rules=rules)
        assert max(row.views for row in rows) == (2 if rules.can_move else 1)


def wells(graph: ViewGraph) -> set[str]:
    """Names of the views that show the target well."""
    assert graph.pair_of is not None
    good = np.append(shows_well(graph), False)[graph.pair_of[:, 0]]
    return {graph.view_names[view] for view in np.flatnonzero(good)}


def test_the_oracle_takes_the_fewest_views_there_are() -> None:
    rows = played(make_player("oracle", network(ROOM), ROOM, 0))
    assert ROOM.oracle_views is not None
    assert [row.views for row in rows] == ROOM.oracle_views.tolist()
    assert {row.path[-1] for row in rows} <= wells(ROOM)
    assert max(row.views for row in rows) > 6


def test_the_oracle_answers_at_once_where_no_way_leads() -> None:
    shut = replace(ROOM, moves=np.full_like(ROOM.moves, -1))
    assert {row.views for row in played(make_player("oracle", network(shut), shut, 0), shut)} == {1}


@pytest.mark.parametrize("walls", [(), [(3, 5)], [(2, 4), (3, 4)]])
def test_object_search_ends_near_the_target(walls: list[tuple[int, int]]) -> None:
    """It sees no map: nearly every episode ends at a view about as good as the best, obstacles or not."""
    graph = lattice(walls=walls)
    rows = played(make_player("object_search", network(graph), graph, 0), graph)
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
    rows = played(make_player("forward", network(ROOM), ROOM, 0))
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
            make_player(name, network(graph), graph, 0)


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
