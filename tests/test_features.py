"""Recorded features: what they are, when they are made again, and that everybody plays on them alike."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import OpenWorld, play_recordings
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import DataError
from activelsd.evaluate.players import Trained
from activelsd.evaluate.protocol import episodes_of, play
from activelsd.features import with_features
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.policy.trunks import ViewTrunk
from activelsd.registry import trunks
from activelsd.train.actors.resident import ResidentActors
from tests.graphs import ring_graph, room_graph


class Brightness(ViewTrunk):
    """Finds the mean and the left half's mean of a view; counts how many views it was shown."""

    shown = 0
    text = "brightness"

    def __init__(
        self, channels: int, size: int, *, frames: int = 1, frozen: bool = True, variants: int = 3
    ) -> None:
        super().__init__(frames, 2, 8, frozen=frozen)
        self.variants = variants

    def embed(self, pictures: Tensor) -> Tensor:
        Brightness.shown += len(pictures)
        light = pictures.float() / 255
        half = pictures.shape[-1] // 2
        return torch.stack([light.mean((1, 2, 3)), light[..., :half].mean((1, 2, 3))], 1)

    def digest(self) -> str:
        return self.text


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trunks, "_added", {"brightness": Brightness})


def found(graph: ViewGraph) -> list[np.ndarray]:  # type: ignore[type-arg]
    assert graph.features is not None
    return [np.asarray(one) for one in graph.features]


def test_features_are_those_of_the_pictures(tmp_path: Path) -> None:
    graph, trunk = ring_graph(), Brightness(1, 16)
    (plain,) = found(with_features(graph, trunk, cache=tmp_path))
    expected = trunk.embed(torch.from_numpy(graph.frames)[:, None]).half().numpy()
    np.testing.assert_array_equal(plain[:-1], expected)
    np.testing.assert_array_equal(plain[-1], 0)  # the black picture
    both = found(with_features(graph, trunk, cache=tmp_path, mirror=True))
    np.testing.assert_array_equal(both[0], plain)
    flipped = trunk.embed(torch.from_numpy(graph.frames[..., ::-1].copy())[:, None]).half().numpy()
    np.testing.assert_array_equal(both[1][:-1], flipped)


def test_crops_have_cuts_and_frames_have_none(tmp_path: Path) -> None:
    graph, trunk = room_graph(), Brightness(1, 16)
    assert graph.crops is not None
    varied = found(with_features(graph, trunk, cache=tmp_path, mirror=True, vary_crops=True))
    assert [one.shape for one in varied] == [(len(graph.crops) + 1, 2)] * 6
    assert len({one.tobytes() for one in varied}) == 6
    assert len(found(with_features(ring_graph(), trunk, cache=tmp_path, vary_crops=True))) == 1


def test_they_are_made_once_and_again_when_anything_changes(tmp_path: Path) -> None:
    graph, trunk = ring_graph(), Brightness(1, 16)
    with_features(graph, trunk, cache=tmp_path)
    before = Brightness.shown
    with_features(graph, Brightness(1, 16), cache=tmp_path)
    assert Brightness.shown == before
    changed = graph.frames.copy()
    changed[5, 3, 3] ^= 1
    with_features(replace(graph, frames=changed), trunk, cache=tmp_path)
    assert Brightness.shown > before
    before, trunk.text = Brightness.shown, "another"  # type: ignore[misc]
    with_features(graph, trunk, cache=tmp_path)
    assert Brightness.shown > before
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".npy"]


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    graph, trunk = ring_graph(), Brightness(1, 16)
    with_features(graph, trunk, cache=tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(DataError, match=rf"{path.name} cannot be read .* delete it, and it is made again"):
        with_features(graph, trunk, cache=tmp_path)


def test_a_trunk_that_learns_has_none(tmp_path: Path) -> None:
    graph = ring_graph()
    assert with_features(graph, Brightness(1, 16, frozen=False), cache=tmp_path) is graph
    assert not list(tmp_path.iterdir())


KILLED = """
import sys, time, torch
from pathlib import Path
from tests.graphs import ring_graph
from tests.test_features import Brightness
from activelsd import features
from activelsd.features import with_features
features._CHUNK["cpu"] = 8
class Slow(Brightness):
    def embed(self, pictures):
        time.sleep(0.05)
        return super().embed(pictures)
with_features(ring_graph(objects=48), Slow(1, 16), cache=Path(sys.argv[1]))
"""


def test_a_killed_process_leaves_what_the_next_goes_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = Path(__file__).parents[1]
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)], cwd=root, env={**os.environ, "PYTHONPATH": path}
    )
    deadline = time.monotonic() + 60
    while not any(path.stat().st_size > 1000 for path in tmp_path.glob("*.partial")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    graph = ring_graph(objects=48)
    monkeypatch.setitem(sys.modules["activelsd.features"].__dict__["_CHUNK"], "cpu", 8)
    before = Brightness.shown
    (features,) = found(with_features(graph, Brightness(1, 16), cache=tmp_path))
    assert 0 < Brightness.shown - before < len(graph.frames)
    expected = Brightness(1, 16).embed(torch.from_numpy(graph.frames)[:, None]).half().numpy()
    np.testing.assert_array_equal(features[:-1], expected)


def network(graph: ViewGraph, **shape: object) -> LSDNet:
    torch.manual_seed(0)
    made = NetworkShape(  # type: ignore[arg-type]
        trunk="brightness", size=16, crops=graph.crops is not None, **shape
    )
    return LSDNet(tree_of(graph), made)


@pytest.mark.parametrize("world", ["rings", "rooms"])
@pytest.mark.parametrize("frames", [1, 2])
def test_playing_on_features_is_playing_on_pictures(world: str, frames: int, tmp_path: Path) -> None:
    """The same actions and answers in every episode, and, for one world, in single environments too."""
    graph = ring_graph() if world == "rings" else room_graph(size=32)
    net, rules = network(graph, frames=frames), EpisodeRules()
    if world == "rooms":
        net = LSDNet(tree_of(graph), replace(net.shape, size=32))
    recorded = with_features(graph, net.trunk, cache=tmp_path)
    episodes = episodes_of(graph, "test")
    rows = [
        play(Trained(net), one, rules, episodes, world=world, backend="made up") for one in (graph, recorded)
    ]
    assert rows[0] == rows[1]
    single = ViewGraphEnv(recorded, rules, frames=frames)
    batch = ViewGraphVectorEnv(recorded, rules, num_envs=1, frames=frames, variants=True, pictures=())
    observation, _ = single.reset(seed=3)
    batch.begin(3)
    np.testing.assert_array_equal(observation["features"], batch.observe()["features"][0])
    assert single.observation_space.contains(observation)
    assert set(batch.observe()) == {"target", "features"}


def test_mirrored_episodes_see_mirrored_features(tmp_path: Path) -> None:
    """What the network is shown in a mirrored episode is what its trunk finds in the mirrored picture."""
    graph = ring_graph()
    net = network(graph)
    recorded = with_features(graph, net.trunk, cache=tmp_path, mirror=True)
    world = OpenWorld("rings", recorded, EpisodeRules())
    envs = play_recordings([world], num_envs=32, frames=1, pictures=())
    pictures = play_recordings([world._replace(graph=graph)], num_envs=32, frames=1)
    on_features = ResidentActors(envs, net, 4, 0, mirror=True).collect(Epsilon(0.5, 0.5))
    on_pictures = ResidentActors(pictures, net, 4, 0, mirror=True).collect(Epsilon(0.5, 0.5))
    assert torch.equal(on_features.actions, on_pictures.actions)
    shown = net.trunk.embed(on_pictures.observation["frames"].flatten(0, 2)[:, None]).half()
    assert torch.equal(on_features.observation["features"].flatten(0, 2), shown)
    assert "frames" not in on_features.observation
