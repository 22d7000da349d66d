"""The single environment: Gymnasium's own check, what it shows, what a move costs, replays."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match

import activelsd.envs
from activelsd.envs.actions import ActionTree
from activelsd.envs.base import ActiveVisionEnv
from activelsd.envs.episode import PRESETS, Episode, EpisodeRules, View
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.viewgraph import ViewGraph, load_graph, save_graph
from activelsd.errors import ConfigError, DataError
from tests.graphs import ring_graph, room_graph

RING, ROOM, BARE = ring_graph(objects=9, classes=3), room_graph(), room_graph(crops=False)
ALL = pytest.mark.parametrize("graph", [RING, ROOM, BARE], ids=["ring", "room with crops", "room"])
WORLD = {"classes": ["cup", "vase"], "train_per_class": 2, "test_per_class": 1, "size": 32}
"""The registered world on six embedded shapes."""


def make(
    graph: ViewGraph = ROOM, rules: str | EpisodeRules = "V1", frames: int = 3, **more: Any
) -> ViewGraphEnv:
    return ViewGraphEnv(graph, PRESETS[rules] if isinstance(rules, str) else rules, frames=frames, **more)


@ALL
@pytest.mark.parametrize("preset", sorted(PRESETS))
@pytest.mark.filterwarnings("ignore:.*not having a spec")
def test_gymnasium_finds_no_fault(graph: ViewGraph, preset: str) -> None:
    check_env(make(graph, preset, render_mode="rgb_array"))


def test_the_registered_world_passes_gymnasiums_check() -> None:
    env = gymnasium.make(
        "activelsd/World-v0", world="modelnet", rules="V0", navigate=["orbit_cw", "orbit_ccw_90"], **WORLD
    )
    check_env(env.unwrapped)
    assert env.unwrapped.tree == ActionTree.answer_or_move(["cup", "vase"], ["orbit_cw", "orbit_ccw_90"])
    assert env.reset(seed=0)[1]["backend"] == "modelnet"
    by_module = gymnasium.make(f"{activelsd.envs.__name__}:activelsd/ModelNet-v0", **WORLD)
    assert by_module.reset(seed=0)[0]["frames"].shape == (1, 32, 32)


def test_the_registered_world_is_made_in_batches_too() -> None:
    envs = gymnasium.make_vec("activelsd/ModelNet-v0", num_envs=3, rules="V4", **WORLD)
    observations, infos = envs.reset(seed=5)
    assert observations["frames"].shape == (3, 1, 32, 32)
    for i in range(3):
        alone = gymnasium.make("activelsd/ModelNet-v0", rules="V4", **WORLD)
        assert infos["episode_id"][i] == alone.reset(seed=5 + i)[1]["episode_id"]


@ALL
@pytest.mark.parametrize("frames", [1, 3])
def test_observations_are_what_the_space_says_and_nothing_more(graph: ViewGraph, frames: int) -> None:
    env = make(graph, frames=frames)
    observation, info = env.reset(seed=3)
    pictures = ["frames"] if graph.crops is None else ["frames", "crops"]
    assert set(observation) == {*pictures, "target"}
    shape = (frames, graph.size, graph.size)
    for name in pictures:
        assert (observation[name].shape, observation[name].dtype) == (shape, np.uint8)
    assert (observation["target"].shape, observation["target"].dtype) == ((frames, 5), np.float32)
    rng = np.random.default_rng(0)
    for _ in range(40):
        assert env.observation_space.contains(observation)
        observation, _, terminated, truncated, info = env.step(rng.integers(env.tree.n))
        if terminated or truncated:
            observation, info = env.reset()
    assert set(info) == {
        *("views", "moved", "action_mask", "backend", "episode_id"),
        *("scene", "target", "label", "start", "split"),
    }


def test_a_recording_looks_the_same_from_its_file(tmp_path: Path) -> None:
    save_graph(ROOM, tmp_path / "room.h5", {})
    env = make(load_graph(tmp_path / "room.h5"))
    check_environments_match(env, make(ROOM), num_steps=60)
    assert type(env.reset()[0]["frames"]) is np.ndarray


def test_two_copies_match_and_seeds_differ() -> None:
    check_environments_match(
        make(render_mode="rgb_array"), make(render_mode="rgb_array"), num_steps=100, seed=4
    )
    ids = [[info["episode_id"] for info in resets(make(), seed, 6)] for seed in (0, 0, 1)]
    assert ids[0] == ids[1] != ids[2]


def resets(env: ViewGraphEnv, seed: int | None, n: int) -> list[dict[str, Any]]:
    return [env.reset(seed=seed)[1], *(env.reset()[1] for _ in range(n - 1))]


def test_an_unseeded_reset_goes_on_in_the_stream() -> None:
    env = make()
    first = [info["episode_id"] for info in resets(env, 7, 8)]
    assert len(set(first)) > 4
    again = [info["episode_id"] for info in resets(env, 7, 4)]
    assert again == first[:4]
    assert [info["episode_id"] for info in resets(env, None, 4)] == first[4:]


def test_never_seeded_environments_draw_apart() -> None:
    one, other = ([info["episode_id"] for info in resets(make(), None, 8)] for _ in range(2))
    assert one != other


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_episodes_are_those_of_the_split_and_all_come(split: str) -> None:
    env = make(split=split)
    seen = {info["episode_id"] for info in resets(env, 0, 600)}
    assert seen == {ROOM.episode(int(row)).id for row in ROOM.starts(split)}


@ALL
def test_an_episode_replays_by_its_id(graph: ViewGraph) -> None:
    played, replayed = make(graph, frames=2), make(graph, frames=2)
    replayed.reset(seed=99)
    rng = np.random.default_rng(1)
    for _ in range(10):
        first = played.reset()
        assert data_equivalence(
            first, replayed.reset(options={"episode": first[1]["episode_id"]}), exact=True
        )
        for action in rng.integers(played.tree.n, size=4):
            assert data_equivalence(played.step(action), replayed.step(action), exact=True)


def test_a_replay_takes_nothing_from_the_stream_and_knows_every_split() -> None:
    env, plain = make(), make()
    other = ROOM.episode(int(ROOM.starts("test")[0])).id
    ids = [info["episode_id"] for info in resets(plain, 2, 4)]
    assert env.reset(seed=2)[1]["episode_id"] == ids[0]
    assert env.reset(options={"episode": other})[1]["episode_id"] == other
    assert [env.reset()[1]["episode_id"] for _ in range(3)] == ids[1:]
    with pytest.raises(DataError, match="no episode 'x'; ids look like"):
        env.reset(options={"episode": "x"})


@ALL
def test_the_first_look_stands_in_every_place(graph: ViewGraph) -> None:
    observation, info = make(graph, frames=3).reset(seed=1)
    for values in observation.values():
        assert all(np.array_equal(values[0], value) for value in values)
    row = graph.find(info["episode_id"])
    view, target = int(graph.start_view[row]), int(graph.start_target[row])
    assert np.array_equal(observation["frames"][0], graph.frames[view])
    assert np.array_equal(observation["target"][0], graph.target_box(view, target))
    if graph.crops is not None:
        assert np.array_equal(observation["crops"][0], graph.crop(view, target))
    assert (info["views"], info["moved"]) == (1, False)


@ALL
def test_a_class_that_does_not_end_leaves_the_stack_as_it_is(graph: ViewGraph) -> None:
    env = make(graph, "V1", frames=2)
    env.reset(seed=1)
    env.step(len(graph.classes))
    before, _, _, _, info = env.step(len(graph.classes) + 1)
    after, _, terminated, truncated, later = env.step(info["label"])
    assert not terminated
    assert not truncated
    assert data_equivalence(before, after, exact=True)
    assert (later["views"], later["moved"]) == (info["views"], False)


def test_a_blocked_move_costs_and_shows_the_same_view() -> None:
    env = make(rules=replace(PRESETS["V1"], move=-0.1, blocked=-0.7), frames=2)
    blocked = 0
    for row in ROOM.starts("train"):
        view = int(ROOM.start_view[row])
        for column in np.flatnonzero(ROOM.moves[view] < 0):
            first, info = env.reset(options={"episode": ROOM.episode(int(row)).id})
            assert info["action_mask"].all()
            then, reward, terminated, truncated, info = env.step(len(ROOM.classes) + column)
            assert (reward, terminated, truncated) == (-0.7, False, False)
            assert (info["views"], info["moved"]) == (2, False)
            assert data_equivalence(first, then, exact=True)
            blocked += 1
    assert blocked > 10


def test_the_newest_view_stands_last() -> None:
    env = make(RING, frames=3)
    _, info = env.reset(seed=0)
    view = int(RING.start_view[RING.find(info["episode_id"])])
    path = [view]
    for _ in range(3):
        path.append(int(RING.moves[path[-1], 0]))
        observation, *_ = env.step(len(RING.classes))
    assert all(a != b for a, b in pairwise(path))
    assert np.array_equal(observation["frames"], RING.frames[path[-3:]])


def test_rendering_gives_the_newest_view_in_colour() -> None:
    env = make(RING, render_mode="rgb_array")
    assert env.render() is None
    observation, _ = env.reset(seed=0)
    picture = env.render()
    assert picture is not None
    assert picture.shape == (RING.size, RING.size, 3)
    assert all(np.array_equal(picture[..., c], observation["frames"][-1]) for c in range(3))
    silent = make(RING)
    silent.reset(seed=0)
    assert silent.render() is None


def test_stepping_before_the_first_reset_is_refused() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        make().step(0)


@pytest.mark.parametrize("action", [-1, 7, 100])
def test_actions_outside_the_space_are_refused(action: int) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(gymnasium.error.InvalidAction, match=f"no action {action}"):
        env.step(action)


def test_no_frames_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^frames=0 stacks no view; set it to at least 1\.$"):
        make(frames=0)


def test_unknown_reset_options_are_refused_and_take_nothing_from_the_stream() -> None:
    env, other = make(), make()
    env.reset(seed=0)
    other.reset(seed=0)
    with pytest.raises(ConfigError, match=r"^There is no reset option 'epsiode'; did you mean episode\?$"):
        env.reset(options={"epsiode": ROOM.episode(0).id})
    assert env.reset()[1]["episode_id"] == other.reset()[1]["episode_id"]
    env.reset_options = ("episode", "lamp")  # a backend may read more
    env.reset(options={"lamp": 1})


def test_a_graph_without_moves_is_one_sentence() -> None:
    with pytest.raises(DataError, match="name at least one in `navigate`"):
        make(ring_graph(objects=3, classes=1, moves=()))


class Corridor(ActiveVisionEnv):
    """A backend in a few lines, with two branches of moves: three doors in a row, and a lamp to switch."""

    def __init__(self, *, revisit: bool = True) -> None:
        rules = EpisodeRules(blocked=-1.0, revisit=revisit)
        tree = ActionTree({"classify": ["a", "b"], "walk": ["on", "back"], "touch": ["switch"]})
        super().__init__(tree, rules, size=4, frames=2, crops=False, backend="corridor")
        self.asked: list[str] = []

    def draw_episode(self, options: dict[str, Any]) -> Episode:
        self.place, self.light = 0, int(self.np_random.integers(2))
        return Episode(id="0", scene="corridor", target="door", label=1, start="0", split="train")

    def look(self) -> View:
        box = np.array([0.5, 0.5, 1.0, 1.0, 1.0], np.float32)
        return View(np.full((4, 4), 10 * self.place + self.light, np.uint8), box)

    def try_move(self, name: str) -> bool:
        self.asked.append(name)
        to = self.place + {"on": 1, "back": -1, "switch": 0}[name]
        if not 0 <= to <= 2:
            return False
        self.place, self.light = to, self.light ^ (name == "switch")
        return True


def test_a_backend_that_cannot_tell_where_a_move_leads_must_let_views_be_seen_again() -> None:
    with pytest.raises(ConfigError, match=r"revisit=false needs recorded views, since corridor does not"):
        Corridor(revisit=False)


@pytest.mark.filterwarnings("ignore:.*not having a spec")
def test_a_backend_of_three_methods_is_a_whole_world_with_any_branches() -> None:
    env = Corridor()
    check_env(env)
    env.asked.clear()
    start = int(env.reset(seed=0)[0]["frames"][-1, 0, 0])
    played = [env.step(action) for action in (2, 4, 3, 3, 1)]
    assert env.asked == ["on", "switch", "back", "back"]
    seen = [int(observation["frames"][-1, 0, 0]) for observation, *_ in played]
    assert seen == [start + 10, 11 - start, 1 - start, 1 - start, 1 - start]
    assert [reward for _, reward, *_ in played] == [0.0, 0.0, 0.0, -1.0, 1.0]
    assert [info["moved"] for *_, info in played] == [True, True, True, False, False]
    assert [terminated for _, _, terminated, _, _ in played] == [False] * 4 + [True]
