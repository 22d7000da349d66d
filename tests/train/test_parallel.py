"""Learning in several processes: two do what one does with twice the episodes, and stop and resume as one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.policy.checkpoint import load_network
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.resident import ResidentActors
from activelsd.train.learner import Learner
from activelsd.train.parallel import Group
from activelsd.train.rollout import Rollout
from activelsd.train.run import Run
from activelsd.train.settings import TrainSettings
from activelsd.train.trainer import new_network
from tests.graphs import ring_graph

UPDATES = (0.0, 0.3, 0.6)
TOP = Path(__file__).parents[2]
WORDS = (
    "env=modelnet", "env.dataset.classes=[cup,vase]", "env.dataset.train_per_class=4", "env.size=32",
    "env.dataset.test_per_class=1", "train.envs=4", "policy.trunk.features=16", "train.loggers=[]",
    "threads=1", "train.checkpoint_every=400",
)  # fmt: skip


def some_rollout() -> tuple[LSDNet, Rollout]:
    """The same in every process."""
    graph = ring_graph()
    network = new_network(tree_of(graph), NetworkShape(size=graph.size, trunk_settings={"features": 32}), 1)
    env = ViewGraphVectorEnv(graph, PRESETS["V4"], num_envs=6, frames=1)
    actors = ResidentActors(env, network, 5, seed=2)
    actors.collect(Epsilon(0.5, 0.5))
    return network, replace(actors.collect(Epsilon(0.5, 0.5)), output=None)


def torchrun(*words: str, processes: int = 2) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(TOP)}
    return subprocess.Popen(
        [*command, str(processes), *words], env=environment, stderr=subprocess.PIPE, text=True, cwd=TOP
    )


@pytest.mark.parametrize("changed", [{}, {"loss": "sum", "optimiser": "tf_rmsprop"}], ids=str)
def test_two_processes_learn_what_one_does_from_twice_the_episodes(
    tmp_path: Path, changed: dict[str, str]
) -> None:
    running = torchrun(str(TOP / "tests/train/two_learners.py"), str(tmp_path), json.dumps(changed))
    _, error = running.communicate(timeout=120)
    assert running.returncode == 0, error
    network, rollout = some_rollout()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    learner = Learner(network, TrainSettings(**changed))
    for progress in UPDATES:
        learner.update(rollout, learner.settings.at(progress))
    for name, value in load_network(tmp_path).state_dict().items():
        torch.testing.assert_close(value, network.state_dict()[name], rtol=1e-4, atol=1e-6)
        assert not torch.equal(value, before[name]), name


def train(folder: Path, *words: str) -> subprocess.Popen[str]:
    return torchrun("-m", "activelsd", "train", *WORDS, f"env.cache={folder / 'cache'}", *words)


def test_a_run_of_two_processes_is_stopped_and_goes_on_to_the_bit(tmp_path: Path) -> None:
    whole = train(tmp_path, f"runs={tmp_path / 'whole'}", "train.steps=2000")
    _, error = whole.communicate(timeout=120)
    assert whole.returncode == 0, error
    (folder,) = (tmp_path / "whole").iterdir()
    steps = [json.loads(line)["step"] for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert steps[-1] == 2000
    assert error.count(f"Training {folder}") == 1

    stopped = train(tmp_path, f"runs={tmp_path / 'halved'}", "train.steps=2000")
    checkpoints = tmp_path / "halved"
    until = time.monotonic() + 60
    while not list(checkpoints.glob("*/checkpoints/[0-9]*0")) and time.monotonic() < until:
        time.sleep(0.02)
    stopped.send_signal(signal.SIGTERM)
    stopped.communicate(timeout=60)
    (halved,) = checkpoints.iterdir()
    resumed = torchrun("-m", "activelsd", "train", "--resume", str(halved))
    _, error = resumed.communicate(timeout=120)
    assert resumed.returncode == 0, error
    one, other = (load_network(Run(run).checkpoint).state_dict() for run in (folder, halved))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_what_two_processes_wrote_is_not_for_one() -> None:
    state = {"memory": torch.arange(6), "first": torch.tensor([True, False])}
    both = {f"{rank}/{name}": value for rank in range(2) for name, value in state.items()}
    assert Group().own(state) == state == Group().gathered(state)
    assert Group(1, 2).own(both) == state
    with pytest.raises(ValueError, match="it was written by 2 processes, not 1"):
        Group().own(both)
    with pytest.raises(ValueError, match="it was written by 1 processes, not 2"):
        Group(1, 2).own(state)
