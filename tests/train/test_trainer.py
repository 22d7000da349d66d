"""The training loop with everything in it: it repeats, resumes to the bit, survives signals, and learns."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.errors import RunError, TrainingError
from activelsd.policy.checkpoint import load_network, save_tensors
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import NetworkShape
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import TrainSettings
from activelsd.train.trainer import Trainer
from tests.graphs import ring_graph

GA3CS = {"optimiser": "tf_rmsprop", "optimiser_epsilon": 0.1, "loss": "sum", "trajectories": 4}


def trainer(
    run: Run,
    memory: str = "pool",
    *,
    resume: bool = False,
    seed: int = 5,
    device: str = "cpu",
    **changed: Any,
) -> Trainer:
    settings = {"steps": 960, "envs": 8, "length": 4, "log_every": 64, "checkpoint_every": 480, "loggers": []}
    graph, frames = ring_graph(), 2 if memory == "stack" else 1
    chosen = TrainSettings(**(settings | changed))  # type: ignore[arg-type]
    return Trainer(
        run,
        tree_of(graph),
        NetworkShape(memory=memory, size=graph.size, trunk_settings={"features": 32}, frames=frames),
        chosen,
        on_recordings([OpenWorld("rings", graph, PRESETS["V4"])], chosen, frames=frames, device=device),
        seed=seed,
        device=device,
        resume=resume,
    )


def new_run(root: Path, name: str = "test") -> Run:
    return Run.create(root, name, "seed: 5\n")


def weights(run: Run) -> dict[str, torch.Tensor]:
    return load_network(run.checkpoint).state_dict()


def assert_same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> None:
    assert one.keys() == other.keys()
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_a_seed_repeats_a_run_and_another_does_not(tmp_path: Path) -> None:
    runs = [new_run(tmp_path, name) for name in "abc"]
    for run, seed in zip(runs, (5, 5, 6), strict=True):
        trainer(run, seed=seed).train()
    assert_same(weights(runs[0]), weights(runs[1]))
    assert not torch.equal(weights(runs[0])["policy.weight"], weights(runs[2])["policy.weight"])


@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
@pytest.mark.parametrize(
    "changed", [{"optimiser": "rmsprop"}, GA3CS, {"dropout": 0.5}, {"amp": True}], ids=str
)
def test_resume_goes_on_to_the_bit(tmp_path: Path, memory: str, changed: dict[str, Any]) -> None:
    whole, halved = new_run(tmp_path, "whole"), new_run(tmp_path, "halved")
    trainer(whole, memory, **changed).train()
    first = trainer(halved, memory, **changed)
    while first.step < 480:
        first._update(_Forgets())  # type: ignore[arg-type]
    first.save()
    trainer(halved, memory, resume=True, **changed).train()
    assert_same(weights(whole), weights(halved))


@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
def test_bfloat16_learns_from_about_the_same_losses(tmp_path: Path, memory: str) -> None:
    full, half = (trainer(new_run(tmp_path, name), memory, amp=name == "half") for name in ("full", "half"))
    rollout = full.actors.collect(Epsilon(0.5, 0.5))
    with torch.autocast("cpu", torch.bfloat16):
        output = half.learner.output(replace(rollout, output=None))
    parts = (output.logits, output.value, output.features, *output.state.values())
    assert {part.dtype for part in parts} == {torch.float32}
    expected = full.learner.losses(rollout, full.settings.at(0.0))
    found = half.learner.losses(replace(rollout, output=output), half.settings.at(0.0))
    assert not torch.equal(found["total"], expected["total"])  # else nothing was of bfloat16
    torch.testing.assert_close(found, expected, rtol=0.02, atol=0.02)
    # The trainer's own updates are of bfloat16, and what they change is of full precision.
    for one in (full, half):
        one._update(_Forgets())  # type: ignore[arg-type]
    weights = [dict(one.network.named_parameters())["policy.weight"] for one in (full, half)]
    assert {w.dtype for w in weights} == {torch.float32}
    assert not torch.equal(*weights)


@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
def test_checkpoints_of_older_versions_resume(tmp_path: Path, memory: str) -> None:
    """They hold the memory's state as one tensor, and the width of the compact trunk beside its name."""
    run = new_run(tmp_path)
    whole = trainer(run, memory, steps=480)
    whole.train()
    tensors, _ = run.load_training()
    state = [tensors.pop(f"actors/memory/{name}") for name in whole.network.memory.shapes]
    tensors["actors/memory"] = torch.cat(state, 1) if state else torch.zeros(8, 0)
    save_tensors(tensors, run.checkpoint / "training.safetensors")
    meaning = json.loads((run.checkpoint / "network.json").read_text())
    del meaning["shape"]["memory_settings"]
    meaning["shape"]["features"] = meaning["shape"].pop("trunk_settings")["features"]
    (run.checkpoint / "network.json").write_text(json.dumps(meaning))
    resumed = trainer(run, memory, steps=480, resume=True)
    assert_same(whole.actors.state(), resumed.actors.state())
    assert_same(whole.learner.state(), resumed.learner.state())


COMPILED = """
import sys
from pathlib import Path
from activelsd.train.run import Run
from tests.train.test_trainer import _Forgets, trainer
whole, halved = (Run(Path(folder)) for folder in sys.argv[1:])
trainer(whole, steps=320, compile=True).train()
first = trainer(halved, steps=320, compile=True)
assert first.network._compiled_call_impl is not None
while first.step < 160:
    first._update(_Forgets())
first.save()
trainer(halved, resume=True, steps=320, compile=True).train()
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("c++") is None, reason="torch.compile needs a C++ compiler")
def test_a_compiled_network_trains_as_it_is_and_resumes(tmp_path: Path) -> None:
    plain, whole, halved = (new_run(tmp_path, name) for name in ("plain", "whole", "halved"))
    trainer(plain, steps=320).train()
    # In a process of its own: the compiler fails where a test has imported Python's old distutils.
    subprocess.run([sys.executable, "-c", COMPILED, str(whole.folder), str(halved.folder)], check=True)
    assert_same(weights(whole), weights(halved))
    for compiled in (whole, halved):
        for name, weight in weights(plain).items():
            torch.testing.assert_close(weights(compiled)[name], weight, rtol=1e-2, atol=1e-3)


class _Forgets:
    """Statistics that keep nothing."""

    def add(self, *_: object) -> None:
        """Take a rollout and drop it."""


def test_metrics_are_rows_of_numbers_and_resuming_writes_no_row_twice(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    trainer(run).train()
    path = run.folder / "metrics.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [row["step"] for row in rows] == sorted({row["step"] for row in rows})
    for name in (
        "reward",
        "accuracy",
        "views",
        "navigate",
        "steps_per_second",
        "loss/total",
        "policy_entropy_loss",
        "episodes",
    ):
        assert all(isinstance(row[name], float) for row in rows)
    # Rows of steps after the checkpoint, as a kill leaves them, are written again and not twice.
    path.write_text(path.read_text() + '{"step": 99999, "reward": 1.0}\n{"step": 1000')
    trainer(run, resume=True, steps=1920).train()
    steps = [json.loads(line)["step"] for line in path.read_text().splitlines()]
    assert steps == sorted(set(steps))
    assert steps[-1] == 1920


def test_old_checkpoints_go_and_a_half_written_one_is_not_read(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    trainer(run, checkpoint_every=96).train()
    assert [path.name for path in sorted((run.folder / "checkpoints").iterdir())] == [
        "000000000864",
        "000000000960",
    ]
    (run.folder / "checkpoints" / "000000001000.tmp").mkdir()
    assert run.checkpoint.name == "000000000960"


def test_truncated_checkpoint_is_one_sentence(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    trainer(run).train()
    file = run.checkpoint / "network.safetensors"
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(RunError, match="cannot be read"):
        load_network(file.parent)
    (file.parent / "network.json").write_text("{")
    with pytest.raises(RunError, match="not a network's description"):
        load_network(file.parent)


def test_loss_that_is_not_finite_stops_the_run_with_advice(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="learning_rate"):
        trainer(new_run(tmp_path), learning_rate=1e20, clip_norm=None, decay=False).train()


def test_newest_run_is_the_one_with_a_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="activelsd train"):
        Run.newest(tmp_path)
    done = new_run(tmp_path, "done")
    trainer(done, steps=64).train()
    os.utime(done.folder / "config.yaml", (1, 1))
    new_run(tmp_path, "begun")
    assert Run.newest(tmp_path).folder == done.folder


def test_it_learns_to_look_before_it_answers(tmp_path: Path) -> None:
    """A world whose class shows on 3 of 12 views: answering well means walking there first."""
    graph = ring_graph(objects=12, classes=3, telling=(3, 4, 5))
    run = new_run(tmp_path)
    settings = TrainSettings(steps=60_000, envs=32, learning_rate=2e-3, log_every=5_000, loggers=[])
    shape = NetworkShape(size=graph.size, trunk_settings={"features": 64})
    actors = on_recordings([OpenWorld("rings", graph, PRESETS["V4"])], settings, frames=1)
    Trainer(run, tree_of(graph), shape, settings, actors, seed=0).train()
    last = json.loads((run.folder / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["accuracy"] > 0.9  # from the first view no more than 1/4 + 3/4 * 1/3 = 0.5
    assert last["accuracy_at_first_view"] < 0.65
    assert last["views"] > 2.0


SCRIPT = """
import sys
from pathlib import Path
from tests.train.test_trainer import new_run, trainer
run = new_run(Path(sys.argv[1]))
print(run.folder, flush=True)
trainer(run, steps=10**9, checkpoint_every=64).train()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_process_leaves_a_run_that_resumes(tmp_path: Path, number: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    run = Run(Path(process.stdout.readline().strip()))
    deadline = time.monotonic() + 60
    while not (run.folder / "checkpoints").exists() or not run._finished():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(number)
    process.wait(30)
    process.stdout.close()
    step = int(run.checkpoint.name)
    resumed = trainer(run, resume=True, steps=step + 64)
    assert resumed.step == step
    resumed.train()
    assert int(run.checkpoint.name) == step + 64
