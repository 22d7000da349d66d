"""When a player answers: after every view a score is compared with a threshold."""

from __future__ import annotations

from abc import abstractmethod

import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.policy.heads import ActionDistribution
from activelsd.policy.lsdnet import LSDNet

SURE = 0.9
"""Probability of the likeliest class at which a player is sure, unless told otherwise."""


class Stop:
    """Scores after every view how ready a player is to answer, in [0, 1].

    Attributes:
        usual: the threshold, unless others are set.
        by_view: whether thresholds that are chosen differ by number of views; of the class.
        thresholds: (n,) at 1, 2, … n views; beyond, the last one.
        score: (B,) after the newest view.
    """

    usual = SURE
    by_view = True

    def __init__(self, network: LSDNet) -> None:
        self._classify = network.tree.branches.index(CLASSIFY)
        self.thresholds = torch.tensor([self.usual])

    def begin(self, batch: int, device: torch.device) -> None:
        """Forgets everything; `batch` episodes begin."""
        self.score = torch.zeros(batch, device=device)
        self._views = torch.zeros(batch, dtype=torch.int64, device=device)

    def look(self, policy: ActionDistribution, first: Tensor) -> None:
        """Takes the policy after a view of every episode; `first` bool (B,) is true where one begins."""
        self._views = torch.where(first, 0, self._views) + 1
        self.score = self.rate(policy, first)

    def stops(self) -> Tensor:
        """Returns whether to answer now, bool (B,)."""
        thresholds = self.thresholds.to(self.score.device)
        return self.score >= thresholds[self._views.clamp(max=len(thresholds)) - 1]

    @abstractmethod
    def rate(self, policy: ActionDistribution, first: Tensor) -> Tensor:
        """Returns the score, float (B,) in [0, 1]; `self.score` is still that of the view before."""


class Learned(Stop):
    """The probability that the policy would have answered by now if its actions were drawn.

    At the usual threshold it stops at the median: at the view by which the policy would have answered in half
    of all cases. If it stopped only where an answer is likelier than a move, a policy that answers with a
    chance of a little less than a half at every view would always go on to the last one. The number of views
    is in it already: thresholds for each, chosen on 210 objects, named 0.2 points fewer of 106 others.
    """

    usual = 0.5
    by_view = False

    def rate(self, policy: ActionDistribution, first: Tensor) -> Tensor:
        """See `Stop`."""
        before = torch.where(first, 0.0, self.score)
        return 1.0 - (1.0 - before) * (1.0 - policy.branch_probs()[:, self._classify])


class Confidence(Stop):
    """The probability of the likeliest class."""

    def rate(self, policy: ActionDistribution, first: Tensor) -> Tensor:
        """See `Stop`."""
        return policy.class_log_probs().amax(-1).exp()
