"""From runs and baselines to files, a table and a picture."""

from __future__ import annotations

import csv
import io
import json
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activelsd import registry
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, DataError, RunError
from activelsd.evaluate import result_files
from activelsd.evaluate.compare import Comparison, Entrant, assemble, compare, measure
from activelsd.evaluate.filmstrips import choose, filmstrip
from activelsd.evaluate.fonts import choose_fonts
from activelsd.evaluate.metrics import Interval
from activelsd.evaluate.picture import draw
from activelsd.evaluate.players import NoMove
from activelsd.evaluate.protocol import EpisodeRow
from activelsd.evaluate.recognisers.rows import Recognition
from activelsd.evaluate.table import text
from tests.evaluate.lattice import lattice
from tests.evaluate.worlds import CLASSES, RULES, network, ring, row

GRAPH = ring(27)
ALL = ("no_move", "random_walk", "random_policy", "all_views")


def entrant(
    name: str = "trained", graph: ViewGraph = GRAPH, rules: EpisodeRules = RULES, memory: str = "pool"
) -> Entrant:
    net = network(graph, memory)
    return Entrant(name=name, network=net, graph=graph, rules=rules, world="rings", backend="random")


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare([entrant()], ALL, seed=3)


@pytest.fixture(scope="module")
def folder(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "new"
    result_files.write(comparison, folder)
    return folder


def test_json_says_how_all_stand_and_differ(comparison: Comparison, folder: Path) -> None:
    read = json.loads((folder / "comparison.json").read_text())
    assert (read["world"], read["backend"], read["split"], read["reference"]) == (
        "rings",
        "random",
        "test",
        "trained",
    )
    assert read["left_out"] == []
    assert (read["episodes"], read["objects"], read["episodes_per_object"], read["seed"]) == (54, 9, None, 3)
    assert [one["name"] for one in read["players"]] == ["trained", *ALL]
    for one in read["players"]:
        assert (one["world"], one["backend"], one["episodes"]) == ("rings", "random", 54)
        for name in ("accuracy", "views", "steps"):
            low, high = one[f"{name}_ci"]
            assert low <= one[name] <= high
        assert [group["class"] for group in one["by_class"]] == list(CLASSES)
        for groups in ("by_class", "by_views"):
            assert sum(group["episodes"] for group in one[groups]) == 54
        assert [group["views"] for group in one["by_views"]] == [1, 2, 3, 4, 5, 6]
        last = one["by_views_allowed"][-1]
        assert (last["views_allowed"], last["accuracy"]) == (6, one["accuracy"])
        assert last["mean_views"] == pytest.approx(one["views"])
    assert [one["name"] for one in read["paired"]] == list(ALL)
    own = read["players"][0]
    for one, player in zip(read["paired"], read["players"][1:], strict=True):
        for name in ("accuracy", "views", "steps"):
            assert one[name] == pytest.approx(player[name] - own[name])
            low, high = one[f"{name}_ci"]
            assert low <= one[name] <= high


def test_every_figure_comes_out_of_the_episodes(comparison: Comparison, folder: Path) -> None:
    lines = (folder / "episodes.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    assert len(rows) == 5 * 54
    names = [
        "player",
        "world",
        "backend",
        "scene",
        "target",
        "label",
        "start",
        "views",
        "answer",
        "right",
        "forced",
        "oracle_views",
        "difficulty",
    ]
    assert list(rows[0]) == [*names, "path", "answers"]
    read = json.loads((folder / "comparison.json").read_text())
    for one in read["players"]:
        some = [row for row in rows if row["player"] == one["name"]]
        right = [row["answer"] == row["label"] for row in some]
        assert right == [row["right"] for row in some]
        assert np.mean(right) == pytest.approx(one["accuracy"])
        assert np.mean([row["views"] for row in some]) == pytest.approx(one["views"])
        assert np.mean([row["views"] if row["right"] else 6 for row in some]) == pytest.approx(one["steps"])
    back = [
        EpisodeRow(**(row | {"path": tuple(row["path"]), "answers": tuple(row["answers"])})) for row in rows
    ]
    assert back == [row for some in comparison.rows.values() for row in some]
    starts = {name: [(row.target, row.start) for row in some] for name, some in comparison.rows.items()}
    assert all(listed == starts["trained"] for listed in starts.values())


def test_csv_holds_the_same(folder: Path) -> None:
    read = json.loads((folder / "comparison.json").read_text())
    lines = list(csv.DictReader(io.StringIO((folder / "comparison.csv").read_text())))
    assert [line["name"] for line in lines] == [one["name"] for one in read["players"]]
    for line, one in zip(lines, read["players"], strict=True):
        assert (line["world"], line["backend"]) == ("rings", "random")
        for name in ("accuracy", "views", "steps"):
            assert [float(line[name]), float(line[f"{name}_low"]), float(line[f"{name}_high"])] == [
                one[name],
                *one[f"{name}_ci"],
            ]
    assert lines[0]["accuracy_difference"] == ""
    assert float(lines[1]["views_difference_high"]) == read["paired"][0]["views_ci"][1]


def test_the_picture_is_one(folder: Path) -> None:
    import cv2

    content = (folder / "comparison.png").read_bytes()
    assert content.startswith(b"\x89PNG")
    assert struct.unpack(">II", content[16:24]) == (1600, 1000)
    assert b"world rings, pictures by random" in content or b"rings" in content
    image = cv2.imread(str(folder / "comparison.png"))
    assert image is not None
    colours = {tuple(pixel) for pixel in image.reshape(-1, 3)[::7].tolist()}
    assert len(colours) > 100
    assert (image != 255).any(2).mean() > 0.05


def test_files_come_whole_or_not_at_all(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "comparison.json").write_text("earlier")

    def broken(comparison: Comparison) -> bytes:
        raise RuntimeError("no picture")

    with monkeypatch.context() as patch:
        patch.setattr("activelsd.evaluate.picture.draw", broken)
        with pytest.raises(RuntimeError, match="no picture"):
            result_files.write(comparison, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["comparison.json"]
    assert (tmp_path / "comparison.json").read_text() == "earlier"
    written = result_files.write(comparison, tmp_path)
    assert json.loads((tmp_path / "comparison.json").read_text())["players"]
    written += result_files.write(comparison, tmp_path, "evaluation")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in written)
    assert {path.name for path in written} >= {
        "episodes.jsonl",
        "evaluation_episodes.jsonl",
        "evaluation.png",
    }


def test_the_same_is_said_twice(comparison: Comparison) -> None:
    told: list[tuple[int, int]] = []
    again = compare(
        [entrant()], ALL, seed=3, batch=11, progress=lambda done, total: told.append((done, total))
    )
    assert result_files.as_json(again) == result_files.as_json(comparison)
    assert told == sorted(told)
    assert told[-1] == (5 * 54, 5 * 54)
    assert draw(again) == draw(comparison)


def test_runs_with_other_moves_and_memories_play_the_same_episodes() -> None:
    still = entrant("still", ring(27, moves=("cw",)), EpisodeRules(can_move=False), "stack")
    both = compare([entrant(), still], ["no_move"], per_object=4, seed=1)
    assert [one.name for one in both.players] == ["trained", "still", "no_move"]
    starts = [[(row.target, row.start) for row in rows] for rows in both.rows.values()]
    assert starts[0] == starts[1] == starts[2]
    assert len(starts[0]) == 36
    assert both.players[1].views == (1.0, 1.0, 1.0)
    assert both.players[1].max_views == 12
    assert "4 random starts of each" in text(both)


def test_measuring_while_training_says_what_a_comparison_does(comparison: Comparison) -> None:
    one = entrant()
    figures = measure(one.network, GRAPH, RULES, split="test", world="rings", backend="random")
    own, at_first = comparison.reference, comparison.players[1]
    assert figures == pytest.approx(
        {
            "accuracy": own.accuracy.mean,
            "views": own.views.mean,
            "steps": own.steps.mean,
            "accuracy_at_first_view": at_first.accuracy.mean,
        }
    )


def test_mistakes_are_one_sentence() -> None:
    good = entrant()
    with pytest.raises(ConfigError, match="'no_move' is named twice"):
        compare([good], ["no_move", "no_move"])
    with pytest.raises(ConfigError, match="did you mean all_views"):
        compare([good], ["all_view"])
    with pytest.raises(DataError, match="no episode"):
        compare([entrant(graph=ring(3))])
    for graph, says in (
        (ring(27, moves=("cw",)), "other classes or moves"),
        (ring(27, size=20), "set env.size=16"),
        (ring(27).in_colour("rgb"), "set env.colour=gray"),
    ):
        misfit = Entrant(name="a", network=good.network, graph=graph, rules=RULES, world="w", backend="b")
        with pytest.raises(RunError, match=says):
            compare([misfit])
    with pytest.raises(RunError, match="trained and b do not play the same episodes"):
        compare([good, entrant("b", ring(18))])


def test_the_table_fits_80_columns(comparison: Comparison) -> None:
    long = compare([entrant("20261124-153012-modelnet-seed=1"), entrant("b")], ["no_move", "all_views"])
    for one in (comparison, long):
        said = text(one)
        assert all(len(line) <= 80 for line in said.splitlines())
        assert "\x1b" not in said
        lines = [line for line in said.splitlines() if "[" in line and "]" in line and "interval" not in line]
        players = [line for line in lines if not line.startswith("  vs ")]
        for standing, line in zip(one.players, players, strict=True):
            assert line.split()[0].strip("…") in standing.name
            measures = (100 * standing.accuracy.mean, 1), (standing.views.high, 2), (standing.steps.low, 2)
            assert all(f"{value:.{digits}f}" in line for value, digits in measures)
        assert all(line.count("[") == line.count("]") == 3 for line in lines)
        assert sum(line.startswith("  vs ") for line in said.splitlines()) == len(one.paired)
        assert "54 episodes: 9 test objects, every start of each." in said
        assert "World rings, pictures by random." in said


def test_the_table_says_how_far_the_way_is_gone() -> None:
    def rows(name: str, good: int) -> list[EpisodeRow]:
        return [row(player=name, target=f"cup/{i:03d}", right=i < good) for i in range(200)]

    played = {
        "trained": rows("trained", 180),
        "no_move": rows("no_move", 100),
        "all_views": rows("all_views", 190),
    }
    one = assemble(played, dict.fromkeys(played, 12), GRAPH, split="test", per_object=None, seed=0)
    assert one.gain_closed is not None
    assert one.gain_closed.mean == pytest.approx(8 / 9)
    assert "trained goes 89 % of the way from no_move's accuracy to all_views' [" in text(one)
    assert result_files.as_json(one)["gain_closed"] == one.gain_closed.mean
    alone = assemble(
        {"trained": played["trained"]}, {"trained": 12}, GRAPH, split="test", per_object=None, seed=0
    )
    assert "of the way" not in text(alone)
    assert result_files.as_json(alone)["gain_closed"] is None


def share_of_first(rows: Sequence[EpisodeRow]) -> float:
    """Share of first answers that are right."""
    return float(np.mean([row.answers[0] == row.label for row in rows]))


def right_when_moved(rows: Sequence[EpisodeRow]) -> float | None:
    moved = [row.right for row in rows if row.views > 1]
    return float(np.mean(moved)) if moved else None


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Figures added in this process; whoever asks for one more puts it in."""
    added: dict[str, Any] = {}
    monkeypatch.setattr(registry.figures, "_added", added)
    return added


def test_every_registered_figure_is_a_column(figures: dict[str, Any]) -> None:
    figures |= {"first": share_of_first, "moved": right_when_moved, "nowhere": lambda rows: float("nan")}
    one = compare([entrant()], ["no_move", "all_views"], seed=3)
    read = result_files.as_json(one)
    lines = list(csv.DictReader(io.StringIO(result_files.as_csv(one))))
    at_first = one.players[1].accuracy.mean
    for player, line in zip(read["players"], lines, strict=True):
        low, high = player["first_ci"]
        assert low <= player["first"] <= high
        assert player["first"] == pytest.approx(at_first)
        assert [float(line[f"first{end}"]) for end in ("", "_low", "_high")] == [player["first"], low, high]
        # Known for others: empty. Known for nobody: left out.
        if player["name"] == "no_move":
            assert player["moved"] is player["moved_ci"] is None
            assert line["moved"] == line["moved_low"] == line["moved_high"] == ""
        else:
            assert float(line["moved"]) == player["moved"]
        assert not {"spl", "spl_ci", "nowhere"} & player.keys()
        assert not {"spl", "spl_low", "nowhere"} & line.keys()
    said = text(one)
    assert "first: Share of first answers that are right." in said
    head = next(i for i, line in enumerate(said.splitlines()) if line.split() == ["Player", "first", "moved"])
    assert said.splitlines()[head + 3].split()[-1] == "-"
    assert f"{at_first:.2f} [" in said.splitlines()[head + 2]


def test_spl_is_such_a_figure() -> None:
    rows = [row(target=f"cup/{i % 9}", right=i % 3 > 0, views=2, oracle_views=i % 2 + 1) for i in range(54)]
    one = assemble({"trained": rows}, {"trained": 12}, GRAPH, split="test", per_object=None, seed=0)
    (read,) = result_files.as_json(one)["players"]
    assert read["spl"] == pytest.approx(0.5)
    assert list(read)[list(read).index("spl") :][:2] == ["spl", "spl_ci"]
    head = result_files.as_csv(one).splitlines()[0]
    assert "forced,spl,spl_low,spl_high,accuracy_difference" in head


def test_a_figure_that_cannot_be_is_left_out_with_a_warning(
    figures: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    def fails(rows: Sequence[EpisodeRow]) -> float:
        raise ZeroDivisionError("no rows")

    figures |= {"accuracy": share_of_first, "broken": fails, "fine": share_of_first}
    assert list(compare([entrant()]).reference.figures) == ["fine"]
    assert caplog.messages == [
        "The figure 'accuracy' has a name that every player's own figures use; mend it. It is left out.",
        "The figure 'broken' fails (ZeroDivisionError: no rows); mend it. It is left out.",
    ]


@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize("graded", [False, True])
def test_figures_fit_80_columns(figures: dict[str, Any], count: int, graded: bool) -> None:
    figures |= {f"a_figure_with_a_rather_long_name_{i}": lambda rows: 12.345 for i in range(count)}
    figures["tiny"] = lambda rows: 0.0012
    names = ("20261124-153012-modelnet-seed=1", "no_move", "object_search")
    grades = ("easy", "moderate", "hard") if graded else (None,)
    played = {
        name: [row(player=name, difficulty=grade, right=i % 3 > 0) for i in range(60) for grade in grades]
        for name in names
    }
    one = assemble(played, dict.fromkeys(names, 12), GRAPH, split="test", per_object=None, seed=0)
    said = text(one)
    assert all(len(line) <= 80 for line in said.splitlines())
    assert said.count("12.35 [12.35, 12.35]") + said.count("12.34 [12.34, 12.34]") == 3 * count
    assert said.count("0.0012 [0.0012, 0.0012]") == 3
    for figure in figures:
        assert figure in said
    assert said.count("By difficulty ") == (2 if graded else 0)


def test_a_player_of_another_package_plays_beside_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.players, "_added", {})
    registry.players.add("stays", lambda network, graph, seed: NoMove(network, graph, seed))
    one = compare([entrant()], ["no_move", "stays"], seed=3)
    assert [player.name for player in one.players] == ["trained", "no_move", "stays"]
    assert one.players[1].accuracy == one.players[2].accuracy
    assert {row.player for row in one.rows["stays"]} == {"stays"}


def episodes() -> list[EpisodeRow]:
    rows = [
        row(label=label, answer=label, scene=f"{label}/{i}", start=f"a{i}", answers=("x", label))
        for label in ("bed", "chair", "door", "lamp", "sofa", "vase")
        for i in range(4)
    ]
    rows += [row(label="tub", answer="tub", views=1, answers=("tub",), path=("a0",)) for _ in range(3)]
    rows += [row(label="cup", answer="vase", right=False, answers=("cup", "vase"), scene="cup/1")]
    return [*rows, row(label="tent", answer="tent", views=9, answers=("x",) * 9, path=("a0",) * 9)]


def test_strips_show_what_is_worth_seeing() -> None:
    rows = episodes()
    chosen = choose(rows)
    assert chosen == choose(rows[::-1])
    assert len(chosen) == 6
    assert [one.right for one in chosen] == [True] * 5 + [False]
    assert len({one.label for one in chosen}) == 6
    assert all(one.answers[0] != one.answer and one.views <= 4 for one in chosen)
    wrong = [one for one in rows if not one.right]
    assert choose(wrong * 8) == wrong * 6
    assert choose([one for one in rows if one.views == 9]) == []
    assert [one.views for one in choose([one for one in rows if one.views == 1])] == [1, 1, 1]


def test_strips_show_views_and_moves() -> None:
    one = row(scene="door/01", target="door/01", path=("a2", "a4", "a4", "a1"), views=4)
    strip = filmstrip(GRAPH, one)
    assert strip.moves == ["wall", "blocked", "half"]
    first = GRAPH.scenes.index("door/01") * 6
    for frame, view in zip(strip.frames, (2, 4, 4, 1), strict=True):
        assert np.array_equal(frame, GRAPH.frames[first + view])


def test_a_filmstrip_of_a_walk_has_boxes_crops_and_a_plan() -> None:
    graph = lattice(side=5, thing=(2.0, 4.5))
    poses = np.array([[float(part) for part in name.split("_")] for name in graph.view_names], np.float32)
    graph = replace(graph, poses=poses)
    path = ("2_0_0", "2_1_0", "2_1_180")
    walked = row(scene="room", target="room/cup", start=path[0], views=3, path=path, answers=("cup",) * 3)
    strip = filmstrip(graph, walked)
    assert strip.moves[0] == "forward"
    assert strip.plan is not None
    assert len(strip.plan.points) == 25
    assert strip.plan.path.tolist() == [[2, 0, 0], [2, 1, 0], [2, 1, 180]]
    near, far = strip.boxes[1], strip.boxes[0]
    assert near[2] > far[2] > 0
    assert not strip.boxes[2].any(), "it is behind"
    assert not strip.crops[2].any()
    one = assemble({"trained": [walked]}, {"trained": 3}, graph, split="test", per_object=None, seed=0)
    assert draw(one).startswith(b"\x89PNG")
    poses[5] = np.nan
    assert filmstrip(graph, walked).plan is not None
    poses[:] = np.nan
    assert filmstrip(graph, walked).plan is None


@pytest.mark.parametrize("views", [1, 9])
def test_a_picture_is_drawn_of_whatever_was_played(views: int) -> None:
    rows = [row(views=views, path=("a0",) * views, answers=("night_stand_with_a_long_name",) * views)] * 3
    one = assemble({"trained": rows}, {"trained": views}, GRAPH, split="test", per_object=None, seed=0)
    assert draw(one).startswith(b"\x89PNG")


@pytest.mark.parametrize("installed", [True, False])
def test_names_that_the_usual_font_lacks_are_drawn_by_another_or_numbered(
    installed: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Without a warning of Python's, which would fail the test; dollars are no formulas."""
    monkeypatch.setattr("activelsd.evaluate.fonts._letters", lambda file: frozenset(map(chr, range(128))))
    assert choose_fonts(["chair"]) == (["DejaVu Sans"], frozenset())
    if installed:
        have = {"Likely CJK": "\u6905\u5b50", "Another": "\u6905"}
        fonts = [SimpleNamespace(name=name, fname=name) for name in ("Another", "Likely CJK")]
        monkeypatch.setattr("matplotlib.font_manager.fontManager.ttflist", fonts)
        monkeypatch.setattr(
            "activelsd.evaluate.fonts._letters", lambda file: frozenset(have.get(file, "chair"))
        )
        assert choose_fonts(["\u6905\u5b50", "chair"]) == (["DejaVu Sans", "Likely CJK"], frozenset())
        return
    rows = [row(player="\u6211", views=2, path=("a0",) * 2, answers=("$\\x$", "\u6905\u5b50"))] * 2
    one = assemble({"\u6211": rows}, {"\u6211": 2}, GRAPH, split="test", per_object=None, seed=0)
    assert draw(one).startswith(b"\x89PNG")
    assert "player 1 is \u6211" in caplog.text
    assert f"class {len(GRAPH.classes) + 2} is \u6905\u5b50" in caplog.text


def test_recognisers_fit_the_screen_and_the_files(comparison: Comparison) -> None:
    def one(name: str, given: str, views: int, published: float | None) -> Recognition:
        return Recognition(
            name=name,
            given=given,
            views=views,
            sets=12 if views == 1 else 1,
            objects=9,
            parameters=2_379_140,
            seconds=6100.0,
            epoch=15,
            accuracy=Interval(1.0, 1.0, 1.0),
            published=published,
        )

    rows = [one("shapenets", "depth, pose", 12, 77.3), one("shapenets", "depth, pose", 1, None)]
    rows += [one("deeppano", "whole shape", 0, 77.6), one("a_recogniser_of_a_long_name", "images", 12, None)]
    shown = replace(comparison, recognised=rows)
    lines = text(shown).splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("Recogniser"))
    assert max(map(len, lines)) <= 80
    assert lines[head].split()[-1] == "Published"
    assert lines[head + 2].split() == [
        *(
            "shapenets",
            "depth,",
            "pose",
            "12",
            "2.38",
            "M",
            "102",
            "min",
            "100.0",
            "[100.0,",
            "100.0]",
            "77.3",
        )
    ]
    assert lines[head + 4].split()[:4] == ["deeppano", "whole", "shape", "-"]
    assert lines[head + 5].startswith("…")
    assert "Fewer views than all: 12 random sets" in " ".join(" ".join(lines).split())
    (first, *_) = result_files.as_json(shown)["recognisers"]
    assert (first["published_percent"], first["published_on"]) == (
        77.3,
        "the paper's Table 2, ModelNet40 meshes",
    )
    assert (first["views"], first["accuracy"], first["accuracy_ci"]) == (12, 1.0, [1.0, 1.0])
