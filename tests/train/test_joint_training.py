"""One network trained on two worlds: it learns both, each is counted by itself, and it resumes to the bit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld, union
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import RunError
from activelsd.evaluate.compare import measure
from activelsd.policy.checkpoint import load_network
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import NetworkShape
from activelsd.policy.transfer import narrow
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import TrainSettings
from activelsd.train.statistics import Statistics, counts
from activelsd.train.trainer import Trainer
from tests.graphs import ring_graph, room_graph

METRICS = (
    *("episodes", "reward", "accuracy", "views", "navigate", "accuracy_at_first_view"),
    "policy_entropy_loss",
)
RINGS = replace(ring_graph(objects=12, classes=3, telling=(3, 4, 5)), classes=("bed", "cup", "vase"))
ROOMS = room_graph(size=16)


def trainer(
    run: Run, *graphs: ViewGraph, resume: bool = False, features: int = 32, **changed: Any
) -> Trainer:
    settings = {"steps": 960, "envs": 9, "length": 4, "log_every": 72, "checkpoint_every": 480, "loggers": []}
    worlds = [
        OpenWorld(name, graph, PRESETS["V4"]) for name, graph in zip(("rings", "rooms"), graphs, strict=False)
    ]
    shape = NetworkShape(
        size=16, trunk_settings={"features": features}, crops=any(graph.crops is not None for graph in graphs)
    )
    chosen = TrainSettings(**(settings | changed))  # type: ignore[arg-type]
    tree = union([tree_of(graph) for graph in graphs])
    actors = on_recordings(worlds, chosen, frames=1)
    return Trainer(run, tree, shape, chosen, actors, seed=5, resume=resume)


def test_resume_goes_on_to_the_bit(tmp_path: Path) -> None:
    whole, halved = (Run.create(tmp_path, name, "") for name in ("whole", "halved"))
    trainer(whole, RINGS, ROOMS).train()
    first = trainer(halved, RINGS, ROOMS)
    while first.step < 480:
        first._update(_Forgets())  # type: ignore[arg-type]
    first.save()
    trainer(halved, RINGS, ROOMS, resume=True).train()
    one, other = (load_network(run.checkpoint).state_dict() for run in (whole, halved))
    assert all(torch.equal(one[name], other[name]) for name in one)
    with pytest.raises(RunError, match="other classes or moves"):
        trainer(halved, RINGS, resume=True)


class _Forgets:
    """Statistics that keep nothing."""

    def add(self, *_: object) -> None:
        """Take a rollout and drop it."""


def test_each_world_is_counted_by_itself(tmp_path: Path) -> None:
    playing = trainer(Run.create(tmp_path, "both", ""), RINGS, ROOMS)
    places = playing.actors.places
    together, alone = Statistics(places), {name: Statistics() for name in places}
    for _ in range(6):
        rollout = playing.actors.collect(Epsilon(0.5, 0.5))
        together.add(counts(rollout, playing.network, {}, places))
        for name, place in places.items():
            alone[name].add(counts(rollout.columns(place), playing.network, {}, {}))
    metrics = together.read()
    for name, statistics in alone.items():
        for metric, value in statistics.read().items():
            assert metrics[f"{name}/{metric}"] == pytest.approx(value), metric
    assert metrics["rings/views"] != pytest.approx(metrics["rooms/views"])
    assert set(metrics) == {f"{world}{name}" for world in ("", "rings/", "rooms/") for name in METRICS}


def test_it_learns_two_worlds_at_once(tmp_path: Path) -> None:
    """Rings, where answering well means walking first, and rooms, whose targets are told by their crops."""
    run = Run.create(tmp_path, "both", "")
    settings = {"steps": 80_000, "envs": 32, "length": 5, "learning_rate": 2e-3, "log_every": 5_000}
    settings["vary_crops"] = False  # random pixels that were cut otherwise would be others
    trainer(run, RINGS, ROOMS, features=64, checkpoint_every=80_000, **settings).train()
    last = json.loads((run.folder / "metrics.jsonl").read_text().splitlines()[-1])
    # A quarter of the views tell three classes apart: who does not move gets 0.5. Other seeds give 0.86 up.
    assert last["rings/accuracy"] > 0.75
    assert last["rings/views"] > 2.0
    assert last["rooms/accuracy"] > 0.85
    # Narrowed to one world it plays there by the protocol, with and without crops in its views.
    network = load_network(run.checkpoint)
    for graph in (RINGS, ROOMS):
        own = narrow(network, tree_of(graph))
        found = measure(own, graph, PRESETS["V4"], split="train", world="toy", backend="toy")
        assert found["accuracy"] > 0.85
