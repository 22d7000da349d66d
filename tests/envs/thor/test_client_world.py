"""The world through AI2-THOR's own client and the scripted player: what is seen, and what breaks."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activelsd.compose import resolve
from activelsd.envs.thor.env import LiveTHOREnv
from activelsd.envs.thor.lattice import Lattice
from activelsd.envs.thor.room import WalkableRoom
from activelsd.envs.viewgraph import ViewGraph
from activelsd.envs.world import world_settings
from activelsd.launch import begin
from tests.envs.thor.clients import Belongings, controller, player

pytestmark = pytest.mark.thor

CLASSES = ("Apple", "Book", "Bowl", "Candle", "Television")
"""A book of the player's has pixels and is never `visible`, a candle the reverse."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


def words(cache: Path, *arguments: object) -> dict[str, Any]:
    """Keyword arguments of a small world behind a player with these arguments."""
    return {
        "executable": player("--noise", *arguments),
        "x_displays": (":0",),
        "rooms": ("kitchen",),
        "train": 1,
        "val": 1,
        "test": 1,
        "classes": CLASSES,
        "horizons": (0.0,),
        "navigate": ("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw"),
        "size": 32,
        "step": 0.25,
        "width": 64,
        "height": 64,
        "min_pixels": 0.0,
        "per_target": 5,
        "cache": str(cache),
    }


def test_two_simulators_record_what_one_does_and_leave_nothing(cache: Path, tmp_path: Path) -> None:
    log = tmp_path / "actions.jsonl"
    side_by_side = {"x_displays": (":0", ":1"), "simulators": 2, "cache": str(tmp_path / "two")}
    two, one = recorded(words(cache, "--log", log) | side_by_side), recorded(words(cache))
    assert two.scenes == one.scenes
    for name in ("frames", "moves", "boxes", "crops", "start_view"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
    for command in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # ended meanwhile
            assert str(log).encode() not in command.read_bytes()


def test_300_random_actions_stay_on_the_lattice_and_boxes_are_those_of_masks(
    cache: Path, tmp_path: Path
) -> None:
    log = tmp_path / "actions.jsonl"
    env = world_settings("thor", words(cache, "--log", log) | {"live": True}).env()
    assert isinstance(env, LiveTHOREnv)
    rng, took = np.random.default_rng(0), 0
    log.unlink()  # of the recording
    _, told = env.reset(seed=0)
    for _ in range(300):
        action = rng.choice(np.flatnonzero(told["action_mask"]))
        took += action < len(CLASSES)
        seen, _, terminated, truncated, told = env.step(action)
        assert env.graph.poses is not None
        x, z, rotation, _, horizon = env.graph.poses[env._view].tolist()
        agent = env._event.metadata["agent"]
        where = [agent["position"]["x"], agent["position"]["z"], agent["cameraHorizon"]]
        assert where == pytest.approx([x, z, horizon], abs=1e-2)
        turned = (agent["rotation"]["y"] - rotation + 180) % 360 - 180
        assert abs(turned) < 0.01
        assert rotation % 45 == 0
        mask = env._event.instance_masks.get(told["target"].partition("/")[2])
        cx, cy, width, height, present = seen["target"][-1].tolist()
        assert bool(present) == (mask is not None and bool(mask.any()))
        if present:
            rows, columns = np.nonzero(mask)
            extent = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            edges = np.array([cx - width / 2, cy - height / 2, cx + width / 2, cy + height / 2]) * 64
            assert edges == pytest.approx(extent, abs=1e-3)
        if terminated or truncated:
            _, told = env.reset()
    env.close()
    assert took > 30
    actions = {entry.get("action") for entry in map(json.loads, log.read_text().splitlines())}
    world = {"GetReachablePositions", "SetObjectFilter", "TeleportFull"}
    start = {"ChangeResolution", "ChangeQuality", "GetScenesInBuild", "Reset", "Initialize", None}
    assert world <= actions <= world | start


def recorded(world: dict[str, Any]) -> ViewGraph:
    return world_settings("thor", world).open()


def test_what_counts_is_the_mask_and_not_what_is_called_visible(cache: Path) -> None:
    graph = recorded(words(cache))
    asked = {graph.targets[target].partition("/")[2].partition("|")[0] for target in graph.start_target}
    assert "Book" in asked
    assert "Candle" not in asked


@pytest.mark.parametrize("channels", [3, 4])
def test_pictures_of_three_and_four_channels_give_the_same_recording(cache: Path, channels: int) -> None:
    one, other = recorded(words(cache)), recorded(words(cache, "--channels", channels))
    np.testing.assert_array_equal(one.frames, other.frames)
    np.testing.assert_array_equal(one.boxes, other.boxes)


def test_a_full_turn_of_45_degrees_comes_back_to_where_it_began() -> None:
    with controller("--noise", gridSize=0.25) as simulator:
        room = WalkableRoom(simulator, step=0.25, horizons=(0.0,), classes=CLASSES)
        lattice: Lattice = room.enter("FloorPlan1").lattice
        turn = lattice.moves()[:, 4]
        view, frames = 7, []
        for _ in range(9):
            event = room.stand(lattice.pose(view))
            assert event is not None
            frames.append(event.frame.copy())
            view = int(turn[view])
    np.testing.assert_array_equal(frames[0], frames[8])
    assert lattice.pose(7).rotation == 315
    assert lattice.pose(int(turn[7])).rotation == 0
    assert not np.array_equal(frames[0], frames[1])


@pytest.mark.slow
def test_training_goes_on_over_a_player_that_crashes_every_200_steps(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = words(cache)
    elsewhere = ("train", "val", "test", "rooms", "min_pixels", "per_target")
    settings = {key: value for key, value in world.items() if key not in elsewhere} | {"live": True}
    flat = [
        f"env.{key}={value if isinstance(value, str) else json.dumps(value)}"
        for key, value in settings.items()
    ]
    flat += ["env.scenes.rooms=[kitchen]", "env.scenes.train=1", "env.scenes.test=1"]
    flat += ["env.starts.min_pixels=0", "env.starts.per_target=5", f"runs={tmp_path / 'runs'}"]
    flat += ["train.actors=ga3c", "train.ga3c.agents=6", "train.ga3c.training_batch=4", "train.loggers=[]"]
    config = resolve(["env=thor", *flat, "train.steps=5000", "train.log_every=500", "threads=1"])
    config.env.open()  # nothing crashes while the scenes are recorded
    assert config.env.made_by() == "ai2thor"

    before = Belongings.now()
    # Of an action: answers need none, so it is about one in 200 steps.
    monkeypatch.setenv("PLAYER_CRASH_PROBABILITY", "0.01")
    run = begin(config)
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["step"] >= 5000
    # Those that are lost between two episodes cost nothing.
    assert sum(row.get("ga3c/episodes_cut", 0) + row.get("ga3c/agents_lost", 0) for row in rows) > 2
    # PyTorch keeps a folder of its own among the temporary ones.
    assert Belongings.now()[:2] == before[:2]
