"""Table 3, Figures 3 and 4: counts and averages by slow loops, the paper's numbers, distributions by hand."""

from __future__ import annotations

import csv
import io
import struct
from collections import Counter

import numpy as np
import pytest
import torch

from activelsd.evaluate.certainty import certainty_strips
from activelsd.evaluate.compare import Comparison, Entrant, compare
from activelsd.evaluate.learning import WINDOW, Curve, lacking, learning_curve
from activelsd.evaluate.metrics import EpisodeGroup, by_views
from activelsd.evaluate.paper_pictures import draw_certainty, draw_learning, draw_views_seen
from activelsd.evaluate.protocol import episodes_of
from activelsd.evaluate.views_seen import PUBLISHED, as_csv, as_text, sentence, with_published
from activelsd.policy.lsdnet import LSDNet
from tests.evaluate.worlds import RULES, network, ring

GRAPH = ring(27)


@pytest.fixture(scope="module")
def played() -> tuple[LSDNet, Comparison]:
    net = network(GRAPH)
    entrant = Entrant(name="run", network=net, graph=GRAPH, rules=RULES, world="rings", backend="random")
    return net, compare([entrant])


def test_counts_are_those_of_rows(played: tuple[LSDNet, Comparison]) -> None:
    rows = played[1].rows["run"]
    slow = Counter((row.views, row.right) for row in rows)
    lines = list(csv.DictReader(io.StringIO(as_csv({"run": by_views(rows, 6)}))))
    assert [int(line["views"]) for line in lines] == [1, 2, 3, 4, 5, 6]
    for line in lines:
        views = int(line["views"])
        assert (int(line["right"]), int(line["wrong"])) == (slow[views, True], slow[views, False])


def test_the_papers_own_table_adds_up_and_tells_its_sentence() -> None:
    stack, lstm = PUBLISHED.values()
    assert [sum(one.right for one in groups) for groups in (stack, lstm)] == [573, 619]
    assert [sum(one.episodes for one in groups) for groups in (stack, lstm)] == [760, 760]
    # Table 2's accuracies follow from them.
    assert [round(100 * sum(one.right for one in groups) / 760, 1) for groups in (stack, lstm)] == [
        75.4,
        81.4,
    ]
    assert sentence(lstm) == "right at the first view 67 %, after 2-8 views 85-94 %, after 12 views 83 %"


@pytest.mark.parametrize(
    ("right", "said"),
    [
        ([3], "right at the first view 75 %"),
        ([3, 2], "right at the first view 75 %, after 2 views 50 %"),
        ([3, 2, 4], "right at the first view 75 %, after 2 views 50 %, after 3 views 100 %"),
        ([3, 2, 4, 1], "right at the first view 75 %, after 2-3 views 50-100 %, after 4 views 25 %"),
        (
            [None, None, None],
            "right at the first view no episode, after 2 views no episode, after 3 views no episode",
        ),
    ],
)
def test_the_sentence_for_any_number_of_views(right: list[int | None], said: str) -> None:
    groups = [
        EpisodeGroup(str(views), 0 if one is None else 4, one or 0, 1.0) for views, one in enumerate(right, 1)
    ]
    assert sentence(groups) == said


def test_the_paper_stands_beside_runs_of_twelve_views_only() -> None:
    twelve, six = next(iter(PUBLISHED.values())), [EpisodeGroup("1", 1, 1, 1.0)] * 6
    assert list(with_published({"run": twelve})) == ["run", *PUBLISHED]
    assert all(name.endswith("published, ModelNet40 meshes") for name in PUBLISHED)
    assert list(with_published({"run": twelve, "other": six})) == ["run", "other"]


def test_lines_leave_out_what_no_episode_took_where_views_are_many() -> None:
    groups = [EpisodeGroup(str(i), i % 20 == 3, 0, 1.0) for i in range(1, 41)]
    name, views, *_ = as_text({"run": groups})
    assert (name, views.split()) == ("run", ["views", "3", "23", "all"])


def test_moving_averages_by_slow_loops() -> None:
    rng = np.random.default_rng(0)
    metrics: list[dict[str, float]] = []
    for step in range(60):
        row = {"episodes": int(rng.integers(0, 700)), "reward": rng.random()}
        metrics.append({"step": step, **row, "policy_entropy_loss": rng.random()})
        if step % 7 == 0:
            metrics.append({"step": step, "val/accuracy": 0.5})
    curve = learning_curve(metrics)
    rows = [row for row in metrics if "reward" in row]
    for i in range(1, len(rows)):
        window = []
        for row in reversed(rows[: i + 1]):
            window.append(row)
            if sum(one["episodes"] for one in window) >= WINDOW:
                break
        weights = [one["episodes"] for one in window]
        for found, key in ((curve.reward, "reward"), (curve.entropy, "policy_entropy_loss")):
            assert found[i] == pytest.approx(np.average([one[key] for one in window], weights=weights))
    assert curve.episodes[-1] == sum(row["episodes"] for row in rows)


def test_what_older_metrics_lack_is_named() -> None:
    whole = {"step": 1, "episodes": 3, "reward": 0.0, "policy_entropy_loss": 0.1}
    assert lacking([whole]) is None
    assert lacking([whole, {"step": 2, "val/accuracy": 0.5}]) is None
    assert lacking([{key: whole[key] for key in whole if key != "episodes"}, whole]) == "'episodes'"
    assert lacking([]) == "rows"


def test_distributions_are_those_of_the_views_seen(played: tuple[LSDNet, Comparison]) -> None:
    net, comparison = played
    rows = comparison.rows["run"]
    strips = certainty_strips(net, GRAPH, RULES, rows, episodes_of(GRAPH, "test"))
    assert 0 < len(strips) <= 4
    for strip, classes in strips:
        assert strip.row in rows
        assert (strip.row.views, len(strip.frames), len(classes)) == (4, 4, 4)
        state = net.initial_state(1)
        for view, frame in enumerate(strip.frames):
            looks = {
                "frames": torch.from_numpy(frame)[None, None, None],
                "target": torch.tensor([0.5, 0.5, 1, 1, 1]),
            }
            looks["target"] = looks["target"].expand(1, 1, 1, 5)
            with torch.no_grad():
                output = net(looks, state, torch.tensor([[view == 0]]))
            state, begin = output.state, len(net.tree.branches)
            expected = output.logits[0, 0, begin : begin + classes.shape[1]].softmax(-1)
            np.testing.assert_allclose(classes[view], expected.numpy(), atol=1e-5)
            assert GRAPH.classes[int(classes[view].argmax())] == strip.row.answers[view]


def test_without_an_episode_of_four_views_there_is_no_strip(played: tuple[LSDNet, Comparison]) -> None:
    net, comparison = played
    short = [row for row in comparison.rows["run"] if row.views != 4]
    assert certainty_strips(net, GRAPH, RULES, short, episodes_of(GRAPH, "test")) == []


def size(png: bytes) -> tuple[int, int]:
    assert png.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


def test_pictures_are_drawn_for_odd_names_and_numbers(played: tuple[LSDNet, Comparison]) -> None:
    net, comparison = played
    rows = comparison.rows["run"]
    long = "2026-a_name_with_$dollars$_and_椅子_that_is_longer_than_any_panel_is_wide_" * 2
    many = [EpisodeGroup(str(views), views % 3, views % 2, 1.0) for views in range(1, 41)]
    assert size(draw_views_seen({long: by_views(rows, 6), "rooms": many}))[0] == 990
    assert size(draw_views_seen({"run": by_views(rows, 6)}))[0] == 990
    curve = Curve(np.arange(1.0, 9.0), np.linspace(0, 1, 8), np.linspace(2, 0, 8))
    assert size(draw_learning({f"{long}{i}": curve for i in range(9)}))[0] == 1320
    strips = certainty_strips(net, GRAPH, RULES, rows, episodes_of(GRAPH, "test"))
    tall = size(draw_certainty(strips, GRAPH.classes))[1]
    assert size(draw_certainty(strips[:1], GRAPH.classes))[1] < tall
