"""Distributions over an action tree: the paper's hierarchy of softmaxes (section 3.3), and one softmax."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY, ActionTree

LEAST = 1e-6
"""Probabilities below this count as this in a logarithm, as in GA3C (its `LOG_EPSILON`)."""


class Epsilon(NamedTuple):
    """Probability of a uniformly random choice at each level of the tree, as floats or scalar tensors."""

    branch: float | Tensor = 0.0
    leaf: float | Tensor = 0.0


class Entropy(NamedTuple):
    """Entropy in nats of the policy before epsilon is mixed in, per level of the tree, each (...)."""

    branch: Tensor
    leaf: Tensor  # of the branches' leaves, weighted by the probability of the branch


class ActionDistribution:
    """A distribution over the n actions of a tree, over any leading shape.

    Attributes:
        probs: (..., n) probability of every action, epsilon mixed in; 0 where it is not legal.
    """

    probs: Tensor

    def log_prob(self, actions: Tensor) -> Tensor:
        """(...) log-probability of int64 actions (...), cut at that of `LEAST`."""
        likely = self.probs.gather(-1, actions[..., None]).squeeze(-1)
        # An action that another policy drew may have probability 0 here; the clamp stops its gradient.
        return likely.clamp(min=LEAST).log()

    def sample(self, generator: torch.Generator | None = None) -> Tensor:
        """(...) int64 actions drawn from the distribution.

        Divides each probability by an exponential draw and takes the largest. `torch.multinomial` does the
        same, but its checks wait for the device and end a run on a NaN before its loss can be reported.
        """
        probs = self.probs.detach()
        return (probs / torch.empty_like(probs).exponential_(generator=generator)).argmax(-1)

    @abstractmethod
    def entropy(self) -> Entropy:
        """Entropy per level."""

    @abstractmethod
    def branch_probs(self) -> Tensor:
        """(..., branches) probability of each branch, without epsilon."""

    @abstractmethod
    def class_log_probs(self) -> Tensor:
        """(..., m) log-probability of each class given that the agent answers, without epsilon."""

    @abstractmethod
    def move_log_probs(self) -> Tensor:
        """(..., n - m) log-probability of each move given that the agent moves, without epsilon."""


def _mix(log_p: Tensor, legal: Tensor, epsilon: float | Tensor) -> Tensor:
    """(1 - epsilon) p + epsilon u, with u uniform over the legal actions."""
    if not isinstance(epsilon, Tensor) and epsilon == 0.0:
        return log_p.exp()
    uniform = legal / legal.sum(-1, keepdim=True, dtype=log_p.dtype).clamp(min=1)
    return log_p.exp().lerp(uniform, epsilon)


def _log_softmax(logits: Tensor, illegal: Tensor) -> Tensor:
    """log-softmax over the legal entries; -inf everywhere, without NaN gradients, if none is legal."""
    log_p = logits.masked_fill(illegal, torch.finfo(logits.dtype).min).log_softmax(-1)
    return log_p.masked_fill(illegal, -torch.inf)


def _entropy(log_p: Tensor) -> Tensor:
    return -(log_p.exp() * log_p.masked_fill(log_p.isneginf(), 0.0)).sum(-1)


class TreeCategorical(ActionDistribution):
    """pi(a) = pi(branch) pi(leaf given branch), epsilon mixed in at both levels."""

    def __init__(
        self,
        tree: ActionTree,
        branch_logits: Tensor,
        leaf_logits: Tensor,
        mask: Tensor,
        epsilon: Epsilon = Epsilon(),
    ) -> None:
        """Build from logits.

        Args:
            tree: names and branches of the actions.
            branch_logits: (..., branches).
            leaf_logits: (..., n).
            mask: (..., n) bool, the legal actions; at least one in every row.
            epsilon: probability of a random choice per level.
        """
        sizes = list(tree.sizes)
        legal, illegal, logits = (torch.split(x, sizes, -1) for x in (mask, ~mask, leaf_logits))
        closed = torch.stack([x.all(-1) for x in illegal], -1)
        self._answers = tree.branches.index(CLASSIFY)
        self._branch_logits, self._closed = branch_logits, closed
        self._branch = _log_softmax(branch_logits, closed)
        self._leaves = [_log_softmax(x, no) for x, no in zip(logits, illegal, strict=True)]
        acting = torch.split(_mix(self._branch, ~closed, epsilon.branch), 1, -1)
        leaves = [_mix(x, ok, epsilon.leaf) for x, ok in zip(self._leaves, legal, strict=True)]
        self.probs = torch.cat([a * b for a, b in zip(acting, leaves, strict=True)], -1)

    def entropy(self) -> Entropy:
        """H(branch), and the sum over branches of pi(branch) H(leaf given branch)."""
        leaves = torch.stack([_entropy(x) for x in self._leaves], -1)
        return Entropy(_entropy(self._branch), (self._branch.exp() * leaves).sum(-1))

    def branch_probs(self) -> Tensor:
        """(..., branches)."""
        return self._branch.exp()

    def class_log_probs(self) -> Tensor:
        """(..., m)."""
        return self._leaves[self._answers]

    def move_log_probs(self) -> Tensor:
        """(..., n - m): log pi(branch given a move) + log pi(leaf given branch)."""
        closed = self._closed.clone()
        closed[..., self._answers] = True
        branches = torch.split(_log_softmax(self._branch_logits, closed), 1, -1)
        pairs = list(zip(branches, self._leaves, strict=True))
        del pairs[self._answers]
        return torch.cat([branch + leaf for branch, leaf in pairs], -1)


class FlatCategorical(ActionDistribution):
    """One softmax over all actions, the paper's alternative to the tree; it uses the leaf's epsilon."""

    def __init__(self, tree: ActionTree, logits: Tensor, mask: Tensor, epsilon: Epsilon = Epsilon()) -> None:
        """As `TreeCategorical`, with logits (..., n)."""
        self._tree, self._logits, self._illegal = tree, logits, ~mask
        self._log_p = _log_softmax(logits, self._illegal)
        self.probs = _mix(self._log_p, mask, epsilon.leaf)

    def entropy(self) -> Entropy:
        """The entropy is all at the leaf level; that of the branch is 0."""
        leaf = _entropy(self._log_p)
        return Entropy(torch.zeros_like(leaf), leaf)

    def branch_probs(self) -> Tensor:
        """(..., branches), summed over each branch's actions."""
        p = self._log_p.exp()
        return torch.stack([p[..., self._tree.span(b)].sum(-1) for b in self._tree.branches], -1)

    def class_log_probs(self) -> Tensor:
        """(..., m), renormalised over the classes."""
        return self._among(self._tree.span(CLASSIFY))

    def move_log_probs(self) -> Tensor:
        """(..., n - m), renormalised over the moves."""
        return self._among(self._tree.moves)

    def _among(self, span: slice) -> Tensor:
        return _log_softmax(self._logits[..., span], self._illegal[..., span])
