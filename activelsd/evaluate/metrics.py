"""Figures of episodes as pure functions of rows and arrays, with intervals by resampling objects."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.evaluate.protocol import EpisodeRow

CONFIDENCE = 0.95
RESAMPLES = 4000
FIGURE_RESAMPLES = 400
"""Fewer for registered figures, which are Python functions: SPL takes 3 s for 8 players x 3,840 episodes."""

_BLOCK = 1_000_000  # numbers in one block of resampling weights, 8 MB

Figure = Callable[[Sequence[EpisodeRow]], "float | None"]
"""A figure of one player's episodes; NaN or None if they do not tell it."""


class Interval(NamedTuple):
    """A mean or figure and its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


class Scores(NamedTuple):
    """N episodes as arrays."""

    right: NDArray[np.bool_]  # (N,)
    views: NDArray[np.int64]  # (N,) views seen
    steps: NDArray[np.int64]  # (N,) steps-to-recognise: views if right, T if wrong
    objects: NDArray[np.int64]  # (N,) index of the target, 0 … O-1

    @property
    def values(self) -> NDArray[np.float64]:
        """Accuracy, views and steps of every episode, (N, 3)."""
        return np.stack([self.right, self.views, self.steps], 1).astype(np.float64)


class EpisodeGroup(NamedTuple):
    """Counts of the episodes that share a class, a difficulty or a number of views."""

    name: str
    episodes: int
    right: int
    views: float  # mean views seen


def score(rows: Sequence[EpisodeRow], max_views: int) -> Scores:
    """Turns rows into arrays; a wrong answer counts `max_views` steps."""
    right = np.array([row.right for row in rows])
    views = np.array([row.views for row in rows])
    _, objects = np.unique([row.target for row in rows], return_inverse=True)
    return Scores(right, views, np.where(right, views, max_views), objects)


def resampled_means(
    values: NDArray[np.float64],
    objects: NDArray[np.int64],
    *,
    seed: int,
    resamples: int = RESAMPLES,
) -> NDArray[np.float64]:
    """Returns the means over bootstrap samples of whole objects, (R, F).

    Episodes of one object are not independent, so whole objects are drawn with replacement, each with all
    its episodes (Davison and Hinkley 1997, section 3.8). Columns share the draws, so that their differences
    are paired.

    Args:
        values: (N, F), values of every episode.
        objects: (N,), index of each episode's object, 0 … O-1.
        seed: of the draws.
        resamples: R.
    """
    number = int(objects.max()) + 1
    sums = np.stack([np.bincount(objects, column, number) for column in values.T], 1)
    totals = np.concatenate([sums, np.bincount(objects, minlength=number)[:, None]], 1)
    rng = np.random.default_rng(seed)
    block = max(1, _BLOCK // number)
    means = []
    for begin in range(0, resamples, block):
        # A sample is fixed by how often each object is drawn.
        draws = min(block, resamples - begin)
        drawn = rng.multinomial(number, np.full(number, 1 / number), draws) @ totals
        means.append(drawn[:, :-1] / drawn[:, -1:])
    return np.concatenate(means)


def intervals(
    values: NDArray[np.float64],
    objects: NDArray[np.int64],
    *,
    seed: int,
    resamples: int = RESAMPLES,
) -> list[Interval]:
    """Returns the mean and 95 % percentile interval of every column of `values` (N, F), resampling objects.

    If all objects are alike, for example all answered right, the interval is a point: the sample cannot tell
    how far off it may be.
    """
    low, high = _bounds(resampled_means(values, objects, seed=seed, resamples=resamples))
    bounds = zip(values.mean(0).tolist(), low.tolist(), high.tolist(), strict=True)
    return [_interval(*bound) for bound in bounds]


def figure_interval(
    figure: Figure, rows: Sequence[EpisodeRow], *, seed: int, resamples: int = FIGURE_RESAMPLES
) -> Interval | None:
    """Returns a figure of one player's episodes and its 95 % percentile interval; None if it is not known.

    Resamples whole objects with the draws of `resampled_means`, and computes the figure anew for each; those
    for which it is not known are left out.
    """
    value = _known(figure(rows))
    if math.isnan(value):
        return None
    by_object: dict[str, list[EpisodeRow]] = {target: [] for target in sorted({row.target for row in rows})}
    for row in rows:
        by_object[row.target].append(row)
    groups, number = list(by_object.values()), len(by_object)
    resampled = []
    for times in np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), resamples):
        drawn = np.repeat(np.arange(number), times).tolist()
        resampled.append(_known(figure(list(chain.from_iterable(groups[i] for i in drawn)))))
    known = np.array([x for x in resampled if not math.isnan(x)] or [value])
    return _interval(value, *_bounds(known).tolist())


def _known(value: float | None) -> float:
    """The value as a float; NaN for None and for what no file can hold."""
    return math.nan if value is None or not math.isfinite(value) else float(value)


def _interval(mean: float, low: float, high: float) -> Interval:
    # Rounding of sums may put a mean that no resample changes slightly outside its own interval.
    return Interval(mean, min(mean, low), max(mean, high))


def _bounds(resampled: NDArray[np.float64]) -> NDArray[np.float64]:
    tail = 100 * (1 - CONFIDENCE) / 2
    return np.percentile(resampled, [tail, 100 - tail], axis=0)


def gain_closed(
    trained: NDArray[np.bool_],
    floor: NDArray[np.bool_],
    ceiling: NDArray[np.bool_],
    objects: NDArray[np.int64],
    *,
    seed: int,
) -> Interval | None:
    """Returns (trained - no_move) / (all_views - no_move) for accuracies; 1 means as good as `all_views`.

    Args:
        trained: (N,), which episodes the run answered right.
        floor: (N,), the same for `no_move`.
        ceiling: (N,), the same for `all_views`.
        objects: (N,), index of each episode's object.
        seed: of the draws.

    Returns:
        The fraction and its interval; None if the interval of all_views - no_move reaches 0.
    """
    values = np.stack([trained.astype(np.float64) - floor, ceiling.astype(np.float64) - floor], 1)
    resampled = resampled_means(values, objects, seed=seed)
    if _bounds(resampled)[0, 1] <= 0:
        return None
    apart = resampled[:, 1] > 0
    low, high = _bounds(resampled[apart, 0] / resampled[apart, 1])
    mean = values.mean(0)
    return Interval(float(mean[0] / mean[1]), float(low), float(high))


def spl(rows: Sequence[EpisodeRow]) -> float:
    """Success weighted by path length (Anderson et al. 2018): a right answer counts oracle_views / views.

    It counts at most 1, and a wrong answer 0. Episodes whose target can be shown well from nowhere are left
    out. NaN if the oracle's views are known for no episode.
    """
    shares = [
        row.right * row.oracle_views / max(row.views, row.oracle_views)
        for row in rows
        if row.oracle_views is not None and row.oracle_views > 0
    ]
    return float(np.mean(shares)) if shares else math.nan


def by_difficulty(rows: Sequence[EpisodeRow], names: Sequence[str] | None = None) -> list[EpisodeGroup]:
    """Groups episodes by the difficulty of their first view, easiest first; leaves out those without one.

    Args:
        rows: of one player.
        names: of the difficulties in their order; None if they are numbers.
    """
    found = {row.difficulty for row in rows if row.difficulty is not None}
    order = sorted(found) if names is None else [name for name in names if name in found]
    return _groups({name: [row for row in rows if row.difficulty == name] for name in order})


def by_class(rows: Sequence[EpisodeRow]) -> list[EpisodeGroup]:
    """Groups episodes by label, in order of name."""
    names = sorted({row.label for row in rows})
    return _groups({name: [row for row in rows if row.label == name] for name in names})


def by_views(rows: Sequence[EpisodeRow], max_views: int) -> list[EpisodeGroup]:
    """Groups episodes by views seen, 1 … T (the paper's Table 3)."""
    return _groups({str(n): [row for row in rows if row.views == n] for n in range(1, max_views + 1)})


def by_allowed(rows: Sequence[EpisodeRow], max_views: int) -> list[EpisodeGroup]:
    """Counts the same episodes as if only 1 … T views had been allowed.

    This is exact without playing again: up to its last view an episode does not depend on the views allowed,
    and the rows hold the answer that would have been given at every view.
    """
    groups = []
    for allowed in range(1, max_views + 1):
        views = [min(row.views, allowed) for row in rows]
        right = sum(row.answers[n - 1] == row.label for row, n in zip(rows, views, strict=True))
        groups.append(EpisodeGroup(str(allowed), len(rows), right, float(np.mean(views))))
    return groups


def _groups(rows: dict[str, list[EpisodeRow]]) -> list[EpisodeGroup]:
    return [
        EpisodeGroup(
            name,
            len(some),
            sum(row.right for row in some),
            float(np.mean([row.views for row in some])) if some else 0.0,
        )
        for name, some in rows.items()
    ]
