"""Loss terms beside A3C's own: modules that the learner weighs, trains and saves, found by name."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from activelsd import registry
from activelsd.errors import ConfigError
from activelsd.policy.lsdnet import LSDNet, Output
from activelsd.train.losses import Losses
from activelsd.train.rollout import Rollout


class Term(nn.Module):
    """A loss over rollouts. Its weights, if it has any, are trained with the network's, which it may keep.

    Attributes:
        needs_nearer: whether actors are to fill in `Rollout.nearer`; GA3C's cannot.
    """

    needs_nearer = False

    def __init__(self, network: LSDNet) -> None:
        """Build for a network; first weights are drawn from torch's global generator."""
        super().__init__()

    @abstractmethod
    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        """The loss, a scalar; `output` is the network's for the rollout, with its graph and `policy` set."""


class Supervised(Term):
    """Cross-entropy of the class branch with the label, at every view; the label is known in training."""

    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        """The mean over all steps."""
        assert output.policy is not None
        log_p = output.policy.class_log_probs()
        return functional.nll_loss(log_p.flatten(0, -2), rollout.labels.flatten())


class Smoothing(Term):
    """Cross-entropy of the class branch with all classes alike, at every view.

    With weight w beside `supervised` with 1 it is label smoothing of w / (1 + w) (Szegedy et al. 2016,
    https://arxiv.org/abs/1512.00567, section 7). Without it a network that knows its training objects by
    heart is sure of them at the first view, and learns that moving is never needed.
    """

    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        """The mean over all steps."""
        assert output.policy is not None
        log_p = output.policy.class_log_probs()
        legal = ~log_p.isneginf()  # in a joint run a world has some of the classes
        return -(log_p.masked_fill(~legal, 0.0).sum(-1) / legal.sum(-1)).mean()


class Guided(Term):
    """-log of the probability, given that the agent moves, of the moves that lead nearer to a good look."""

    needs_nearer = True

    def __init__(self, network: LSDNet) -> None:
        super().__init__(network)
        self._moves = network.tree.moves

    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        """The mean over all steps; a step where no such move is legal counts as 0."""
        assert output.policy is not None
        if rollout.nearer is None:
            return output.value.new_zeros(())
        log_p = output.policy.move_log_probs()
        right = rollout.nearer[..., self._moves] & ~log_p.isneginf()
        some = right.any(-1, keepdim=True)
        # logsumexp over an empty set has NaN gradients, even if unused, so empty rows are filled.
        likely = log_p.masked_fill(~right, -torch.inf).masked_fill(~some, 0.0).logsumexp(-1)
        return -torch.where(some.squeeze(-1), likely, 0.0).mean()


def _used(weights: Mapping[str, float]) -> dict[str, type[Term]]:
    """The classes of the terms whose weight is not 0, by name."""
    for name in weights.keys() & {*Losses._fields}:
        raise ConfigError(f"train.terms.{name} is the name of one of A3C's own losses; rename that term.")
    return {name: registry.terms.get(name) for name, weight in weights.items() if weight}


def make_terms(network: LSDNet, weights: Mapping[str, float], seed: int) -> dict[str, Term]:
    """The terms whose weight is not 0, by name, on the network's device; `seed` fixes their first weights.

    Raises:
        ConfigError: there is no term of a name, or it is the name of one of A3C's own losses.
    """
    terms = {}
    with torch.random.fork_rng(devices=[]):
        for name, kind in _used(weights).items():
            torch.manual_seed(seed)  # for each term, so that its weights do not depend on other terms
            with registry.terms.blaming(name, "cannot be made"):
                terms[name] = kind(network).to(network.device)
    return terms


def needs_nearer(weights: Mapping[str, float]) -> bool:
    """Whether a term whose weight is not 0 needs `Rollout.nearer`."""
    return any(kind.needs_nearer for kind in _used(weights).values())
