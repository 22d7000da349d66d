"""The world as Gymnasium sees it, live and on recordings alike, and what its simulator's failures do."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from activelsd.envs.base import ActiveVisionEnv
from activelsd.envs.thor import recordings
from activelsd.envs.thor.env import LiveTHOREnv
from activelsd.envs.thor.prepare import recorded_rooms
from activelsd.envs.thor.room import Scene, WalkableRoom
from activelsd.envs.thor.settings import MOVES, THORSettings
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.envs.world import world_settings
from activelsd.errors import ConfigError, DataError
from tests.envs.thor.simulator import FakeSimulator


def settings(world: dict[str, Any], **more: Any) -> THORSettings:
    found = world_settings("thor", {**world, **more})
    assert isinstance(found, THORSettings)
    return found


def graph_of(world: dict[str, Any], **more: Any) -> ViewGraph:
    return settings(world, **more).open()


def live_env(world: dict[str, Any], frames: int = 1, **more: Any) -> LiveTHOREnv:
    env = settings(world, live=True, **more).env(frames=frames)
    assert isinstance(env, LiveTHOREnv)
    return env


@pytest.fixture
def simulators(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FakeSimulator]]:
    """Every simulator that was started; all are stopped at the end."""
    started: list[FakeSimulator] = []

    def start(settings: object) -> FakeSimulator:
        started.append(FakeSimulator())
        return started[-1]

    monkeypatch.setattr(recordings, "start", start)
    yield started
    assert all(simulator.stopped for simulator in started)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture
def world(cache: Path, simulators: list[FakeSimulator]) -> dict[str, Any]:
    """Keyword arguments of a small world; its recordings are made once for all tests."""
    found = {
        "backend": "standin",
        "rooms": ("kitchen",),
        "train": 1,
        "val": 1,
        "test": 1,
        "classes": ("Apple", "Bowl", "Box"),
        "size": 32,
        "step": 0.25,
        "min_pixels": 0.0,
        "per_target": 5,
        "simulators": 1,
        "cache": str(cache),
    }
    graph_of(found)
    simulators.clear()
    return found


@pytest.mark.parametrize(("colour", "channels"), [("gray", 1), ("rgb", 3)])
def test_live_and_recorded_episodes_are_the_same_to_the_byte(
    world: dict[str, Any], colour: str, channels: int
) -> None:
    live: ActiveVisionEnv = live_env(world, frames=2, colour=colour)
    recorded = settings(world, colour=colour).env(frames=2)
    rng = np.random.default_rng(0)
    one, told = live.reset(seed=3)
    other, _ = recorded.reset(options={"episode": told["episode_id"]})
    assert one["frames"].shape == one["crops"].shape == (2 * channels, 32, 32)
    for _ in range(300):
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])
        action = rng.choice(np.flatnonzero(told["action_mask"]))
        one, *results, told = live.step(action)
        other, *same, again = recorded.step(action)
        assert results == same
        np.testing.assert_array_equal(told.pop("action_mask"), again["action_mask"])
        assert told.items() <= again.items()
        if results[1] or results[2]:
            one, told = live.reset()
            other, _ = recorded.reset(options={"episode": told["episode_id"]})
        else:
            told["action_mask"] = again["action_mask"]
    live.close()


def test_so_many_episodes_in_a_row_are_of_one_scene(world: dict[str, Any]) -> None:
    env = live_env(world, train=2, rooms=("kitchen", "bedroom"), episodes_per_scene=4)
    env.reset(seed=1)
    names = [env.reset()[1]["scene"] for _ in range(399)]
    scenes = np.array([env.reset(seed=1)[1]["scene"], *names]).reshape(100, 4)
    assert (scenes == scenes[:, :1]).all()
    counts = [np.count_nonzero(scenes[:, 0] == name) for name in np.unique(scenes)]
    assert len(counts) == 4
    assert min(counts) > 10
    env.close()


def test_answers_and_blocked_moves_need_no_simulator(
    world: dict[str, Any], simulators: list[FakeSimulator]
) -> None:
    env = live_env(world)
    env.reset(seed=0)
    (simulator,) = simulators
    before = len(simulator.calls)
    env.step(0)
    assert len(simulator.calls) == before
    blocked = next(
        env.tree.index("navigate", move)
        for move in MOVES
        if env.graph.moves[env._view, env.graph.move_names.index(move)] < 0
    )
    _, reward, _, _, told = env.step(blocked)
    assert not told["moved"]
    assert reward == env.rules.blocked
    assert len(simulator.calls) == before
    assert set(simulator.calls) == {"reset", "GetReachablePositions", "SetObjectFilter", "TeleportFull"}
    env.close()


def test_a_place_where_the_agent_does_not_land_any_more_is_blocked(
    world: dict[str, Any], simulators: list[FakeSimulator]
) -> None:
    env = live_env(world)
    _, told = env.reset(seed=0)
    (simulator,) = simulators
    move = next(
        env.tree.index("navigate", name)
        for name in ("forward", "backward", "left", "right")
        if env.graph.moves[env._view, env.graph.move_names.index(name)] >= 0
    )
    view = env._view
    # Every cell but the one where it stands.
    assert env.graph.poses is not None
    here = tuple(np.rint(env.graph.poses[view, :2] / 0.25).astype(int))
    simulator.sealed = tuple((x, z) for x in range(3) for z in range(3) if (x, z) != here)
    seen, _, _, _, told = env.step(move)
    assert not told["moved"]
    assert env._view == view
    again, *_ = env.step(move)
    np.testing.assert_array_equal(seen["frames"], again["frames"])
    env.close()


def test_a_lost_simulator_truncates_the_episode_and_the_next_begins(
    world: dict[str, Any], simulators: list[FakeSimulator]
) -> None:
    env = live_env(world)
    env.reset(seed=0)
    (simulator,) = simulators
    simulator.lost = frozenset({len(simulator.calls) + 1})
    turn = env.tree.index("navigate", "rotate_cw")
    seen, reward, terminated, truncated, told = env.step(turn)
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert told["cut"] == "the player is gone"
    assert seen in env.observation_space
    # Once more while it enters the scene: reset does not give up.
    simulator.lost = frozenset({len(simulator.calls) + 3})
    seen, told = env.reset()
    assert "cut" not in told
    assert seen["frames"].any()
    assert simulator.calls.count("reset") == 3
    env.close()


def test_it_is_an_environment_of_gymnasium(world: dict[str, Any], simulators: list[FakeSimulator]) -> None:
    env = gymnasium.make(
        "activelsd/THOR-v0", **world, live=True, render_mode="rgb_array", disable_env_checker=True
    )
    check_env(env.unwrapped, skip_close_check=True)
    env.close()
    before = len(simulators)  # who plays recordings starts none
    vector = gymnasium.make_vec("activelsd/THOR-v0", num_envs=3, **world)
    seen, _ = vector.reset(seed=0)
    assert seen["frames"].shape == (3, 1, 32, 32)
    assert len(simulators) == before


def test_scenes_of_the_splits_never_meet_and_starts_show_their_target(world: dict[str, Any]) -> None:
    graph = graph_of(world)
    scenes = [
        {graph.scenes[graph.scene_of[view]] for view in graph.start_view[graph.start_split == i]}
        for i in range(len(SPLITS))
    ]
    assert scenes == [{"FloorPlan1"}, {"FloorPlan21"}, {"FloorPlan26"}]
    for view, target in zip(graph.start_view, graph.start_target, strict=True):
        assert graph.target_box(view, target)[4] == 1
    counts = np.bincount(graph.start_target[graph.start_split > 0])
    assert counts.max() <= 5


def test_a_table_has_all_but_the_pictures(world: dict[str, Any]) -> None:
    graph, table = graph_of(world), recorded_rooms(settings(world), pictures=False)
    assert table.frames.shape == graph.frames.shape
    assert not table.frames.any()
    assert table.frames.base is not None  # a single zero
    np.testing.assert_array_equal(table.start_view, graph.start_view)
    np.testing.assert_array_equal(table.oracle_views, graph.oracle_views)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"navigate": ("forwrd",)}, "did you mean forward"),
        ({"backend": "stand-in"}, "did you mean standin"),
        ({"rooms": ("kitchn",)}, "did you mean kitchen"),
    ],
)
def test_what_is_unknown_is_said(world: dict[str, Any], change: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        graph_of(world, **change)


def test_scenes_with_nothing_to_ask_for_are_left_out_in_one_line(
    world: dict[str, Any],
    simulators: list[FakeSimulator],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """They are not entered again; where no scene has anything, that is an error."""
    enter = WalkableRoom.enter

    def entered(room: WalkableRoom, name: str) -> Scene:
        scene = enter(room, name)
        return scene._replace(targets=()) if name in ("FloorPlan2", "FloorPlan21") else scene

    monkeypatch.setattr(WalkableRoom, "enter", entered)
    more = {"train": 2, "classes": ("Apple", "Bowl")}
    graph = graph_of(world, **more)
    assert set(graph.scenes) == {"FloorPlan1", "FloorPlan26"}
    simulators.clear()
    graph_of(world, **more)
    assert not simulators
    line = "Scenes without any of the objects that are asked for are left out: FloorPlan2, FloorPlan21."
    assert caplog.messages == [line, line]
    with pytest.raises(DataError, match=r"No scene has any of Laptop, Toaster; name other types"):
        graph_of(world, classes=("Toaster", "Laptop"))
