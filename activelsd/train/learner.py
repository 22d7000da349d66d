"""The learner: loss and optimiser step on rollouts, nothing else."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

from activelsd import registry
from activelsd.errors import RunError
from activelsd.policy.lsdnet import LSDNet, Output, joined
from activelsd.train.losses import Losses, Weights, a3c_losses, n_step_returns
from activelsd.train.optimisers import TFRMSprop, make_optimiser
from activelsd.train.parallel import ALONE, Group
from activelsd.train.rollout import Rollout
from activelsd.train.settings import Annealed, TrainSettings
from activelsd.train.terms import make_terms
from activelsd.train.vtrace import vtrace

CACHED = 96
"""Observations of the compact trunk whose activations fit a CPU's cache."""

_TERMS, _VALUE = "terms", "value"
"""Names in `Learner.state`: `terms/<term>/<parameter>/value` are a term's weights."""


class Learner:
    """Trains a network, and the loss terms' own weights, in step with the other learners of a group.

    Attributes:
        terms: the loss terms beside A3C's, by name.
    """

    def __init__(
        self, network: LSDNet, settings: TrainSettings, group: Group = ALONE, *, seed: int = 0
    ) -> None:
        """Build terms and optimiser; `seed` fixes the first weights of the terms."""
        self.network, self.settings, self._group = network, settings, group
        self.terms = make_terms(network, settings.terms, seed)
        # A term may keep the network, whose weights are then among its own.
        shared = {id(value) for value in network.state_dict(keep_vars=True).values()}
        self._own = {
            f"{_TERMS}/{name}/{key}": value
            for name, term in self.terms.items()
            for key, value in term.state_dict(keep_vars=True).items()
            if id(value) not in shared
        }
        own = {name: value for name, value in self._own.items() if isinstance(value, torch.nn.Parameter)}
        trained = {name: one for name, one in network.named_parameters() if one.requires_grad}
        slow = {name: trained.pop(name) for name in network.slow if name in trained}
        self._parameters = trained | own | slow
        # Which losses were not finite in the first update in which one was not; later, weights are NaN.
        losses = len(Losses._fields) + len(self.terms)
        self._broken = torch.zeros(losses, dtype=torch.bool, device=network.device)
        groups: list[dict[str, Any]] = [{"params": list((trained | own).values()), "share": 1.0}]
        if slow:
            groups.append({"params": list(slow.values()), "share": network.trunk.rate})
        self.optimiser = make_optimiser(groups, settings, network.device)

    def update(self, rollout: Rollout, now: Annealed) -> dict[str, Tensor]:
        """One optimiser step.

        Args:
            rollout: what was played; its acting pass is used if the weights have not changed since.
            now: everything that is annealed.

        Returns:
            Scalars on the device: the losses and the gradient's norm before clipping.
        """
        losses, parameters = self.losses(rollout, now), list(self._parameters.values())
        finite = torch.stack([loss.detach() for loss in losses.values()]).isfinite()
        self._broken |= ~finite & ~self._broken.any()
        self.optimiser.zero_grad(set_to_none=True)
        losses["total"].backward()  # type: ignore[no-untyped-call]
        self._group.average(parameters)
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.settings.clip_norm or torch.inf, foreach=True)
        for group in self.optimiser.param_groups:
            group["lr"] = now.learning_rate * group["share"]
        if isinstance(self.optimiser, TFRMSprop) and self.settings.loss == "sum":
            self.optimiser.trajectories = self._group.total(trajectories(rollout))
        self.optimiser.step()
        return {f"loss/{name}": value.detach() for name, value in losses.items()} | {"gradient": norm}

    def output(self, rollout: Rollout) -> Output:
        """The network's pass over a rollout, with its graph: the acting pass if kept, or one made now."""
        if rollout.output is not None:
            return rollout.output
        length, envs = rollout.first.shape
        # A CPU is a fifth faster on pieces whose activations stay in its cache.
        size = length if rollout.first.is_cuda else max(1, CACHED // envs)
        state, passes = rollout.state, []
        for t in range(0, length, size):
            observation = {name: value[t : t + size] for name, value in rollout.observation.items()}
            passes.append(self.network(observation, state, rollout.first[t : t + size]))
            state = passes[-1].state
        return joined(passes)

    def losses(self, rollout: Rollout, now: Annealed) -> dict[str, Tensor]:
        """The losses by name, means over the steps, and `total`, with their graph.

        `total` is their weighted sum, times the number of steps if `train.loss` is `sum`.

        Raises:
            BrokenPartError: a term of another package fails, or one does not return a scalar.
        """
        settings = self.settings
        output = self.output(rollout)
        rewards = rollout.rewards
        if settings.reward_clip is not None:
            rewards = rewards.clamp(-settings.reward_clip, settings.reward_clip)
        if settings.bootstrap_at_limit:
            # At the limit only answers are legal, and an answer does not change the view, so the value of
            # the next state is the value of this one.
            rewards = rewards + settings.gamma * output.value.detach() * rollout.truncated
        ended = rollout.terminated | rollout.truncated
        policy = self.network.distribution(output.logits, rollout.mask, rollout.epsilon)
        gamma, advantages = settings.gamma, None
        if settings.corrects_lag and rollout.behaviour is not None:
            ratios = policy.log_prob(rollout.actions).detach() - rollout.behaviour
            returns, advantages = vtrace(
                ratios, rewards, ended, output.value.detach(), rollout.bootstrap, gamma
            )
        else:
            returns = n_step_returns(rewards, ended, rollout.bootstrap, gamma)
        weights = Weights(settings.value_weight, now.entropy_branch, now.entropy_leaf)
        steered = policy  # the same values; the terms still teach the classes where rewards do not
        if not settings.rewarded_classes:
            logits, classes = output.logits.clone(), self.network.class_logits
            logits[..., classes] = logits[..., classes].detach()
            steered = self.network.distribution(logits, rollout.mask, rollout.epsilon)
        a3c = a3c_losses(steered, output.value, rollout.actions, returns, weights, advantages)
        total, output = a3c.total, output._replace(policy=policy)
        losses = a3c._asdict()
        for name, term in self.terms.items():
            with registry.terms.blaming(name, "fails"):
                loss = losses[name] = term(rollout, output)
            if not isinstance(loss, Tensor) or loss.shape != ():
                found = f"a tensor {tuple(loss.shape)}" if isinstance(loss, Tensor) else type(loss).__name__
                raise registry.terms.broken(name, f"returns {found} and must return a scalar")
            total = total + settings.terms[name] * loss
        if settings.loss == "sum":  # over the episodes of all processes, whose gradients are averaged
            total = total * (rollout.first.numel() * self._group.size)
        return losses | {"total": total}

    def broken_terms(self) -> list[str]:
        """The terms that were the first losses not to be finite; none if A3C's own were not either."""
        names = (*Losses._fields, *self.terms)
        broken = {name for name, bad in zip(names, self._broken.tolist(), strict=True) if bad} - {"total"}
        return [] if broken & {*Losses._fields} else sorted(broken)

    def state(self) -> dict[str, Tensor]:
        """Tensors by `parameter/quantity`, for a checkpoint: the optimiser's, and the terms' weights."""
        names = list(self._parameters)
        slots = self.optimiser.state_dict()["state"]
        state = {f"{names[i]}/{key}": value for i, slot in slots.items() for key, value in slot.items()}
        return state | {f"{name}/{_VALUE}": value.detach() for name, value in self._own.items()}

    @torch.no_grad()
    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave.

        Raises:
            RunError: the terms that have weights are others than those of the settings.
        """
        names = list(self._parameters)
        stored, own = _terms_of(tensors), _terms_of(self._own)
        if stored != own:
            raise RunError(
                f"The loss terms with weights are {stored} in the checkpoint and {own} in train.terms; "
                "resume with the train.terms that the run was trained with, or train a new run."
            )
        slots: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            parameter, key = name.rsplit("/", 1)
            if key == _VALUE:
                self._own[parameter].copy_(value)
            else:
                like = self._parameters[parameter]
                if value.shape == like.shape:  # stored in order; weights of convolutions lie channels last
                    value = torch.empty_like(like).copy_(value)
                slots.setdefault(names.index(parameter), {})[key] = value
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": slots})


def trajectories(rollout: Rollout) -> Tensor:
    """How many trajectories GA3C would make of a rollout: it cuts them at ends of episodes too."""
    ended = rollout.terminated | rollout.truncated
    return ended.sum() + (~ended[-1]).sum()


def _terms_of(names: Iterable[str]) -> str:
    """The loss terms that tensors of `Learner.state` belong to, for messages."""
    parts = (name.split("/") for name in names)
    return ", ".join(sorted({part[1] for part in parts if part[0] == _TERMS})) or "none"
