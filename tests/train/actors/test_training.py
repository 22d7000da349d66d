"""Training with GA3C's actors: it learns what resident ones learn, logs its queues, and survives kills."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from activelsd import launch
from activelsd.compose import resolve
from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.policy.checkpoint import load_network
from activelsd.policy.lsdnet import NetworkShape
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import TrainSettings
from activelsd.train.trainer import Trainer
from tests.envs.avd.homes import write_homes
from tests.train.actors.mischief import GRAPH
from tests.train.actors.worlds import actors


def train(run: Run, kind: str, *, resume: bool = False, **changed: Any) -> list[dict[str, float]]:
    """Train on the ring with resident actors or a kind of GA3C's; the rows of metrics."""
    chosen = {"steps": 12_000, "envs": 16, "log_every": 2_000, "loggers": [], "learning_rate": 2e-3}
    settings = TrainSettings(**(chosen | changed))  # type: ignore[arg-type]
    shape = NetworkShape(size=GRAPH.size, trunk_settings={"features": 32})
    crew = on_recordings([OpenWorld("rings", GRAPH, PRESETS["V4"])], settings, frames=1)
    if kind != "resident":
        crew = lambda network, seed: actors(  # noqa: E731
            kind, network, seed=seed, length=settings.length, agents=2, envs_per_agent=settings.envs // 2
        )
    Trainer(run, tree_of(GRAPH), shape, settings, crew, seed=0, resume=resume).train()
    return [json.loads(line) for line in (run.folder / "metrics.jsonl").read_text().splitlines()]


def test_threads_learn_what_resident_actors_learn_and_the_log_says_how(tmp_path: Path) -> None:
    rows = {
        kind: train(Run.create(tmp_path, kind, ""), kind, vtrace=True, steps=24_000)
        for kind in ("resident", "threads")
    }
    ends = {kind: sum(row["accuracy"] for row in rows[kind][-3:]) / 3 for kind in rows}
    assert ends["resident"] > 0.9
    # Which questions share a batch depends on time, so no two runs of threads end alike.
    assert ends["threads"] > ends["resident"] - 0.15
    last = rows["threads"][-1]
    assert rows["resident"][-1].keys() < last.keys()
    for name in ("prediction_queue", "training_queue", "prediction_batch", "lag", "learner_idle"):
        assert isinstance(last[f"ga3c/{name}"], float)
    assert last["ga3c/agents_lost"] == 0
    assert last["navigate"] > 0


SMALL = ["device=cpu", "policy.trunk.features=8", "env.size=32", "train.steps=200", "train.loggers=[]"]
SHAPES = [
    *("env=modelnet", "env.dataset.classes=cup,sofa", "env.rules.wrong=-1"),
    *("env.dataset.train_per_class=2", "env.dataset.test_per_class=1"),
]
HOMES = [
    "env=avd",
    "env.colour=rgb",
    "env.dataset.path=homes",
    "env.cache=cache",
    "env.navigate=rotate_cw,rotate_ccw",
]
CREW = ["train.actors=ga3c", "train.ga3c.agents=2", "train.ga3c.envs_per_agent=2", "train.log_every=40"]


@pytest.mark.parametrize(
    ("world", "kind"), [(SHAPES, "threads"), (SHAPES, "processes"), (HOMES, "processes")]
)
def test_from_the_command_lines_words_to_a_trained_run(
    world: list[str], kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_homes(tmp_path / "homes", homes=6)
    words = [*SMALL, *world, *CREW, f"train.ga3c.kind={kind}", "train.evaluate_every=1000"]
    folder = launch.begin(resolve(words))
    assert launch.resume(folder, ["train.steps=240"]) == folder
    assert int(Run(folder).checkpoint.name) >= 240


SCRIPT = """
import sys
from pathlib import Path
from activelsd.train.run import Run
from tests.train.actors.test_training import train
folder, kind, resume = sys.argv[1:]
train(Run(Path(folder)), kind, resume=resume == "yes", steps=10**9, checkpoint_every=320, log_every=80)
"""


KILLS = int(os.environ.get("ACTIVELSD_KILLS", "6"))
"""A handful each time the tests run; ACTIVELSD_KILLS=20 asks for more."""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_again_and_again_no_checkpoint_is_broken_and_little_is_lost(tmp_path: Path) -> None:
    run, rng = Run.create(tmp_path, "killed", ""), random.Random(0)
    step = 0
    for attempt in range(KILLS):
        process = subprocess.Popen(
            [
                *(sys.executable, "-c", SCRIPT, str(run.folder), ("threads", "processes")[attempt % 2]),
                "yes" if step else "no",
            ],
            stderr=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + 120
        while not run._finished() or int(run.checkpoint.name) == step:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.5))
        process.kill()
        process.wait()
        load_network(run.checkpoint)
        tensors, progress = run.load_training()
        assert tensors
        step = int(progress["step"])
        rows = (run.folder / "metrics.jsonl").read_text().splitlines()
        reached = max(json.loads(row)["step"] for row in rows if row.endswith("}"))
        assert reached - step < 320 + 80
