"""Moves in several branches: training on a tree of three branches, by resident actors and threads."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.policy.checkpoint import load_network
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import NetworkShape
from activelsd.policy.transfer import transfer
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.interface import MakeActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import GA3CSettings, TrainSettings
from activelsd.train.statistics import Statistics, counts
from activelsd.train.trainer import Trainer, new_network
from tests.graphs import ring_graph, room_graph

BRANCHES = {"navigate": ["orbit_cw", "orbit_ccw"], "tilt": ["orbit_up", "orbit_down"]}
MOVES = [move for moves in BRANCHES.values() for move in moves]
# Only from above does a view tell the class: it takes a move of the second branch to see one.
BELOW, ABOVE = (
    ring_graph(objects=12, classes=3, elevations=2, moves=MOVES, telling=telling) for telling in ((), None)
)
RULES = PRESETS["V5"]
SHAPE = NetworkShape(size=BELOW.size, trunk_settings={"features": 64})


FRAMES = np.where(np.arange(24 * 12)[:, None, None] % 24 < 12, BELOW.frames, ABOVE.frames)
GRAPH = replace(BELOW, frames=FRAMES).with_moves(BRANCHES)


def settings_of(**changed: Any) -> TrainSettings:
    chosen = {"steps": 30_000, "envs": 32, "learning_rate": 2e-3, "log_every": 5_000, "loggers": []}
    return TrainSettings(**(chosen | {"mirror": True} | changed))  # type: ignore[arg-type]


def train(folder: Path, make: MakeActors, settings: TrainSettings) -> dict[str, float]:
    """The last row of metrics."""
    run = Run.create(folder, "branches", "")
    Trainer(run, tree_of(GRAPH), SHAPE, settings, make, seed=0).train()
    row: dict[str, float] = json.loads((run.folder / "metrics.jsonl").read_text().splitlines()[-1])
    return row


@pytest.mark.parametrize("kind", ["resident", "threads"])
def test_it_learns_moves_of_the_second_branch(kind: str, tmp_path: Path) -> None:
    threads = kind == "threads"  # whose agents lag behind the learner, on a busy machine more
    settings = settings_of(vtrace=threads, steps=45_000 if threads else 30_000)
    make = on_recordings([OpenWorld("rings", GRAPH, RULES)], settings, frames=1)
    if threads:
        chosen = GA3CSettings(kind="threads", agents=2, envs_per_agent=16)

        def make(network: Any, seed: int) -> GA3CActors:
            env = lambda: ViewGraphEnv(GRAPH, RULES, frames=1)  # noqa: E731
            return GA3CActors(env, network, chosen, settings.length, seed, mirror=True)

    last = train(tmp_path, make, settings)
    assert last["accuracy"] > 0.7  # from the ring where episodes begin, no more than 1/3
    assert last["views"] > 1.5
    assert last["accuracy_at_first_view"] < 0.5
    network = load_network(Run.newest(tmp_path).checkpoint)
    assert network.tree.branches == ("classify", "navigate", "tilt")


def test_navigate_is_the_probability_of_any_move() -> None:
    settings = settings_of(terms={"supervised": 1.0, "guided": 1.0}, mirror=False)
    rooms = room_graph(size=16).with_moves({"walk": ["forward", "back"], "turn": ["left", "right"]})
    network = new_network(tree_of(rooms), replace(SHAPE, crops=True), 1)
    actors = on_recordings([OpenWorld("rooms", rooms, RULES)], settings, frames=1)(network, 5)
    rollout = actors.collect(Epsilon(0.5, 0.5))
    assert rollout.output is not None
    policy = network.distribution(rollout.output.logits, rollout.mask)
    statistics = Statistics()
    statistics.add(counts(rollout, network, {}, {}))
    moving, free = (
        policy.probs.detach()[..., network.tree.moves].sum(-1),
        rollout.mask[..., network.tree.moves].any(-1),
    )
    assert statistics.read()["navigate"] == pytest.approx(float(moving.sum() / free.sum()), rel=1e-5)
    torch.testing.assert_close(policy.probs.sum(-1), torch.ones(rollout.first.shape))
    assert rollout.nearer is not None
    assert rollout.nearer[..., network.tree.span("turn")].any()


def test_rows_of_branches_both_know_are_kept_by_name() -> None:
    flat = new_network(tree_of(BELOW), SHAPE, 1)
    state, rows = transfer(flat, new_network(tree_of(GRAPH), SHAPE, 2))
    assert {"navigate", "navigate/orbit_cw", "navigate/orbit_ccw"} < {*rows.kept}
    assert rows.fresh == ("tilt", "tilt/orbit_up", "tilt/orbit_down")
    assert rows.dropped == ("navigate/orbit_up", "navigate/orbit_down")
    at = 3 + tree_of(GRAPH).index("navigate", "orbit_ccw")
    old = 2 + flat.tree.index("navigate", "orbit_ccw")
    assert torch.equal(state["policy.weight"][at], flat.policy.weight[old])
