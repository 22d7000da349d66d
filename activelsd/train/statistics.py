"""Sums over the steps since the last row of metrics; they stay on the device and are read once per row."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.policy.lsdnet import LSDNet
from activelsd.train.rollout import Rollout


class Counts(NamedTuple):
    """Amounts that an update adds to the sums."""

    steps: int
    names: tuple[str, ...]
    values: Tensor  # (names,) float64


@torch.no_grad()
def counts(
    rollout: Rollout, network: LSDNet, losses: Mapping[str, Tensor], places: Mapping[str, slice]
) -> Counts:
    """Counts of a rollout; `places` gives the columns of each world if there are several."""
    ended = rollout.terminated | rollout.truncated
    # Each (L, B).
    each = {
        "steps": torch.ones_like(rollout.rewards),
        "episodes": ended,
        "right": ended & rollout.right,
        "views": rollout.views * ended,
        "reward": rollout.rewards,
    }
    if rollout.output is not None and len(network.tree.branches) > 1:
        policy = network.distribution(rollout.output.logits, rollout.mask)
        moving = policy.branch_probs()[..., 1:].sum(-1)  # all branches but `classify`, which is the first
        free = rollout.mask[..., network.tree.moves].any(-1)
        named_right = policy.class_log_probs().argmax(-1) == rollout.labels
        # -log max pi, the paper's Figure 3, "policy entropy loss".
        each |= {
            "free": free,
            "navigate": moving * free,
            "first": rollout.first,
            "right_at_first": named_right & rollout.first,
            "surprise": -policy.probs.amax(-1).log(),
        }
    sums = {
        world + name: count[:, place].sum(dtype=torch.float64)
        for world, place in _with_all(places).items()
        for name, count in each.items()
    }
    sums |= losses
    return Counts(ended.numel(), tuple(sums), torch.stack([value.double() for value in sums.values()]))


class Statistics:
    """Metrics of a window, for progress line and logs: means per episode and per step.

    If there are several worlds, there are metrics of all steps, and each world's own under its name.
    """

    def __init__(self, places: Mapping[str, slice] | None = None) -> None:
        """Begin a window; `places` as in `counts`."""
        self._places = _with_all(places or {})
        self._names: tuple[str, ...] = ()
        self._sums: Tensor | float = 0.0
        self._updates = 0

    def add(self, update: Counts) -> None:
        """Add the counts of an update."""
        self._names, self._sums = update.names, self._sums + update.values
        self._updates += 1

    def read(self) -> dict[str, float]:
        """Returns the window's metrics and begins the next window."""
        assert isinstance(self._sums, Tensor), "nothing was added"
        sums = dict(zip(self._names, self._sums.tolist(), strict=True))
        updates, self._updates, self._sums = self._updates, 0, 0.0
        metrics: dict[str, float] = {}
        for world in self._places:
            steps, ended = max(sums.pop(f"{world}steps"), 1), sums.pop(f"{world}episodes")
            episodes = max(ended, 1)
            free, first = sums.pop(f"{world}free", 0.0), sums.pop(f"{world}first", 0.0)
            metrics |= {
                f"{world}episodes": ended,
                f"{world}reward": sums.pop(f"{world}reward") / episodes,
                f"{world}accuracy": sums.pop(f"{world}right") / episodes,
                f"{world}views": sums.pop(f"{world}views") / episodes,
                f"{world}navigate": sums.pop(f"{world}navigate", 0.0) / max(free, 1),
                f"{world}accuracy_at_first_view": sums.pop(f"{world}right_at_first", 0.0) / max(first, 1),
                f"{world}policy_entropy_loss": sums.pop(f"{world}surprise", 0.0) / steps,
            }
        return metrics | {name: value / updates for name, value in sums.items()}


def _with_all(places: Mapping[str, slice]) -> dict[str, slice]:
    """Columns by the prefix of their metrics' names, first those of all worlds."""
    return {"": slice(None)} | {f"{world}/": place for world, place in places.items()}
