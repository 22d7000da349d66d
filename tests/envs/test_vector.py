"""The batched environment: B copies of the single one, action for action, without waiting for the device."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, DataError
from tests.graphs import coloured, ring_graph, room_graph

GRAPHS = {
    "ring": ring_graph(objects=6, classes=2, size=4),
    "grid": ring_graph(
        objects=6, classes=2, size=4, elevations=2, moves=("orbit_cw", "orbit_up", "orbit_down")
    ),
    "room": room_graph(size=4),
    "room without crops": room_graph(crops=False, size=4),
    "room in colour": coloured(room_graph(size=4)),
}
ROOM = GRAPHS["room"]


def batch(graph: ViewGraph = ROOM, preset: str = "V4", num_envs: int = 4, **more: Any) -> ViewGraphVectorEnv:
    return ViewGraphVectorEnv(graph, PRESETS[preset], num_envs=num_envs, **more)


def assert_same(ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
    """Observations and infos to the bit, shapes and types included; rewards as single-precision numbers."""
    assert data_equivalence(ours[0], theirs[0], exact=True)
    if len(ours) == 5:
        np.testing.assert_array_equal(ours[1], theirs[1].astype(np.float32))
        assert data_equivalence(ours[2:4], theirs[2:4], exact=True)
    assert ours[-1].keys() == theirs[-1].keys()
    for name in theirs[-1]:
        assert data_equivalence(ours[-1][name], theirs[-1][name], exact=True), name


@settings(max_examples=60)
@given(
    world=st.sampled_from(sorted(GRAPHS)),
    preset=st.sampled_from(sorted(PRESETS)),
    limit=st.sampled_from([1, 2, 3, 12]),
    frames=st.sampled_from([1, 3]),
    num_envs=st.sampled_from([1, 3]),
    split=st.sampled_from(["train", "val"]),
    seed=st.one_of(st.integers(0, 9), st.lists(st.integers(0, 9), min_size=3, max_size=3)),
    leaning=st.sampled_from([0.0, 0.5, 0.9]),
    revisit=st.booleans(),
)
def test_a_batch_is_its_single_environments(
    world: str,
    preset: str,
    limit: int,
    frames: int,
    num_envs: int,
    split: str,
    seed: int | list[int | None],
    leaning: float,
    revisit: bool,
) -> None:
    """Any actions, legal or not; `leaning` is how often a move is tried, so that the limit is reached."""
    graph = GRAPHS[world]
    rules = replace(PRESETS[preset], max_views=limit, move=-0.1, blocked=-0.3, revisit=revisit)
    seed = seed[:num_envs] if isinstance(seed, list) else seed

    def single() -> ViewGraphEnv:
        return ViewGraphEnv(graph, rules, split=split, frames=frames, backend="tests")

    theirs = SyncVectorEnv([single] * num_envs, autoreset_mode=AutoresetMode.SAME_STEP)
    ours = ViewGraphVectorEnv(graph, rules, num_envs=num_envs, split=split, frames=frames, backend="tests")
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    rng = np.random.default_rng(0)
    for given_seed in (seed, None, seed):
        assert_same(ours.reset(seed=given_seed), theirs.reset(seed=given_seed))
        for _ in range(8):
            answers = rng.integers(len(graph.classes), size=num_envs)
            moves = rng.integers(len(graph.classes), ours.tree.n, num_envs)
            actions = np.where(rng.random(num_envs) < leaning, moves, answers)
            assert_same(ours.step(actions), theirs.step(actions))


def test_some_seeds_of_a_list_may_be_left_out() -> None:
    single = [lambda: ViewGraphEnv(ROOM, PRESETS["V4"])] * 3
    theirs, ours = SyncVectorEnv(single, autoreset_mode="SameStep"), batch(num_envs=3, frames=3)
    for seed in ([1, 2, 3], [None, 5, None], None, [7, None, None]):
        # The single environments' backend has its default name, as the batch's has.
        assert_same(ours.reset(seed=seed), theirs.reset(seed=seed))
    with pytest.raises(ValueError, match="3 environments but 2 seeds"):
        ours.reset(seed=[1, 2])


def test_reset_options_are_refused_rather_than_ignored() -> None:
    env = batch()
    env.reset(seed=0, options={})
    with pytest.raises(ValueError, match="no reset option 'episode'"):
        env.reset(options={"episode": ROOM.episode(0).id})


def test_what_gymnasium_asks_of_a_vector_environment() -> None:
    env = batch(frames=2)
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert env.action_space.n if hasattr(env.action_space, "n") else env.action_space.shape == (4,)
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    for _ in range(20):
        assert env.observation_space.contains(observation)
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert (reward.shape, terminated.shape, truncated.shape) == ((4,), (4,), (4,))
        assert (terminated.dtype, truncated.dtype) == (np.bool_, np.bool_)
        assert not (terminated & truncated).any()
    assert env.np_random_seed == 0
    env.close()
    env.close()


def test_gymnasiums_statistics_count_our_episodes() -> None:
    env = RecordEpisodeStatistics(batch(GRAPHS["ring"], "V0", num_envs=2))
    _, infos = env.reset(seed=0)
    label = int(infos["label"][0])
    move, right, wrong = 2, np.array([label, 2]), np.array([1 - label, 2])
    for actions in (np.array([move, move]), wrong):
        assert "episode" not in env.step(actions)[4]
    infos = env.step(right)[4]
    assert infos["_episode"].tolist() == [True, False]
    assert (infos["episode"]["r"][0], infos["episode"]["l"][0]) == (1.0, 3)


@pytest.mark.parametrize("world", sorted(GRAPHS))
@pytest.mark.parametrize(("num_envs", "frames"), [(1, 1), (3, 2)])
def test_what_is_returned_is_the_callers_own(world: str, num_envs: int, frames: int) -> None:
    """Scribbling over all that was returned changes nothing that comes."""
    ours, clean = (batch(GRAPHS[world], "V0", num_envs, frames=frames) for _ in range(2))
    returned, expected = ours.reset(seed=3), clean.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(30):
        assert data_equivalence(returned, expected, exact=True)
        scribble(returned)
        actions = rng.integers(ours.tree.n, size=num_envs)
        returned, expected = ours.step(actions), clean.step(actions)


def scribble(data: Any) -> None:
    if isinstance(data, np.ndarray) and data.dtype != object:
        data[...] = 1
    elif isinstance(data, (tuple, np.ndarray)):
        for part in data:
            scribble(part)
    elif isinstance(data, dict):
        scribble(tuple(data.values()))


@pytest.mark.parametrize("world", sorted(GRAPHS))
@pytest.mark.parametrize("preset", ["V0", "V6"])
def test_nothing_waits_for_the_device(world: str, preset: str) -> None:
    """On the meta device there is no value to wait for: asking for one raises."""
    env = batch(GRAPHS[world], preset, frames=2, device="meta")
    env.begin(0)
    actions = torch.zeros(4, dtype=torch.int64, device="meta")
    for _ in range(3):
        observation = env.observe()
        assert observation["frames"].shape == (4, 2 * env.graph.channels, env.graph.size, env.graph.size)
        assert (env.mask().shape, env.labels.shape) == ((4, env.tree.n), (4,))
        assert env.advance(actions).reward.shape == (4,)
    with pytest.raises(RuntimeError, match="meta"):
        bool(env.advance(actions).terminated.any())


@pytest.mark.gpu
@pytest.mark.filterwarnings("ignore:Synchronization debug mode is a prototype")
@pytest.mark.parametrize("world", sorted(GRAPHS))
def test_the_gpu_plays_what_the_cpu_plays(world: str) -> None:
    here, there = (batch(GRAPHS[world], "V0", 64, frames=2, device=device) for device in ("cpu", "cuda"))
    here.begin(1)
    there.begin(1)
    choices = torch.randint(here.tree.n, (40, 64), generator=torch.Generator().manual_seed(0))
    for actions in choices:
        on_device = actions.cuda()
        torch.cuda.synchronize()
        torch.cuda.set_sync_debug_mode("error")
        try:
            step, seen, mask = there.advance(on_device), there.observe(), there.mask()
        finally:
            torch.cuda.set_sync_debug_mode("default")
        for mine, theirs in zip(here.advance(actions), step, strict=True):
            torch.testing.assert_close(mine, theirs.cpu(), rtol=0, atol=0)
        for name, values in here.observe().items():
            assert torch.equal(values, seen[name].cpu())
        assert torch.equal(here.mask(), mask.cpu())


@pytest.mark.parametrize("world", sorted(GRAPHS))
def test_a_step_says_what_the_actions_led_to(world: str) -> None:
    graph = GRAPHS[world]
    env = batch(graph, "V0", 8, frames=1)
    env.begin(4)
    rng, classes = np.random.default_rng(0), len(graph.classes)
    for _ in range(40):
        views, row, labels = env._views.clone(), env._row.clone(), env.labels.clone()
        place = env.views_seen()[:, -1].clone()
        actions = torch.from_numpy(rng.integers(env.tree.n, size=8))
        step = env.advance(actions)
        for i, action in enumerate(actions.tolist()):
            assert int(step.answer[i]) == (action if action < classes else -1)
            assert int(step.views[i]) == int(views[i])
            assert int(step.row[i]) == int(row[i])
            assert int(labels[i]) == graph.episode(int(row[i])).label
            if action >= classes and int(views[i]) < 12 and not bool(step.truncated[i]):
                assert bool(step.moved[i]) == (graph.moves[int(place[i]), action - classes] >= 0)


def test_a_playlist_is_dealt_out_in_turn_and_its_last_row_repeats() -> None:
    rows = ROOM.starts("test")[[5, 3, 8, 1, 0, 2, 7]]
    env = batch(num_envs=3, playlist=rows)
    env.begin(0)
    played: list[list[int]] = [[], [], []]
    # Environment 0 answers at once, the others after a move or two: nobody waits for anybody.
    for t in range(12):
        answers = torch.tensor([True, t % 2 == 1, t % 3 == 2])
        step = env.advance(torch.where(answers, 0, 3))
        for i in answers.nonzero().flatten().tolist():
            played[i].append(int(step.row[i]))
    expected = rows.tolist()
    assert played[0] == [*expected[0::3], *[expected[-1]] * 9]
    assert played[1] == [*expected[1::3], *[expected[-1]] * 4]
    assert played[2] == [*expected[2::3], *[expected[-1]] * 2]
    assert env.drawn.tolist() == [13, 7, 5]
    env.begin(1)
    assert env._row.tolist() == expected[:3]


def test_a_playlist_shorter_than_the_batch() -> None:
    rows = ROOM.starts("train")[:2]
    env = batch(num_envs=4, playlist=rows)
    env.begin(0)
    assert env._row.tolist() == [int(rows[0]), *[int(rows[1])] * 3]


def test_state_goes_on_where_it_was_taken() -> None:
    env, other = batch(frames=2), batch(frames=2)
    env.begin(3)
    actions = torch.randint(env.tree.n, (30, 4), generator=torch.Generator().manual_seed(0))
    for now in actions[:10]:
        env.advance(now)
    state = {name: value.clone() for name, value in env.state().items()}
    other.load_state(state)
    for now in actions[10:]:
        for mine, theirs in zip(env.advance(now), other.advance(now), strict=True):
            assert torch.equal(mine, theirs)
        for name, value in env.observe().items():
            assert torch.equal(value, other.observe()[name])
        assert torch.equal(env.mask(), other.mask())
        assert torch.equal(env.labels, other.labels)


def test_no_frames_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^frames=0 stacks no view; set it to at least 1\.$"):
        batch(frames=0)


def test_errors_name_the_split() -> None:
    with pytest.raises(DataError, match="no split 'tset'"):
        batch(split="tset")
