"""What is counted of episodes: pure functions of rows and arrays, intervals by resampling objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.evaluate.protocol import EpisodeRow

CONFIDENCE = 0.95
RESAMPLES = 4000
_BLOCK = 1_000_000  # numbers in one block of resampling weights, 8 MB


class Interval(NamedTuple):
    """A mean and its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


class Scores(NamedTuple):
    """N episodes as arrays."""

    right: NDArray[np.bool_]  # (N,)
    views: NDArray[np.int64]  # (N,) views seen
    steps: NDArray[np.int64]  # (N,) steps-to-recognise: views where right, T where wrong
    objects: NDArray[np.int64]  # (N,) number of the target, 0 … O-1

    @property
    def values(self) -> NDArray[np.float64]:
        """(N, 3) accuracy, views and steps of every episode."""
        return np.stack([self.right, self.views, self.steps], 1).astype(np.float64)


class EpisodeGroup(NamedTuple):
    """Episodes that have something in common."""

    name: str
    episodes: int
    right: int
    views: float  # mean


def score(rows: Sequence[EpisodeRow], max_views: int) -> Scores:
    """Episodes as arrays; a wrong answer counts `max_views` steps."""
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
    """Means over bootstrap samples of whole objects.

    Episodes of one object are not independent, so it is objects that are drawn, with replacement and all
    their episodes (Davison and Hinkley 1997, section 3.8). Columns share the draws, which is what makes
    differences of columns paired.

    Args:
        values: (N, F) of every episode.
        objects: (N,) number of each episode's object, 0 … O-1.
        seed: of the draws.
        resamples: R.

    Returns:
        (R, F).
    """
    number = int(objects.max()) + 1
    sums = np.stack([np.bincount(objects, column, number) for column in values.T], 1)
    totals = np.concatenate([sums, np.bincount(objects, minlength=number)[:, None]], 1)
    rng = np.random.default_rng(seed)
    block = max(1, _BLOCK // number)
    means = []
    for begin in range(0, resamples, block):
        # How often each object is drawn is all that counts.
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
    """Mean and 95 % percentile interval of every column of `values` (N, F), resampling objects.

    Where all objects are alike, for example all answered right, the interval is a point: nothing in the
    sample says how far off it may be.
    """
    low, high = _bounds(resampled_means(values, objects, seed=seed, resamples=resamples))
    means = values.mean(0)
    # Rounding of sums may put a mean that no resample changes a hair outside its own interval.
    return [
        Interval(mean, min(mean, a), max(mean, b))
        for mean, a, b in zip(means.tolist(), low.tolist(), high.tolist(), strict=True)
    ]


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
    """How much of the way from one accuracy to a higher one a third goes: 1 is all of it.

    Args:
        trained: (N,) right or wrong.
        floor: (N,) of `no_move` on the same episodes.
        ceiling: (N,) of `all_views`.
        objects: (N,).
        seed: of the draws.

    Returns:
        The fraction and its interval, or None where the ceiling is not surely above the floor.
    """
    values = np.stack([trained.astype(np.float64) - floor, ceiling.astype(np.float64) - floor], 1)
    resampled = resampled_means(values, objects, seed=seed)
    if _bounds(resampled)[0, 1] <= 0:
        return None
    apart = resampled[:, 1] > 0
    low, high = _bounds(resampled[apart, 0] / resampled[apart, 1])
    mean = values.mean(0)
    return Interval(float(mean[0] / mean[1]), float(low), float(high))


def path_lengths(rows: Sequence[EpisodeRow], *, seed: int) -> Interval | None:
    """Success weighted by path length (SPL, Anderson et al. 2018), with views for its lengths.

    A right answer counts the oracle's views over those seen, at most 1; a wrong one counts 0. Episodes whose
    target can be shown well from nowhere are left out; None where nobody knows the oracle's views.
    """
    known = [row for row in rows if row.oracle_views is not None and row.oracle_views > 0]
    if not known:
        return None
    shares = [row.right * (row.oracle_views or 0) / max(row.views, row.oracle_views or 0) for row in known]
    _, objects = np.unique([row.target for row in known], return_inverse=True)
    return intervals(np.array(shares)[:, None], objects, seed=seed)[0]


def by_difficulty(rows: Sequence[EpisodeRow], names: Sequence[str] | None = None) -> list[EpisodeGroup]:
    """Episodes by the difficulty of their first view, easiest first; none where it is not graded.

    Args:
        rows: of one player.
        names: of the difficulties in their order; None where they are numbers.
    """
    found = {row.difficulty for row in rows if row.difficulty is not None}
    order = sorted(found) if names is None else [name for name in names if name in found]
    return _groups({name: [row for row in rows if row.difficulty == name] for name in order})


def by_class(rows: Sequence[EpisodeRow]) -> list[EpisodeGroup]:
    """Episodes by label, in order of name."""
    names = sorted({row.label for row in rows})
    return _groups({name: [row for row in rows if row.label == name] for name in names})


def by_views(rows: Sequence[EpisodeRow], max_views: int) -> list[EpisodeGroup]:
    """Episodes by views seen, 1 … T (the paper's Table 3)."""
    return _groups({str(n): [row for row in rows if row.views == n] for n in range(1, max_views + 1)})


def by_allowed(rows: Sequence[EpisodeRow], max_views: int) -> list[EpisodeGroup]:
    """The same episodes had only 1 … T views been allowed.

    Exact without playing again: up to its last view an episode goes as it would with more allowed, and there
    the answer is the one it would have named, which the rows keep for every view.
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
