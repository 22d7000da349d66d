"""The conformance suites of a world and of a recogniser, this package's own or another's.

    from activelsd.testing import check_recogniser, check_world

    def test_my_world(tmp_path):
        check_world(MySettings(path="a few pictures", cache=tmp_path / "cache"))

    def test_my_recogniser(tmp_path):
        check_recogniser("mine", MySettings(path="a few pictures", cache=tmp_path / "cache"))

They must be registered, and the world small enough to be trained in for seconds.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.utils.env_checker import check_env

from activelsd import registry
from activelsd.build import open_recordings
from activelsd.compose import load, resolve
from activelsd.console import progress
from activelsd.contest import contest
from activelsd.envs.base import ActiveVisionEnv
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.settings import WorldSettings
from activelsd.envs.soundness import check_graph
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.envs.world import world_settings
from activelsd.evaluate.recognisers.interface import Recogniser
from activelsd.evaluate.recognisers.kept import trained
from activelsd.evaluate.recognisers.objects import Objects, draw_sets
from activelsd.evaluate.recognisers.rows import make_recogniser, recognise
from activelsd.launch import begin
from activelsd.policy.lsdnet import NetworkShape
from activelsd.sections import dump
from activelsd.train.actors.ray.worker import fingerprint

_STEPS = 50


def check_world(settings: WorldSettings, *, train_steps: int = 2000) -> None:
    """Check that a world does what every world must.

    Its settings survive their file, what it shows is sound, in gray and in colour one environment plays as
    the batch does action for action, Gymnasium's own checker is content, agents in other processes build the
    same world from its settings, and a run trains in it and is compared.

    Args:
        settings: of a registered world.
        train_steps: how long to train; 0 leaves training and comparing out.

    Raises:
        AssertionError: with what is wrong.
        ActiveLSDError: the world cannot be opened or played, or its graph is not sound.
    """
    with tempfile.TemporaryDirectory() as folder:
        words = _check_settings(settings, Path(folder))
        graph = settings.open()
        check_graph(graph)
        _check_names(graph)
        _check_moves(settings, graph)
        _check_rebuilt(settings)
        for colour, channels in (("gray", 1), ("rgb", 3)):
            _check_played(settings.model_copy(update={"colour": colour}), channels)
        if train_steps:
            _check_run([*words, f"train.steps={train_steps}", f"runs={folder}", "threads=1"])


def _check_settings(settings: WorldSettings, folder: Path) -> list[str]:
    """The settings survive their file; the words that name it."""
    name = registry.worlds.name_of(type(settings))
    assert name == settings.name, (
        f"{type(settings).__name__} is not registered, or another world has its name; see docs/extending.md"
    )
    assert settings.about, "the class attribute `about` says nothing"
    file = folder / "world.yaml"
    file.write_text(dump(settings), "utf-8")
    words = [f"env={file}"]
    config = resolve(words)
    assert config.env == settings, f"the settings came back otherwise from their file: {config.env}"
    whole = folder / "config.yaml"
    whole.write_text(dump(config), "utf-8")
    assert load(whole) == config, "a run's config came back otherwise from its file"
    described = [name for name, field in type(settings).model_fields.items() if not field.description]
    assert not described, f"the settings {described} have no description"
    default = type(settings).model_fields["navigate"].default
    assert set(default) <= set(settings.moves()), "a default move is not among `moves()`"
    return words


def _check_names(graph: ViewGraph) -> None:
    """Views are told apart within their scene, and starts by their episode's id."""
    views = set(zip(graph.scene_of.tolist(), graph.view_names, strict=True))
    assert len(views) == len(graph.view_names), "two views of a scene have one name"
    ids = {graph.episode(row).id for row in range(len(graph.start_view))}
    assert len(ids) == len(graph.start_view), "two starts have one episode id"
    for split in ("train", "test"):
        graph.starts(split)


def _check_moves(settings: WorldSettings, graph: ViewGraph) -> None:
    assert graph.branches == settings.move_branches, (
        f"the graph has the moves {graph.branches}, and {settings.move_branches} are asked for"
    )


def _check_rebuilt(settings: WorldSettings) -> None:
    """What GA3C's agents and Ray's workers make of the settings is the same world."""
    plain = json.loads(json.dumps(settings.model_dump(mode="json")))
    again = world_settings(plain.pop("name"), plain)
    assert again == settings, "the settings came back otherwise from JSON"
    ours, theirs = (fingerprint(open_recordings({"world": one})) for one in (settings, again))
    assert ours == theirs, "opened twice, the world is not the same"
    env = gymnasium.make("activelsd/World-v0", world=settings.name, **plain)
    tree = env.get_wrapper_attr("tree")
    env.close()
    assert tree == tree_of(settings.open()), "Gymnasium's environment has other actions than the graph"


def _check_played(settings: WorldSettings, channels: int) -> None:
    graph, env = settings.open(), settings.env()
    assert graph.channels == channels, f"with colour={settings.colour} there are {graph.channels} channels"
    try:
        check_env(env, skip_render_check=True)
        _check_batch(env, graph, settings)
    finally:
        env.close()


def _check_batch(env: ActiveVisionEnv, graph: ViewGraph, settings: WorldSettings) -> None:
    """A single environment and the batch see and get the same, action for action."""
    if type(env) is not ViewGraphEnv:  # a live world shows what its simulator does
        return
    rules, backend = settings.rules.rules(), settings.made_by()
    batch = ViewGraphVectorEnv(graph, rules, num_envs=1, frames=1, backend=backend)
    seen, info = env.reset(seed=7)
    many, infos = batch.reset(seed=7)
    rng = np.random.default_rng(0)
    for _ in range(_STEPS):
        _same(seen, {name: value[0] for name, value in many.items()})
        assert info["episode_id"] == infos["episode_id"][0], "the episodes differ"
        mask = info["action_mask"]
        assert np.array_equal(mask, infos["action_mask"][0]), "the legal actions differ"
        action = rng.choice(np.flatnonzero(mask))
        seen, reward, terminated, truncated, info = env.step(action)
        many, rewards, ends, cuts, infos = batch.step(np.array([action]))
        assert np.isclose(reward, rewards[0]), f"the rewards differ: {reward} and {rewards[0]}"
        assert (terminated, truncated) == (ends[0], cuts[0]), "the ends of the episode differ"
        if terminated or truncated:
            seen, info = env.reset()


def _same(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert one.keys() == other.keys(), f"what is seen differs: {sorted(one)} and {sorted(other)}"
    for name, value in one.items():
        assert np.array_equal(value, other[name]), f"`{name}` differs between one environment and the batch"


def _check_run(words: list[str]) -> None:
    """A short run trains, and is compared in every figure."""
    run = begin(resolve(words))
    comparisons, files = contest([str(run)], ["no_move", "random_walk"], [])
    assert all(file.exists() for file in files), "a file of the comparison is missing"
    names = [player.name for player in comparisons[0].players]
    assert names[1:] == ["no_move", "random_walk"], f"the players were {names}"


def check_recogniser(name: str, settings: WorldSettings) -> None:
    """Check that a recogniser does what every recogniser must.

    It gives probabilities of classes for sets of any size, whatever the order of their views; the same seed
    trains the same weights; what was kept of a training names as before; and it is measured.

    Args:
        name: of a registered recogniser.
        settings: of a small world whose objects it can name.

    Raises:
        AssertionError: with what is wrong.
        ActiveLSDError: the recogniser does not fit the world, or fails.
    """
    graph = settings.open()
    shape = NetworkShape(size=graph.size, channels=graph.channels)
    objects = Objects(graph=graph, world=settings, shape=shape)

    def make() -> Recogniser:
        return make_recogniser(name, objects, 0, epochs=1, progress=progress)

    first, again, fresh = make(), make(), make()
    assert first.given, "the class attribute `given` says nothing"
    _check_sets(first)
    with tempfile.TemporaryDirectory() as folder:
        training = trained(name, first, Path(folder), seed=0)
        assert trained(name, fresh, Path(folder), seed=0) == training, "what was kept was trained again"
        with torch.random.fork_rng():
            again.fit(seed=0)
        for one, weights in first.state_dict().items():
            assert torch.equal(weights, fresh.state_dict()[one]), f"'{one}' came back otherwise from its file"
        _check_sets(first)
        rows, _ = recognise(
            [name], objects, split="test", seed=0, cache=Path(folder), epochs=1, progress=progress
        )
    assert [row.views for row in rows] == list(first.counts), "a number of views has no row"
    assert all(0 <= row.accuracy.mean <= 1 for row in rows), "an accuracy is none"


def _check_sets(recogniser: Recogniser) -> None:
    """Sets of every size have probabilities of all classes, and the order of their views changes nothing."""
    objects, generator = recogniser.objects, torch.Generator().manual_seed(0)
    targets = objects.of("test")
    every = objects.views[targets]
    for count in (*range(1, every.shape[1] + 1), 0) if recogniser.whole else range(1, every.shape[1] + 1):
        views = draw_sets(every, generator, count)
        found = recogniser.probabilities(targets, views)
        classes = (len(targets), len(objects.graph.classes))
        assert found.shape == classes, f"probabilities are {tuple(found.shape)} and must be {classes}"
        assert torch.allclose(found.sum(1), torch.ones(len(targets)), atol=1e-4), "they do not add up to 1"
        turned = recogniser.probabilities(targets, views.flip(1))
        assert torch.allclose(found, turned, atol=1e-5), "another order of views gives other probabilities"
