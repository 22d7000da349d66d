"""Figures by hand and by slow loops, and intervals that hold what they promise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from activelsd.evaluate import metrics
from activelsd.evaluate.metrics import (
    EpisodeGroup,
    by_allowed,
    by_class,
    by_difficulty,
    by_views,
    figure_interval,
    gain_closed,
    intervals,
    resampled_means,
    score,
    spl,
)
from activelsd.evaluate.protocol import EpisodeRow
from tests.evaluate.worlds import row

ROWS = [
    row(views=1, answers=("cup",), path=("a0",)),
    row(views=3, answers=("cup", "door", "cup"), path=("a0", "a1", "a2")),
    row(target="door/01", label="door", answer="cup", right=False, answers=("door", "cup")),
    row(target="door/01", label="door", answer="door", views=1, answers=("door",)),
]


def test_a_wrong_answer_counts_all_views() -> None:
    scores = score(ROWS, 12)
    assert scores.right.tolist() == [True, True, False, True]
    assert scores.views.tolist() == [1, 3, 2, 1]
    assert scores.steps.tolist() == [1, 3, 12, 1]
    assert scores.objects.tolist() == [0, 0, 1, 1]
    assert scores.values.mean(0).tolist() == [0.75, 1.75, 4.25]


def test_groups_by_hand() -> None:
    assert by_class(ROWS) == [EpisodeGroup("cup", 2, 2, 2.0), EpisodeGroup("door", 2, 1, 1.5)]
    assert by_views(ROWS, 4) == [
        EpisodeGroup("1", 2, 2, 1.0),
        EpisodeGroup("2", 1, 0, 2.0),
        EpisodeGroup("3", 1, 1, 3.0),
        EpisodeGroup("4", 0, 0, 0.0),
    ]
    assert by_allowed(ROWS, 4) == [
        EpisodeGroup("1", 4, 4, 1.0),
        EpisodeGroup("2", 4, 2, 1.5),
        EpisodeGroup("3", 4, 3, 1.75),
        EpisodeGroup("4", 4, 3, 1.75),
    ]


def data(objects: int = 7, most: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Objects with unlike numbers of episodes, whose episodes are alike."""
    rng = np.random.default_rng(2)
    number = np.repeat(np.arange(objects), rng.integers(1, most, objects))
    values = rng.normal(size=(objects, 2))[number] + 0.3 * rng.normal(size=(len(number), 2))
    return values, rng.permutation(number)


def test_resampling_by_repeating_objects_one_by_one() -> None:
    values, objects = data()
    fast = resampled_means(values, objects, seed=4, resamples=50)
    rng = np.random.default_rng(4)
    for means in fast:
        times = rng.multinomial(7, np.full(7, 1 / 7))
        episodes = [values[objects == o] for o in range(7) for _ in range(times[o])]
        assert means == pytest.approx(np.concatenate(episodes).mean(0))


def test_blocks_of_resamples_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    values, objects = data()
    whole = resampled_means(values, objects, seed=4, resamples=50)
    monkeypatch.setattr(metrics, "_BLOCK", 7 * 8 + 3)
    assert np.array_equal(resampled_means(values, objects, seed=4, resamples=50), whole)


def test_intervals_repeat_and_hold_the_mean() -> None:
    values, objects = data()
    first = intervals(values, objects, seed=0)
    assert first == intervals(values, objects, seed=0)
    assert first != intervals(values, objects, seed=1)
    for mean, low, high in first:
        assert low < mean < high
    assert intervals(np.full((6, 1), 1 / 3), np.arange(6) // 2, seed=0) == [pytest.approx((1 / 3,) * 3)]


def test_width_is_that_of_the_normal_approximation() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(400, 1))
    mean, low, high = intervals(np.repeat(values, 12, 0), np.repeat(np.arange(400), 12), seed=0)[0]
    error = 1.96 * values.std() / np.sqrt(400)
    assert (mean - low, high - mean) == pytest.approx((error, error), rel=0.1)


def test_intervals_cover_the_truth_though_episodes_of_an_object_are_alike() -> None:
    """Counting episodes as independent, as is often done, covers far less than 95 %."""
    rng, truth, covered, naive = np.random.default_rng(11), 0.7, 0, 0
    objects = np.repeat(np.arange(40), 12)
    for trial in range(300):
        easy = rng.beta(1.4, 0.6, 40)  # mean 0.7
        right = (rng.random(480) < easy[objects]).astype(float)[:, None]
        for clusters, add in ((objects, True), (np.arange(480), False)):
            _, low, high = intervals(right, clusters, seed=trial, resamples=300)[0]
            covered += add and low <= truth <= high
            naive += not add and low <= truth <= high
    assert 0.90 <= covered / 300 <= 0.98
    assert naive / 300 < 0.75


def test_paired_differences_are_narrower_and_none_is_none() -> None:
    rng = np.random.default_rng(3)
    objects = np.repeat(np.arange(50), 4)
    one = (rng.random(200) < rng.beta(1, 1, 50)[objects]).astype(float)
    other = np.where(rng.random(200) < 0.05, 1.0, one)
    apart = intervals(np.stack([one, other, other - one], 1), objects, seed=0)
    widths = [high - low for _, low, high in apart]
    assert widths[2] < 0.5 * min(widths[:2])
    assert apart[2].mean == pytest.approx(apart[1].mean - apart[0].mean)
    assert apart[2].low > 0
    assert intervals((one - one)[:, None], objects, seed=0) == [(0.0, 0.0, 0.0)]


def test_gain_closed() -> None:
    objects = np.arange(100)
    floor, ceiling = objects < 50, objects < 90
    closed = gain_closed(objects < 80, floor, ceiling, objects, seed=0)
    assert closed is not None
    assert closed.mean == pytest.approx(0.75)
    assert 0.5 < closed.low < 0.75 < closed.high < 1
    assert gain_closed(ceiling, floor, ceiling, objects, seed=0) == pytest.approx((1.0, 1.0, 1.0))
    assert gain_closed(ceiling, floor, objects < 51, objects, seed=0) is None
    assert gain_closed(ceiling, ceiling, floor, objects, seed=0) is None


def test_spl_by_hand() -> None:
    rows = [
        row(views=1, oracle_views=3, answers=("cup",)),  # right before the oracle is there: 1
        row(views=4, oracle_views=2, answers=("x",) * 4),  # twice as long: 1/2
        row(target="door/01", views=2, oracle_views=2, right=False, answers=("x", "x")),  # wrong: 0
        row(target="door/01", views=2, oracle_views=-1, answers=("x", "x")),  # no way there: left out
    ]
    assert spl(rows) == pytest.approx((1 + 0.5 + 0) / 3)
    interval = figure_interval(spl, rows, seed=0)
    assert interval is not None
    assert interval == (spl(rows), 0, 0.75)
    for unknown in (ROWS, rows[3:]):
        assert np.isnan(spl(unknown))
        assert figure_interval(spl, unknown, seed=0) is None


def accuracy(rows: Sequence[EpisodeRow]) -> float:
    return float(np.mean([row.right for row in rows]))


def test_a_figure_is_resampled_as_the_means_are() -> None:
    """Whole objects with all their episodes, the same ones that `intervals` draws."""
    rng = np.random.default_rng(3)
    rows = [
        row(target=f"cup/{i:02d}", right=bool(rng.random() < easy))
        for i, easy in enumerate(rng.random(20))
        for _ in range(rng.integers(1, 9))
    ]
    rows = [rows[i] for i in rng.permutation(len(rows))]
    scores = score(rows, 12)
    for seed in (0, 1):
        expected = intervals(scores.values, scores.objects, seed=seed, resamples=200)[0]
        assert figure_interval(accuracy, rows, seed=seed, resamples=200) == pytest.approx(expected)


def test_resamples_in_which_a_figure_is_not_known_are_left_out() -> None:
    def views_when_right(rows: Sequence[EpisodeRow]) -> float | None:
        return sum(r.views for r in rows) if any(r.right for r in rows) else None

    rows = [row(target="a", views=3), row(target="b", views=5, right=False)]
    # Of the samples aa, ab, ba, bb the last has no right answer.
    assert figure_interval(views_when_right, rows, seed=0) == (8, 6, 8)
    for unknown in (None, float("nan"), float("inf")):
        assert figure_interval(lambda rows, value=unknown: value, rows, seed=0) is None


def test_difficulties_stand_in_their_order() -> None:
    rows = [row(difficulty=name) for name in ("hard", "easy", "hard")]
    rows += [row(difficulty="moderate", right=False, views=3), row(difficulty=None)]
    names = ("easy", "moderate", "hard")
    assert by_difficulty(rows, names) == [
        EpisodeGroup("easy", 1, 1, 2.0),
        EpisodeGroup("moderate", 1, 0, 3.0),
        EpisodeGroup("hard", 2, 2, 2.0),
    ]
    assert [group.name for group in by_difficulty([row(difficulty="3"), row(difficulty="1")])] == ["1", "3"]
    assert by_difficulty(ROWS) == []
