"""The rules: Table 1 as presets, each played out by the environment as the table says."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.envs.episode import PRESETS, EpisodeRules
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.errors import ConfigError
from tests.graphs import ring_graph, room_graph

GRAPHS = {"ring": ring_graph(objects=9, classes=3), "room": room_graph()}

# Written off the paper's Table 1 and its authors' code: wrong class, ends on right, ends on wrong, may move.
TABLE = {
    "V0": (0.0, True, False, True),
    "V1": (0.0, False, False, True),
    "V2": (-1.0, False, False, True),
    "V3": (-1.0, True, False, True),
    "V4": (0.0, True, True, True),
    "V5": (-1.0, True, True, True),
    "V6": (0.0, True, True, False),
}


def test_presets_are_the_rows_of_the_table() -> None:
    assert set(PRESETS) == set(TABLE)
    for name, (wrong, on_right, on_wrong, can_move) in TABLE.items():
        rules = PRESETS[name]
        assert (rules.wrong, rules.ends_on_right, rules.ends_on_wrong, rules.can_move) == (
            wrong,
            on_right,
            on_wrong,
            can_move,
        )
        assert (rules.right, rules.move, rules.blocked, rules.max_views) == (1.0, 0.0, 0.0, 12)


def test_evaluation_ends_on_any_class_and_keeps_the_rest() -> None:
    rules = replace(PRESETS["V2"], max_views=5, move=-0.1, can_move=False)
    evaluated = rules.for_evaluation()
    assert (evaluated.ends_on_right, evaluated.ends_on_wrong) == (True, True)
    assert replace(evaluated, ends_on_right=False, ends_on_wrong=False) == rules


def test_rules_are_frozen_and_need_a_view() -> None:
    with pytest.raises(FrozenInstanceError):
        PRESETS["V0"].right = 2.0  # type: ignore[misc]
    with pytest.raises(ConfigError, match="at least 1, not 0; set"):
        EpisodeRules(max_views=0)


@settings(max_examples=60)
@given(
    world=st.sampled_from(sorted(GRAPHS)),
    preset=st.sampled_from(sorted(TABLE)),
    limit=st.sampled_from([1, 2, 4, 12]),
    priced=st.booleans(),
    try_again=st.booleans(),
    revisit=st.booleans(),
    seed=st.integers(0, 99),
    data=st.data(),
)
def test_episodes_are_played_by_the_table(
    world: str,
    preset: str,
    limit: int,
    priced: bool,
    try_again: bool,
    revisit: bool,
    seed: int,
    data: st.DataObject,
) -> None:
    """Against the table's words, written a second time."""
    graph = GRAPHS[world]
    wrong, on_right, on_wrong, can_move = TABLE[preset]
    move, blocked, right = (-0.125, -0.5, 2.0) if priced else (0.0, 0.0, 1.0)
    rules = replace(PRESETS[preset], max_views=limit, move=move, blocked=blocked, right=right)
    rules = replace(rules, try_again=try_again, revisit=revisit)
    env = ViewGraphEnv(graph, rules, frames=2)
    _, info = env.reset(seed=seed)
    classes = len(graph.classes)
    place = int(graph.start_view[graph.find(info["episode_id"])])
    path = [place]
    walls: set[int] = set()  # moves that were blocked where it stands
    for t in range(1, limit + 1):
        open_moves = [a for a in range(classes, env.tree.n) if can_move and t < limit and a not in walls]
        known = [a for a in open_moves if graph.moves[place, a - classes] in path]
        if not revisit and any(graph.moves[place, a - classes] >= 0 for a in set(open_moves) - set(known)):
            open_moves = [a for a in open_moves if a not in known]
        legal = [a < classes or a in open_moves for a in range(env.tree.n)]
        assert info["action_mask"].tolist() == legal
        action = data.draw(st.integers(0, env.tree.n - 1), label="action")
        observation, reward, terminated, truncated, info = env.step(action)
        ends, moved = False, False
        if action < classes:
            is_right = action == info["label"]
            expected = right if is_right else wrong
            ends = on_right if is_right else on_wrong
        else:
            to = int(graph.moves[place, action - classes])
            moved = can_move and t < limit and to >= 0
            expected = move if moved else blocked
            if moved:
                place, walls = to, set()
            elif not try_again:
                walls.add(action)
            if t < limit:
                path.append(place)
        assert (reward, terminated, truncated) == (expected, ends, t == limit and not ends)
        assert (info["moved"], info["views"]) == (moved, len(path))
        assert (observation["frames"][-1] == graph.frames[path[-1]]).all()
        assert (observation["frames"][0] == graph.frames[path[max(len(path) - 2, 0)]]).all()
        if terminated or truncated:
            break
    else:
        raise AssertionError("an episode outlived its limit")
