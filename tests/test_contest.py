"""The verbs that measure: from a run's folder to a table on the screen and files beside the checkpoint."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from activelsd import cli, launch
from activelsd.compose import resolve

WORLD = [
    *("env=modelnet", "device=cpu", "env.size=32", "env.navigate=orbit_cw,orbit_ccw", "train.envs=8"),
    *("env.dataset.classes=[cup,vase]", "env.dataset.train_per_class=3", "env.dataset.test_per_class=2"),
    *("policy.trunk.features=8", "train.steps=160", "train.loggers=[]"),
]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A run of a few steps, the newest in `./runs`."""
    monkeypatch.chdir(tmp_path)
    return launch.begin(resolve([*WORLD, "name=toy"]))


def test_compare_takes_the_newest_run_and_leaves_all_files(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["compare", "--baselines", "random_walk,no_move"]) == 0
    said = capsys.readouterr().out
    assert "48 episodes: 4 test objects, every start of each." in said
    assert said.splitlines()[-2:] == [
        f"Figures and episodes: comparison.json, comparison.csv, episodes.jsonl in {run}",
        f"Picture of episodes:  {run}/comparison.png",
    ]
    assert (run / "comparison.png").read_bytes().startswith(b"\x89PNG")
    assert (run / "comparison.csv").exists()
    read = json.loads((run / "comparison.json").read_text())
    assert [one["name"] for one in read["players"]] == ["trained", "random_walk", "no_move"]
    assert [one["name"] for one in read["paired"]] == ["random_walk", "no_move"]
    assert len((run / "episodes.jsonl").read_text().splitlines()) == 3 * 48


def test_evaluate_leaves_a_comparison_alone(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["evaluate", str(run), "split=val", "threads=1", "evaluate.episodes_per_object=5"]) == 0
    assert "10 episodes: 2 val objects, 5 random starts of each." in capsys.readouterr().out
    assert json.loads((run / "evaluation.json").read_text())["split"] == "val"
    assert not (run / "comparison.json").exists()


def test_several_runs_are_told_apart_by_their_folders(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = launch.begin(resolve([*WORLD, "name=other", "seed=1"]))
    assert cli.main(["compare", str(run), str(other)]) == 0
    read = json.loads((run / "comparison.json").read_text())
    assert [one["name"] for one in read["players"]] == [run.name, other.name]
    assert not (other / "comparison.json").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("split=tset", "evaluate.split=tset: must be 'train', 'val' or 'test'; did you mean test?"),
        ("evaluate.episodes=3", "evaluate.episodes is not a setting; did you mean"),
        ("train.gamma=0.5", "train.gamma cannot be changed here, a run is measured in its own world;"),
        ("env.dataset.path=/nowhere", "env.dataset.path cannot be changed here, "),
    ],
)
def test_mistakes_are_one_sentence_and_leave_nothing(
    run: Path, words: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(run.iterdir())
    capsys.readouterr()
    assert cli.main(["compare", "--baselines", "no_move", words]) == 2
    out, err = capsys.readouterr()
    assert err.startswith(f"activelsd: {sentence}")
    assert err.count("\n") == 1
    assert out == ""
    assert sorted(run.iterdir()) == before
