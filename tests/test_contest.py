"""The verbs that measure: from a run's folder to a table on the screen and files beside the checkpoint."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
import trimesh

from activelsd import cli, launch
from activelsd.compose import resolve
from activelsd.envs.avd.settings import AVDSettings
from tests.graphs import MOVES, room_graph

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


def test_all_are_compared_at_equal_views(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    players = ["random_walk", "spread+confidence", "no_move"]
    assert cli.main(["compare", "--baselines", ",".join(players), "--frontier", "--views", "2.5"]) == 0
    said = capsys.readouterr().out
    lines = said.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("At equal views"))
    assert lines[at].split() == ["At", "equal", "views", "1.5", "2", "2.5", "3", "4", "6", "area"]
    named = ["trained", "random_walk", "vs", "spread+confidence", "vs"]
    assert [line.split()[0] for line in lines[at + 2 : at + 7]] == named
    assert max(map(len, lines[:-2])) <= 80, "the folder's name aside"
    assert "Thresholds of all stops were chosen on val objects for 2.5 views." in said
    read = json.loads((run / "comparison.json").read_text())
    assert read["wanted_views"] == 2.5
    frontier = read["frontier"]
    assert [one["name"] for one in frontier["curves"]] == ["trained", "random_walk", "spread+confidence"]
    assert all(len(one["accuracy_ci"]) == len(frontier["mean_views"]) for one in frontier["curves"])
    assert cli.main(["compare", "--views", "0.5"]) == 2
    assert capsys.readouterr().err == (
        "activelsd: --views 0.5: must be a number of views, 1 or more, as in --views 2.5.\n"
    )


def as_meshes(folder: Path, classes: Sequence[str] = ("cup", "vase")) -> Path:
    """A folder of small meshes, none of them the run's own."""
    for i, name in enumerate(classes):
        for split in ("train", "test"):
            for number in range(3):
                mesh = trimesh.creation.box((1 + i, 1 + number, 2))
                file = folder / name / split / f"{name}_{number}.off"
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(trimesh.exchange.off.export_off(mesh).encode())
    return folder


def test_a_run_is_measured_on_other_objects_and_results_say_so(
    run: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Also if it knows more classes than are shown; a class that it does not know is named."""
    words = ["env.dataset.classes=null", "evaluate.episodes_per_object=2"]
    other, one = as_meshes(tmp_path / "other"), as_meshes(tmp_path / "one", ["vase"])
    out = tmp_path / "new" / "results"
    assert cli.main(["compare", str(run), "--out", str(out), f"env.dataset.path={other}", *words]) == 0
    assert "Changed since training: env.dataset.path=" in " ".join(capsys.readouterr().out.split())
    read = json.loads((out / "comparison.json").read_text())
    assert read["changed"] == {"env.dataset.path": str(other), "env.dataset.classes": None}
    assert read["episodes"] == 12
    assert not (run / "comparison.json").exists()

    assert cli.main(["evaluate", str(run), f"env.dataset.path={one}", *words]) == 0
    assert "knows 2 classes, and objects of 1 of them are shown" in caplog.text
    rows = [json.loads(line) for line in (run / "evaluation_episodes.jsonl").read_text().splitlines()]
    assert {row["label"] for row in rows} == {"vase"}

    mug = as_meshes(tmp_path / "mug", ["mug", "vase"])
    capsys.readouterr()
    assert cli.main(["evaluate", str(run), f"env.dataset.path={mug}", *words]) == 2
    assert "only the world has mug, the world lacks cup;" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_said_before_anything_is_played(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr("activelsd.contest.compare", None)
    assert cli.main(["compare", str(run), "--out", str(tmp_path / "file")]) == 2
    assert "cannot be written (Not a directory); name another folder" in capsys.readouterr().err


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
        ("env.size=64", "env.size cannot be changed here, a run is measured in its own world; what can: "),
        ("env.dataset.path=/nowhere", "There is no dataset at /nowhere; "),
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


def test_figures_of_the_paper_are_drawn_beside_a_run(
    run: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Whatever a run has; what it lacks is said in a sentence, and the rest is drawn."""
    assert cli.main(["figures"]) == 0
    said = capsys.readouterr().out
    names = {path.name for path in (run / "figures").iterdir()}
    assert {"table3.png", "table3.csv", "figure3.png"} <= names
    assert ("figure4.png" in names) != ("No episode of" in caplog.text)
    lines = (run / "figures" / "table3.csv").read_text().splitlines()
    ours = [line.split(",") for line in lines if line.startswith("trained,")]
    assert sum(int(right) + int(wrong) for _, _, right, wrong in ours) == 48
    assert "LSD-Net, published, ModelNet40 meshes\n" in said
    assert "right at the first view 67 %, after 2-8 views 85-94 %, after 12 views 83 %" in said
    assert not (run / "evaluation.json").exists()

    metrics = run / "metrics.jsonl"
    rows = [json.loads(line) for line in metrics.read_text().splitlines()]
    metrics.write_text(
        "".join(json.dumps({k: v for k, v in row.items() if k != "episodes"}) + "\n" for row in rows)
    )
    caplog.clear()
    assert cli.main(["figures", str(run), "--out", "elsewhere", "split=val"]) == 0
    assert f"{metrics} has no 'episodes', which Figure 3 needs" in caplog.text
    assert "figure3.png" not in capsys.readouterr().out
    assert (Path("elsewhere") / "table3.png").exists()


def test_recognisers_are_trained_once_and_stand_below_the_players(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["compare", "--recognisers", "mvcnn", "evaluate.epochs=2"]
    assert cli.main(words) == 0
    out, err = capsys.readouterr()
    assert "Training mvcnn" in err
    lines = out.splitlines()
    assert max(map(len, lines[: lines.index("48 episodes: 4 test objects, every start of each.")])) <= 80
    head = next(i for i, line in enumerate(lines) if line.startswith("Recogniser"))
    assert lines[head].split() == [
        "Recogniser",
        "Given",
        "Views",
        "Params",
        "Trained",
        "Accuracy,",
        "%",
        "Published",
    ]
    assert lines[head + 2].split()[:3] == ["mvcnn", "images", "12"]
    assert lines[head + 2].split()[-1] == "90.1"
    assert "Published: the paper's Table 2, ModelNet40 meshes" in out
    rows = json.loads((run / "comparison.json").read_text())["recognisers"]
    assert [(row["views"], row["objects"]) for row in rows] == [(12, 4), (3, 4), (1, 4)]
    assert rows[0]["published_percent"] == 90.1
    assert rows[0]["accuracy_ci"][0] <= rows[0]["accuracy"] <= rows[0]["accuracy_ci"][1]

    assert cli.main(words) == 0
    again, err = capsys.readouterr()
    assert "Training mvcnn" not in err
    assert again.splitlines()[head:] == lines[head:]


def test_a_recogniser_that_is_none_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compare", str(run), "--recognisers", "mvcn"]) == 2
    assert capsys.readouterr().err == "activelsd: There is no recogniser 'mvcn'; did you mean mvcnn?\n"


def test_rooms_are_refused_before_anything_is_trained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also in a run of several worlds, the first of which could do."""
    monkeypatch.setattr(AVDSettings, "graph", lambda self, progress=None: room_graph(size=32))
    monkeypatch.setattr(AVDSettings, "moves", classmethod(lambda cls: MOVES))
    objects = ("env.dataset.train_per_class=3", "env.dataset.test_per_class=2", "env.size=32")
    small = ("policy.trunk.features=8", "train.steps=160", "train.loggers=[]", "train.envs=8")
    run = launch.begin(resolve(["env=modelnet,avd", *objects, *small, "device=cpu", f"runs={tmp_path}"]))
    capsys.readouterr()
    assert cli.main(["compare", str(run), "--recognisers", "mvcnn"]) == 2
    error = capsys.readouterr().err
    assert "Training mvcnn" not in error
    assert error.splitlines()[-1].startswith(
        "activelsd: Recognisers name an object by views of it alone, and env=avd"
    )
    assert not list(run.glob("comparison*"))
