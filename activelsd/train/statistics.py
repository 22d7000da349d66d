"""Sums over the steps since the last row of metrics, kept on the device and read once a row."""

from __future__ import annotations

import torch
from torch import Tensor

from activelsd.envs.actions import NAVIGATE
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.rollout import Rollout


class Statistics:
    """What the progress line and the logs show: rates per episode and per step over a window."""

    def __init__(self) -> None:
        self._sums: dict[str, Tensor | float] = {}

    @torch.no_grad()
    def add(self, rollout: Rollout, network: LSDNet, losses: dict[str, Tensor]) -> None:
        """Count a rollout that was learned from."""
        ended = rollout.terminated | rollout.truncated
        sums = {
            "steps": torch.ones_like(rollout.rewards).sum(),
            "episodes": ended.sum(),
            "right": (ended & rollout.right).sum(),
            "views": (rollout.views * ended).sum(),
            "reward": rollout.rewards.sum(),
            "updates": torch.ones(()),
        }
        if rollout.output is not None and NAVIGATE in network.tree.branches:
            policy = network.distribution(rollout.output.logits, rollout.mask)
            branch = policy.branch_probs()[..., network.tree.branches.index(NAVIGATE)]
            free = rollout.mask[..., network.tree.span(NAVIGATE)].any(-1)
            named_right = policy.class_log_probs().argmax(-1) == rollout.labels
            # -log max pi, the paper's Figure 3, "policy entropy loss".
            sums |= {
                "free": free.sum(),
                "navigate": (branch * free).sum(),
                "first": rollout.first.sum(),
                "right_at_first": (named_right & rollout.first).sum(),
                "surprise": -policy.log_probs.amax(-1).sum(),
            }
        for name, value in (sums | losses).items():
            self._sums[name] = self._sums.get(name, 0.0) + value.double()

    def read(self) -> dict[str, float]:
        """The window's metrics, and begin the next window."""
        sums = {name: float(value) for name, value in self._sums.items()}
        self._sums = {}
        steps, episodes = max(sums.pop("steps"), 1), max(sums.pop("episodes"), 1)
        updates = max(sums.pop("updates"), 1)
        metrics = {
            "reward": sums.pop("reward") / episodes,
            "accuracy": sums.pop("right") / episodes,
            "views": sums.pop("views") / episodes,
            "navigate": sums.pop("navigate", 0.0) / max(sums.pop("free", 0.0), 1),
            "accuracy_at_first_view": sums.pop("right_at_first", 0.0) / max(sums.pop("first", 0.0), 1),
            "policy_entropy_loss": sums.pop("surprise", 0.0) / steps,
        }
        return metrics | {name: value / updates for name, value in sums.items()}
