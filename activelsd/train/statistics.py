"""Sums over the steps since the last row of metrics, kept on the device and read once a row."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.envs.actions import NAVIGATE
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.rollout import Rollout


class Counts(NamedTuple):
    """What an update adds to the sums."""

    steps: int
    names: tuple[str, ...]
    values: Tensor  # (names,) float64


@torch.no_grad()
def counts(
    rollout: Rollout, network: LSDNet, losses: Mapping[str, Tensor], places: Mapping[str, slice]
) -> Counts:
    """Of a rollout that was learned from; `places` are the columns that each of several worlds has."""
    ended = rollout.terminated | rollout.truncated
    # Each (L, B).
    each = {
        "steps": torch.ones_like(rollout.rewards),
        "episodes": ended,
        "right": ended & rollout.right,
        "views": rollout.views * ended,
        "reward": rollout.rewards,
    }
    if rollout.output is not None and NAVIGATE in network.tree.branches:
        policy = network.distribution(rollout.output.logits, rollout.mask)
        branch = policy.branch_probs()[..., network.tree.branches.index(NAVIGATE)]
        free = rollout.mask[..., network.tree.span(NAVIGATE)].any(-1)
        named_right = policy.class_log_probs().argmax(-1) == rollout.labels
        # -log max pi, the paper's Figure 3, "policy entropy loss".
        each |= {
            "free": free,
            "navigate": branch * free,
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
    """What the progress line and the logs show: rates per episode and per step over a window.

    Of several worlds there are the metrics of all steps, and each world's own below its name.
    """

    def __init__(self, places: Mapping[str, slice] | None = None) -> None:
        """Begin a window; `places` as of `counts`."""
        self._places = _with_all(places or {})
        self._names: tuple[str, ...] = ()
        self._sums: Tensor | float = 0.0
        self._updates = 0

    def add(self, update: Counts) -> None:
        """Add an update's."""
        self._names, self._sums = update.names, self._sums + update.values
        self._updates += 1

    def read(self) -> dict[str, float]:
        """The window's metrics, and begin the next window."""
        assert isinstance(self._sums, Tensor), "nothing was added"
        sums = dict(zip(self._names, self._sums.tolist(), strict=True))
        updates, self._updates, self._sums = self._updates, 0, 0.0
        metrics: dict[str, float] = {}
        for world in self._places:
            steps, episodes = max(sums.pop(f"{world}steps"), 1), max(sums.pop(f"{world}episodes"), 1)
            free, first = sums.pop(f"{world}free", 0.0), sums.pop(f"{world}first", 0.0)
            metrics |= {
                f"{world}reward": sums.pop(f"{world}reward") / episodes,
                f"{world}accuracy": sums.pop(f"{world}right") / episodes,
                f"{world}views": sums.pop(f"{world}views") / episodes,
                f"{world}navigate": sums.pop(f"{world}navigate", 0.0) / max(free, 1),
                f"{world}accuracy_at_first_view": sums.pop(f"{world}right_at_first", 0.0) / max(first, 1),
                f"{world}policy_entropy_loss": sums.pop(f"{world}surprise", 0.0) / steps,
            }
        return metrics | {name: value / updates for name, value in sums.items()}


def _with_all(places: Mapping[str, slice]) -> dict[str, slice]:
    """Places by the prefix of their metrics' names, and before them that of all."""
    return {"": slice(None)} | {f"{world}/": place for world, place in places.items()}
