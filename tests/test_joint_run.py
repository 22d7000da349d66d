"""Several worlds from the command line: prepared, trained together, measured each, and carried over."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from activelsd import cli
from activelsd.train.run import Run

WORLDS = {"tables": "[desk, table]", "vessels": "[cup, vase]", "mixed": "[cup, desk, vase]"}
SETTINGS = [
    *("device=cpu", "train.steps=160", "train.envs=8", "train.loggers=[]", "train.evaluate_every=80"),
    *("policy.trunk.features=8", "env.size=32", "env.navigate=orbit_cw,orbit_ccw"),
    *("env.dataset.train_per_class=3", "env.dataset.test_per_class=2"),
]
BOTH = "env=tables.yaml,vessels.yaml"


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A working folder with a preset per world."""
    monkeypatch.chdir(tmp_path)
    for name, classes in WORLDS.items():
        Path(f"{name}.yaml").write_text(f"name: modelnet\ndataset.classes: {classes}\n")
    return tmp_path


def train(*words: str) -> Path:
    assert cli.main(["train", *SETTINGS, *words]) == 0
    return Run.newest(Path("runs")).folder


def test_a_joint_run_is_measured_in_each_of_its_worlds(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = train(BOTH, "env.vessels.navigate=[orbit_cw_90]", "env.vessels.rules.max_views=3")
    assert run.name.endswith("-tables+vessels")
    metrics = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert {"tables/accuracy", "vessels/views", "accuracy"} <= metrics[-1].keys() | metrics[-2].keys()
    assert any("val/tables/accuracy" in row and "val/vessels/steps" in row for row in metrics)

    capsys.readouterr()
    assert cli.main(["compare", str(run), "--baselines", "random_walk"]) == 0
    said = capsys.readouterr().out
    assert "World tables, pictures by modelnet." in said
    assert "World vessels, pictures by modelnet." in said
    for world, views in (("tables", 12), ("vessels", 3)):
        read = json.loads((run / f"comparison_{world}.json").read_text())
        assert read["world"] == world
        assert read["players"][0]["max_views"] == views
        assert {one["class"] for one in read["players"][0]["by_class"]} == set(
            WORLDS[world][1:-1].split(", ")
        )
        assert f"{run}/comparison_{world}.png" in said

    assert cli.main(["train", "--resume", str(run), "train.steps=240"]) == 0
    assert Run(run).checkpoint.name == "000000000240"


def players(run: Path, world: str) -> list[str]:
    return [one["name"] for one in json.loads((run / f"comparison_{world}.json").read_text())["players"]]


def test_runs_meet_in_the_worlds_they_share(capsys: pytest.CaptureFixture[str]) -> None:
    one, other = train(BOTH), train("env=vessels.yaml,mixed.yaml")
    alone, foreign = train("env=vessels.yaml", "env.rules.wrong=-1"), train("env=mixed.yaml", "name=foreign")
    capsys.readouterr()
    assert cli.main(["evaluate", str(one)]) == 0
    assert (one / "evaluation_tables.json").exists()
    assert cli.main(["compare", str(one), str(other), str(alone)]) == 0
    assert players(one, "tables") == [one.name]
    assert players(one, "vessels") == [one.name, other.name, alone.name]
    assert cli.main(["compare", str(alone), str(other)]) == 0
    assert json.loads((alone / "comparison.json").read_text())["paired"]
    capsys.readouterr()
    assert cli.main(["compare", str(one), str(foreign)]) == 2
    assert "foreign plays in modelnet and " in capsys.readouterr().err


def test_prepare_says_what_each_world_has(capsys: pytest.CaptureFixture[str]) -> None:
    words = [word for word in SETTINGS if word.startswith("env.")]
    assert cli.main(["prepare", BOTH, *words]) == 0
    said = capsys.readouterr().out
    assert said.count("objects of 2 classes") == 2
    assert said.index("World tables") < said.index("World vessels")


def test_a_run_starts_from_what_another_knows(capsys: pytest.CaptureFixture[str]) -> None:
    source = train("env=vessels.yaml")
    capsys.readouterr()
    run = train("env=mixed.yaml", f"policy.init={source}")
    err = capsys.readouterr().err
    assert "Started from " in err
    assert "6 of 7 rows of the head (classify, navigate, classify/cup, classify/vase and 2 more)" in err
    read = json.loads((run / "init.json").read_text())
    assert read["from"] == str(source.absolute() / "checkpoints" / "000000000160")
    assert (read["fresh"], read["dropped"], read["around"]) == (["classify/desk"], [], "none")
    # A checkpoint's own folder will do, and a joint run takes over as well.
    joint = train(BOTH, f"policy.init={read['from']}")
    assert json.loads((joint / "init.json").read_text())["fresh"] == ["classify/desk", "classify/table"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["policy.init=nowhere"], "nowhere is not a run: it has no config.yaml;"),
        (
            ["policy.init={source}", "policy.memory=lstm"],
            "A network with policy.memory=pool cannot start one with",
        ),
    ],
)
def test_what_cannot_be_started_from_is_one_sentence_and_leaves_no_run(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    source = train("env=vessels.yaml")
    capsys.readouterr()
    assert cli.main(["train", "env=mixed.yaml", *SETTINGS, *(w.format(source=source) for w in words)]) == 2
    assert sentence in capsys.readouterr().err.splitlines()[-1]
    assert len(list(Path("runs").iterdir())) == 1
