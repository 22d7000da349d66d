"""The presets train: the paper's network and values, on small frames, for a few updates."""

from __future__ import annotations

import json
import math

import pytest

from activelsd import launch
from activelsd.compose import resolve
from activelsd.presets import groups

TINY = ("device=cpu", "env.dataset.path=null", "env.dataset.classes=[cup,vase]", "train.loggers=[]")
OBJECTS = ("env.dataset.train_per_class=3", "env.dataset.test_per_class=3", "train.log_every=1")


@pytest.mark.slow
@pytest.mark.parametrize("experiment", ["paper", "paper_lstm"])
def test_the_papers_values_train(experiment: str, monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)
    quick = (
        "env.size=64",
        "env.rules.max_views=3",
        "train.envs=2",
        "train.length=3",
        "train.steps=12",
        "train.evaluate_every=1000",
    )
    folder = launch.begin(resolve([f"experiment={experiment}", *TINY, *OBJECTS, *quick]))
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    trained = [row for row in rows if "loss/total" in row]
    assert len(trained) == 2
    assert all(math.isfinite(row["loss/total"]) for row in trained)


def test_every_experiment_composes() -> None:
    for name in groups()["experiment"]:
        assert resolve([f"experiment={name}"]).name == name
