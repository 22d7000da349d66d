"""Rewards and certainty during training, by episodes played: Figure 3 of the paper, from a run's metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

WINDOW = 1000
"""Episodes of the moving average. The paper averages over 1,000 "iterations", and does not say what one
is. A reward comes with every episode, and GA3C, which it trains with, counts and logs episodes."""

NEEDED = ("episodes", "reward", "policy_entropy_loss")


class Curve(NamedTuple):
    """What Figure 3 shows, at the R rows of metrics of a run."""

    episodes: NDArray[np.float64]  # (R,) played until then
    reward: NDArray[np.float64]  # (R,) of an episode, averaged over the last 1,000 or more
    entropy: NDArray[np.float64]  # (R,) "policy entropy loss": -log max pi, averaged over the same


def lacking(metrics: Sequence[Mapping[str, float]]) -> str | None:
    """Returns what a run's metrics lack for a curve, because an older version wrote them; None if nothing."""
    rows = _of_training(metrics)
    missing = [key for key in NEEDED if not all(key in row for row in rows)]
    return f"'{missing[0]}'" if missing else None if rows else "rows"


def learning_curve(metrics: Sequence[Mapping[str, float]]) -> Curve:
    """Returns the moving averages of a run over its last 1,000 episodes, at every row of metrics.

    A row holds the means of the episodes since the row before, so the window is as many rows as have at least
    1,000 episodes together, or all rows until then. If a row has fewer, which `train.log_every` decides, the
    window is nearly as narrow as the paper's.

    Args:
        metrics: rows of `metrics.jsonl` that lack nothing; those of evaluations are passed over.
    """
    rows = _of_training(metrics)
    counts, rewards, entropies = (np.array([row[key] for row in rows], np.float64) for key in NEEDED)
    return Curve(counts.cumsum(), _moving(rewards, counts), _moving(entropies, counts))


def _of_training(metrics: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    return [row for row in metrics if "reward" in row]


def _moving(means: NDArray[np.float64], counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over as few of the last rows as have `WINDOW` episodes; each row's weight is its episodes."""
    total, sums = (np.concatenate([[0.0], values.cumsum()]) for values in (counts, counts * means))
    ends = np.arange(1, len(total))
    begins = np.maximum(np.searchsorted(total, total[1:] - WINDOW, side="right") - 1, 0)
    begins = np.minimum(begins, ends - 1)
    means_over: NDArray[np.float64] = (sums[ends] - sums[begins]) / np.maximum(
        total[ends] - total[begins], 1.0
    )
    return means_over
