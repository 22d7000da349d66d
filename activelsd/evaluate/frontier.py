"""Accuracy against mean views: every player at the same means, wherever its own stop would put it.

Where a player goes and when it answers are taken apart. Its episodes are played to their last view, and
thresholds of its stop are chosen on validation objects. A stop that has one for every number of views gets
those that earn most there for a price per view; a rising price gives a curve from all views to one. Between
two neighbouring choices a player is taken to draw which of them to use in each episode, so that all are
measured at exactly the same mean, with differences paired by episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import ConfigError
from activelsd.evaluate.metrics import Interval, intervals
from activelsd.evaluate.traces import Trace

CHOOSING = "val"
"""The split on which thresholds are chosen."""

MEANS = (1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
"""Mean views at which players are compared, as far as all of them reach."""

PRICES = np.geomspace(1.0, 1e-4, 49)
"""Prices of a view, in right answers, that trace out a curve."""

LEVELS = 200
"""How many quantiles of its scores are tried as a stop's only threshold."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One player's accuracy at each of the frontier's means.

    Attributes:
        name: the player's.
        accuracy: at each mean.
        difference: from the reference at each mean, paired by episode; None for the reference.
        area: mean accuracy between the first and the last mean.
        area_difference: from the reference's; None for the reference.
    """

    name: str
    accuracy: list[Interval]
    difference: list[Interval] | None
    area: Interval
    area_difference: Interval | None


@dataclass(frozen=True, kw_only=True)
class Frontier:
    """Every player's curve over the same means; the first is the reference.

    Attributes:
        means: mean views at which all were measured.
        curves: the players'.
        shortest: the player that sees the fewest views if it never answers, which ends the means.
        reached: its mean views then.
    """

    means: tuple[float, ...]
    curves: list[Curve]
    shortest: str
    reached: float


def frontier(
    traces: dict[str, tuple[str, Trace, Trace]], *, seed: int, means: Sequence[float] = MEANS
) -> Frontier:
    """Compares players at equal mean views.

    Args:
        traces: by player, the reference first: the name of its stop, its episodes with validation objects,
            and those that it is measured on, which are the same for all.
        seed: of resampling.
        means: wanted mean views; those that some player cannot reach are left out.

    Raises:
        ConfigError: a player reaches none of the means.
    """
    reached = {name: float(test.length.mean()) for name, (_, _, test) in traces.items()}
    shortest = min(reached, key=lambda name: reached[name])
    means = tuple(mean for mean in means if mean <= reached[shortest])
    if not means:
        raise ConfigError(
            f"{shortest} sees {reached[shortest]:.2f} views at most on average, too few for --frontier; leave"
            " it out here."
        )
    right = {name: at_means(*one, means) for name, one in traces.items()}
    objects = next(iter(traces.values()))[2].objects
    widths = np.diff(means) / (means[-1] - means[0]) if len(means) > 1 else np.zeros(0)
    weights = (np.append(widths, 0) + np.append(0, widths)) / 2 if len(means) > 1 else np.ones(1)

    def measured(values: NDArray[np.float64]) -> list[Interval]:
        return intervals(np.column_stack([values, values @ weights]), objects, seed=seed)

    curves, reference = [], next(iter(right))
    for name, values in right.items():
        *accuracy, area = measured(values)
        *difference, apart = measured(values - right[reference])
        own = name == reference
        curves.append(
            Curve(
                name=name,
                accuracy=accuracy,
                difference=None if own else difference,
                area=area,
                area_difference=None if own else apart,
            )
        )
    return Frontier(means=means, curves=curves, shortest=shortest, reached=reached[shortest])


def at_means(stop: str, val: Trace, test: Trace, means: Sequence[float]) -> NDArray[np.float64]:
    """Chances of a right answer, (N, M), of every test episode at each mean, which must be within reach."""
    stops = [stop_at(test, stop, some) for some in _choices(val, stop)]
    reached = np.maximum.accumulate([float(some.mean()) for some in stops])
    rows, columns = np.arange(len(test.length)), []
    for mean in means:
        above = min(max(1, int(np.searchsorted(reached, mean))), len(stops) - 1)
        low, high = stops[above - 1], stops[above]
        gap = float(high.mean() - low.mean())
        share = (mean - float(low.mean())) / gap if gap > 0 else 0.0
        columns.append((1 - share) * test.right[rows, low - 1] + share * test.right[rows, high - 1])
    return np.stack(columns, 1)


def nearest(val: Trace, stop: str, mean: float) -> NDArray[np.float64]:
    """Those thresholds (T,) with which the mean views of validation objects are nearest to a wanted mean."""
    return min(_choices(val, stop), key=lambda some: abs(float(stop_at(val, stop, some).mean()) - mean))


def _choices(val: Trace, stop: str) -> list[NDArray[np.float64]]:
    """Thresholds (T,) from those that stop at the first view to those that stop at the last."""
    views = val.right.shape[1]
    if stop in val.by_view:
        between = [thresholds(val, stop, price) for price in PRICES]
    else:
        levels = np.unique(np.quantile(val.scores[stop], np.linspace(0, 1, LEVELS)))
        between = [np.full(views, level) for level in levels]
    return [np.full(views, -np.inf), *between, np.full(views, np.inf)]


def thresholds(trace: Trace, stop: str, price: float) -> NDArray[np.float64]:
    """Thresholds (T,) of a stop that earn most: 1 for a right answer, minus a price for every further view.

    From the last view backwards: given those of later views, each is where answering begins to earn more than
    going on, among the episodes that have not ended.
    """
    scores, right = trace.scores[stop], trace.right.astype(np.float64)
    chosen = np.full(right.shape[1], np.inf)
    worth = right[:, -1]
    for view in range(right.shape[1] - 1, 0, -1):
        going = trace.length > view
        after = worth[going] - price
        now, score = right[going, view - 1], scores[going, view - 1].astype(np.float64)
        order = np.argsort(-score, kind="stable")
        gains = np.cumsum((now - after)[order])
        # A threshold takes all episodes of its score, so only the last of equals may be the end.
        ends = np.append(score[order][1:] < score[order][:-1], True)
        gains = np.where(ends, gains, -np.inf)
        best = int(gains.argmax()) if len(gains) else -1
        if best >= 0 and gains[best] > 0:
            chosen[view - 1] = score[order][best]
        worth = right[:, view - 1].copy()
        worth[going] = np.where(score >= chosen[view - 1], now, after)
    return chosen


def stop_at(trace: Trace, stop: str, chosen: NDArray[np.float64]) -> NDArray[np.int64]:
    """Views (N,) after which every episode ends: the first that reaches its threshold, or its last."""
    ends = trace.scores[stop] >= chosen
    ends[np.arange(len(ends)), trace.length - 1] = True
    first: NDArray[np.int64] = ends.argmax(1) + 1
    return first
