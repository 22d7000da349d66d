"""Pictures in colour: what agents see of them, and that gray is made in one way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from pydantic import Field

from activelsd import registry
from activelsd.compose import load, resolve
from activelsd.envs.actions import ActionTree
from activelsd.envs.avd.prepare import prepare
from activelsd.envs.colour import in_colour
from activelsd.envs.crops import cut_out, squashed
from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import JointVectorEnv
from activelsd.envs.modelnet.settings import ModelNetSettings
from activelsd.envs.soundness import check_graph
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph, load_graph, save_graph
from activelsd.errors import ConfigError, DataError, RunError
from activelsd.evaluate.filmstrips import filmstrip
from activelsd.evaluate.walkers import Blocked
from activelsd.policy.lsdnet import NetworkShape
from activelsd.policy.transfer import transfer
from activelsd.sections import Colour, dump
from activelsd.train.augment import VARIATION_SIZE, Variation
from activelsd.train.trainer import new_network
from tests.envs.avd.homes import write_homes
from tests.evaluate.worlds import row
from tests.graphs import coloured, ring_graph, room_graph

ROOM = coloured(room_graph())


@pytest.fixture(scope="module")
def homes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_homes(tmp_path_factory.mktemp("homes"), homes=2)
    for file in root.glob("*/jpg_rgb/*.jpg"):
        gray = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        tint = np.array([0.4, 0.7, 1.0])
        cv2.imwrite(str(file), np.rint(np.asarray(gray)[..., None] * tint).astype(np.uint8))
    return root


def open_homes(root: Path, colour: str) -> ViewGraph:
    folders = sorted(path for path in root.iterdir() if path.is_dir())
    return load_graph(prepare(folders, size=16, colour=colour, cache=root.parent / "cache"))  # type: ignore[arg-type]


def test_photographs_in_colour_are_those_in_gray(homes: Path) -> None:
    colour, gray = open_homes(homes, "rgb"), open_homes(homes, "gray")
    assert (colour.channels, gray.channels, colour.size) == (3, 1, 16)
    assert colour.crops is not None
    assert gray.crops is not None
    first = next(path for path in sorted(homes.glob("Home_001_1/jpg_rgb/*.jpg")))
    photograph = cv2.imread(str(first))
    assert photograph is not None
    rgb = np.ascontiguousarray(photograph[..., ::-1])
    assert np.array_equal(colour.frames[0], squashed(rgb, 16))
    for ours, theirs in ((colour.frames, gray.frames), (colour.crops, gray.crops)):
        assert ours.shape == (len(theirs), 3, 16, 16)
        assert np.ptp(np.asarray(ours).astype(int), axis=1).max() > 20, "it has colours"
        weights = np.array([0.299, 0.587, 0.114])[:, None, None]
        # Small photographs are scaled up for crops, and a JPEG's own gray is rounded before it is scaled.
        assert np.abs((np.asarray(ours) * weights).sum(1) - theirs).mean() < 2


def test_a_crop_in_colour_is_its_channels_cut_alike() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
    for box in (np.array([2, 3, 9, 20], np.int32), np.array([-5, 10, 38, 29], np.int32)):
        crop = cut_out(picture, box, 16)
        for c in range(3):
            assert np.array_equal(crop[c], cut_out(np.ascontiguousarray(picture[..., c]), box, 16))


def test_gray_of_red_green_and_blue() -> None:
    picture = np.zeros((1, 3, 3), np.uint8)
    picture[0, range(3), range(3)] = 255
    assert in_colour(picture, "gray").tolist() == [[76, 150, 29]]
    assert in_colour(in_colour(picture, "gray"), "rgb")[0, 1].tolist() == [150] * 3
    assert in_colour(picture, "rgb") is picture


def test_a_gray_world_in_colour_repeats_its_channel_and_takes_no_memory() -> None:
    gray = room_graph()
    colour = gray.in_colour("rgb")
    assert np.shares_memory(colour.frames, gray.frames)
    check_graph(colour)
    assert colour.crops is not None
    assert (colour.frames == gray.frames[:, None]).all()
    assert (colour.crops == gray.crops[:, None]).all()  # type: ignore[index]
    assert np.array_equal(colour.in_colour("gray").frames, gray.frames), "its gray is what it was"
    assert gray.in_colour("gray") is gray
    env, same = (ViewGraphVectorEnv(one, PRESETS["V4"], num_envs=3, frames=2) for one in (colour, gray))
    env.begin(0)
    same.begin(0)
    for name in ("frames", "crops"):
        assert torch.equal(env.observe()[name], same.observe()[name].repeat_interleave(3, 1))


@pytest.mark.filterwarnings("ignore:.*not having a spec")
@pytest.mark.parametrize("graph", [ROOM, coloured(ring_graph(objects=6, classes=2))], ids=["room", "ring"])
def test_stacked_views_are_blocks_of_channels_newest_last(graph: ViewGraph) -> None:
    check_graph(graph)
    env = ViewGraphEnv(graph, PRESETS["V4"], frames=2, render_mode="rgb_array")
    check_env(env)
    many = ViewGraphVectorEnv(graph, PRESETS["V4"], num_envs=1, frames=2)
    seen, info = env.reset(seed=3)
    batch, _ = many.reset(seed=3)
    path = [int(graph.start_view[graph.find(info["episode_id"])])] * 2
    for move in (0, 1, 0):
        assert seen["frames"].shape == (6, graph.size, graph.size)
        assert np.array_equal(seen["frames"], np.concatenate([graph.frames[view] for view in path]))
        assert env.observation_space.contains(seen)
        for name, value in seen.items():
            assert np.array_equal(value, batch[name][0])
        picture = env.render()
        assert picture is not None
        assert np.array_equal(picture.transpose(2, 0, 1), graph.frames[path[-1]])
        to = int(graph.moves[path[-1], move])
        path = [path[-1], path[-1] if to < 0 else to]
        action = len(graph.classes) + move
        seen, *_ = env.step(action)
        batch, *_ = many.step(np.array([action]))


def test_a_file_keeps_colours(tmp_path: Path) -> None:
    save_graph(ROOM, tmp_path / "room.h5", {})
    again = load_graph(tmp_path / "room.h5")
    assert again.channels == 3
    assert np.array_equal(again.frames, ROOM.frames)


def test_channels_that_come_last_are_one_sentence() -> None:
    last = replace(ROOM, frames=np.ascontiguousarray(ROOM.frames.transpose(0, 2, 3, 1)))
    with pytest.raises(
        DataError, match=r"`frames` is uint8 \(27, 12, 12, 3\) and must be uint8 \(27, 3, 12, 12\)"
    ):
        check_graph(last)
    with pytest.raises(DataError, match=r"`crops` is uint8 \(\d+, 12, 12\) and must be uint8 \(\d+, 3, 12"):
        check_graph(replace(ROOM, crops=room_graph().crops))


@pytest.mark.parametrize(("name", "widths"), [("directions", (2,)), ("poses", (3, 5))])
def test_where_cameras_stand_is_checked_too(name: str, widths: tuple[int, ...]) -> None:
    room = room_graph()
    for width in range(1, 7):
        graph = replace(room, **{name: np.zeros((len(room.frames), width), np.float32)})
        if width in widths:
            check_graph(graph)
        else:
            with pytest.raises(DataError, match=rf"^`{name}` is float32 \(\d+, {width}\) and must be"):
                check_graph(graph)


def test_gray_and_colour_do_not_play_together() -> None:
    parts = {
        name: ViewGraphVectorEnv(graph, PRESETS["V4"], num_envs=1, frames=1)
        for name, graph in (("room", ROOM), ("ring", ring_graph(size=12)))
    }
    with pytest.raises(
        ConfigError, match=r"pictures of one colour, not room rgb, ring gray; set env\.colour"
    ):
        JointVectorEnv(parts)
    with pytest.raises(
        ConfigError, match=r"one colour, not env\.modelnet\.colour=gray and env\.avd\.colour=rgb"
    ):
        resolve(["env=modelnet,avd", "env.avd.colour=rgb"])
    parts["ring"] = ViewGraphVectorEnv(
        ring_graph(size=12).in_colour("rgb"), PRESETS["V4"], num_envs=1, frames=1
    )
    env = JointVectorEnv(parts)
    env.begin(0)
    assert env.observe()["crops"].shape == (2, 3, 12, 12)
    both = resolve(["env=modelnet,avd", "env.colour=rgb"])
    assert [world.colour for world in both.worlds.values()] == ["rgb", "rgb"]


@pytest.mark.parametrize("crops", [False, True])
@pytest.mark.parametrize("trunk", ["compact", "alexnet"])
def test_a_network_sees_every_channel_of_every_view(trunk: str, crops: bool) -> None:
    graph = coloured(room_graph(size=64))
    env = ViewGraphVectorEnv(graph, PRESETS["V4"], num_envs=2, frames=2)
    env.begin(0)
    shape = NetworkShape(trunk=trunk, size=64, frames=2, channels=3, crops=crops)
    network = new_network(tree_of(graph), shape, 0)
    network.check_parts()
    if network.surroundings is not None:
        torch.nn.init.normal_(network.surroundings.outputs.weight)
    observation = {name: value[None] for name, value in env.observe().items()}

    @torch.no_grad()
    def logits(seen: dict[str, torch.Tensor]) -> torch.Tensor:
        return network(seen, network.initial_state(2), torch.ones(1, 2).bool()).logits

    before = logits(observation)
    for name in ("crops", "frames") if crops else ("frames",):
        for channel in range(6):
            picture = observation[name].clone()
            picture[:, :, channel] = 255 - picture[:, :, channel]
            assert not torch.equal(logits(observation | {name: picture}), before), (name, channel)


def test_a_network_of_gray_pictures_cannot_start_one_of_colour() -> None:
    tree, small = tree_of(ROOM), NetworkShape(size=16, trunk_settings={"features": 8})
    gray, colour = (new_network(tree, replace(small, channels=c), 0) for c in (1, 3))
    with pytest.raises(
        RunError, match=r"env\.colour=gray cannot start one with env\.colour=rgb; set env\.col"
    ):
        transfer(gray, colour)


def test_light_changes_all_channels_alike_and_the_mirror_flips_them() -> None:
    env = ViewGraphVectorEnv(ROOM, PRESETS["V4"], num_envs=6, frames=2)
    env.begin(0)
    tree, seen = env.tree, env.observe()
    drawn = torch.rand(6, VARIATION_SIZE, generator=torch.Generator().manual_seed(3))
    plain = Variation([tree], tree, torch.device("cpu"), crops=True, mirror=False)
    # A gray picture in three channels stays gray.
    gray = {k: v if k == "target" else v[:, ::3].repeat_interleave(3, 1) for k, v in seen.items()}
    crops = plain.look(gray, drawn)["crops"]
    assert torch.equal(
        crops, plain.look(gray | {"crops": gray["crops"][:, ::3]}, drawn)["crops"].repeat_interleave(3, 1)
    )
    assert not torch.equal(crops, gray["crops"])
    # The middle of three even channels is lit as far from the others as it was, times the contrast.
    flat = torch.tensor([100, 120, 140], dtype=torch.uint8)[:, None, None].expand(6, 2, 3, 12, 12)
    dim = torch.full((6, VARIATION_SIZE), 0.5)
    dim[:, 6] = 0.4
    lit = (
        plain.look(seen | {"crops": flat.flatten(1, 2)}, dim)["crops"].view(6, 2, 3, 12, 12)[..., 0, 0].int()
    )
    there = (seen["target"][..., 4] > 0) & (seen["target"][..., 2:4] < 1).any(-1)
    assert there.any()
    assert (lit[there] - torch.tensor([100, 120, 140]) == round(-0.2 * 0.25 * 255)).all()
    swapping = ActionTree.answer_or_move(("cup",), ("left", "right"))
    mirror = Variation([swapping], swapping, torch.device("cpu"), crops=False, mirror=True)
    flipped = mirror.look(seen, torch.zeros(6, VARIATION_SIZE))
    assert torch.equal(flipped["frames"], seen["frames"].flip(-1))
    assert torch.equal(flipped["crops"], seen["crops"].flip(-1))


def test_a_walker_notices_a_change_of_any_channel() -> None:
    blocked, first = Blocked(), torch.tensor([False, False])
    target = torch.ones(2, 2, 5)
    before = torch.zeros(2, 6, 4, 4, dtype=torch.uint8)
    after = before.clone()
    after[1, 3] = 9  # red of the newest view
    blocked.look({"frames": before, "target": target}, first)
    assert blocked.look({"frames": after, "target": target}, first).tolist() == [True, False]


def test_filmstrips_have_channels_last() -> None:
    one = row(scene="room_0", target="thing_0", path=("view_0", "view_1"))
    strip = filmstrip(ROOM, one)
    assert np.array_equal(strip.frames[1].transpose(2, 0, 1), ROOM.frames[1])
    assert {crop.shape for crop in strip.crops} == {(12, 12, 3)}


class Bright(ModelNetSettings):
    """A world in colour unless gray is asked for."""

    colour: Colour = Field("rgb", description="channels")


@pytest.mark.parametrize("worlds", ["bright", "bright,avd"])
def test_a_run_older_than_colour_stays_gray(
    worlds: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(registry.worlds._added, "bright", Bright)
    config = resolve([f"env={worlds}", "env.colour=rgb"])
    file = tmp_path / "config.yaml"
    file.write_text(dump(config))
    assert load(file) == config
    file.write_text("".join(line for line in dump(config).splitlines(True) if "colour:" not in line))
    assert {world.colour for world in load(file).worlds.values()} == {"gray"}
    assert Bright().colour == "rgb"
