"""The stand-in from the command line: rooms recorded, trained in, and all players compared in them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activelsd import cli
from activelsd.compose import load, resolve
from activelsd.envs.oracle import shows_well
from activelsd.envs.viewgraph import ViewGraph

BASELINES = ("no_move", "random_walk", "random_policy", "object_search", "oracle")
SCENES = ("env.scenes.rooms=[bathroom]", *(f"env.scenes.{name}" for name in ("train=2", "val=1", "test=1")))
SMALL = ("env.width=96", "env.height=96", "env.step=0.5", "env.size=32", "env.starts.per_target=6")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("standin")


@pytest.fixture(scope="module")
def words(place: Path) -> list[str]:
    return ["env=thor", "env.backend=standin", *SCENES, *SMALL, f"env.cache={place / 'cache'}"]


@pytest.fixture(scope="module")
def compared(place: Path, words: list[str]) -> Path:
    """A run's folder with its comparison."""
    train = [
        "train.steps=2000",
        "train.loggers=[]",
        "policy.trunk.features=32",
        "threads=1",
        f"runs={place / 'runs'}",
    ]
    assert cli.main(["train", *words, *train]) == 0
    (run,) = (place / "runs").iterdir()
    assert cli.main(["compare", str(run), "--baselines", ",".join(BASELINES)]) == 0
    return run


@pytest.fixture(scope="module")
def graph(compared: Path) -> ViewGraph:
    return load(compared / "config.yaml").env.open()


def rows_of(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "episodes.jsonl").read_text().splitlines()]


def test_everything_says_that_it_is_a_stand_in(compared: Path) -> None:
    read = json.loads((compared / "comparison.json").read_text())
    assert read["backend"] == "standin"
    assert {one["backend"] for one in read["players"]} == {"standin"}
    assert {row["backend"] for row in rows_of(compared)} == {"standin"}


def test_all_players_stand_in_one_table_by_difficulty(
    compared: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["compare", str(compared), "--baselines", ",".join(BASELINES)]) == 0
    table = capsys.readouterr().out
    assert "pictures by standin" in table
    head = next(line for line in table.splitlines() if line.startswith("By difficulty"))
    assert "spl" in head
    for name in ("easy", "moderate", "hard"):
        assert name in head
    assert max(map(len, table.partition("Figures and episodes")[0].splitlines())) <= 80
    read = json.loads((compared / "comparison.json").read_text())
    rows = rows_of(compared)
    for one in read["players"]:
        own = [row for row in rows if row["player"] == one["name"]]
        assert sum(group["episodes"] for group in one["by_difficulty"]) == len(own)
        for group in one["by_difficulty"]:
            some = [row["right"] for row in own if row["difficulty"] == group["difficulty"]]
            assert group["accuracy"] == pytest.approx(np.mean(some))


def test_the_oracle_never_needs_more_views_than_who_gets_to_a_good_view(
    compared: Path, graph: ViewGraph
) -> None:
    assert graph.pair_of is not None
    well = np.append(shows_well(graph), False)[graph.pair_of]
    view_of = {
        (graph.scenes[scene], name): view
        for view, (scene, name) in enumerate(zip(graph.scene_of, graph.view_names, strict=True))
    }
    reached = 0
    for row in rows_of(compared):
        target = graph.targets.index(row["target"])
        good = [well[view_of[row["scene"], name], target] for name in row["path"]]
        if any(good):
            reached += row["player"] != "oracle"
            assert 0 < row["oracle_views"] <= good.index(True) + 1
        if row["player"] == "oracle" and 0 < row["oracle_views"] <= 20:
            assert good == [False] * (row["oracle_views"] - 1) + [True]
    assert reached > 20


def test_training_and_test_rooms_never_meet(graph: ViewGraph) -> None:
    scenes = [
        set(graph.scene_of[graph.start_view[graph.start_split == split]].tolist()) for split in range(3)
    ]
    assert [len(some) for some in scenes] == [2, 1, 1]
    assert len(set.union(*scenes)) == 4


def test_episodes_are_frozen(words: list[str], graph: ViewGraph) -> None:
    again = resolve(words).env.open()
    tested = np.flatnonzero(graph.start_split == 2)
    assert [graph.episode(row).id for row in tested] == [again.episode(row).id for row in tested]


def test_record_says_what_there_is(
    words: list[str], capsys: pytest.CaptureFixture[str], graph: ViewGraph
) -> None:
    assert cli.main(["record", *words]) == 0
    assert f"{len(graph.frames)} views of 32 pixels" in capsys.readouterr().out
    assert cli.main(["record", "env=modelnet"]) == 2
    assert "has no simulator to record" in capsys.readouterr().err
