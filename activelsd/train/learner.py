"""The learner: loss and optimiser step on rollouts, nothing else."""

from __future__ import annotations

import torch
from torch import Tensor

from activelsd.envs.actions import NAVIGATE
from activelsd.policy.lsdnet import LSDNet, Output
from activelsd.train.losses import Losses, Weights, a3c_losses, n_step_returns
from activelsd.train.parallel import ALONE, Group
from activelsd.train.rollout import Rollout
from activelsd.train.settings import Annealed, TrainSettings
from activelsd.train.vtrace import vtrace

CACHED = 96
"""Observations of the compact trunk whose activations fit a CPU's cache."""


class Learner:
    """Changes a network's weights by the A3C loss, in step with the other learners of a group."""

    def __init__(self, network: LSDNet, settings: TrainSettings, group: Group = ALONE) -> None:
        self.network, self.settings, self._group = network, settings, group
        parameters = list(network.parameters())
        rate, eps = settings.learning_rate, settings.optimiser_epsilon
        graph = parameters[0].is_cuda  # steps are counted there too, and a CUDA graph may hold them
        self.optimiser: torch.optim.Optimizer
        if settings.optimiser == "adam":
            self.optimiser = torch.optim.Adam(parameters, lr=rate, eps=eps, capturable=graph)
        else:
            self.optimiser = torch.optim.RMSprop(parameters, lr=rate, alpha=0.99, eps=eps, capturable=graph)

    def update(self, rollout: Rollout, now: Annealed) -> dict[str, Tensor]:
        """One optimiser step.

        Args:
            rollout: what was played; its acting pass is used where it is still valid.
            now: everything that is annealed.

        Returns:
            Scalars on the device: the losses and the gradient's norm before clipping.
        """
        losses = self.losses(rollout, now)
        self.optimiser.zero_grad(set_to_none=True)
        losses.total.backward()  # type: ignore[no-untyped-call]
        self._group.average(self.network.parameters())
        norm = torch.nn.utils.clip_grad_norm_(
            self.network.parameters(), self.settings.clip_norm or torch.inf, foreach=True
        )
        for group in self.optimiser.param_groups:
            group["lr"] = now.learning_rate
        self.optimiser.step()
        return {f"loss/{name}": value.detach() for name, value in losses._asdict().items()} | {
            "gradient": norm
        }

    def output(self, rollout: Rollout) -> Output:
        """The network's pass over a rollout, with its graph: the kept one, or one made now."""
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
        return Output(torch.cat([p.logits for p in passes]), torch.cat([p.value for p in passes]), state)

    def losses(self, rollout: Rollout, now: Annealed) -> Losses:
        """The loss of a rollout, with its graph."""
        settings = self.settings
        output = self.output(rollout)
        rewards = rollout.rewards
        if settings.reward_clip is not None:
            rewards = rewards.clamp(-settings.reward_clip, settings.reward_clip)
        if settings.bootstrap_at_limit:
            # At the limit only answers are legal, and an answer leaves the view as it is, so the value of the
            # state that would have followed is the value of this one.
            rewards = rewards + settings.gamma * output.value.detach() * rollout.truncated
        ended = rollout.terminated | rollout.truncated
        distribution = self.network.distribution(output.logits, rollout.mask, rollout.epsilon)
        gamma, advantages = settings.gamma, None
        if settings.corrects_lag and rollout.behaviour is not None:
            ratios = distribution.log_prob(rollout.actions).detach() - rollout.behaviour
            returns, advantages = vtrace(
                ratios, rewards, ended, output.value.detach(), rollout.bootstrap, gamma
            )
        else:
            returns = n_step_returns(rewards, ended, rollout.bootstrap, gamma)
        weights = Weights(
            settings.value_weight,
            now.entropy_branch,
            now.entropy_leaf,
            settings.supervised,
            settings.guided,
        )
        return a3c_losses(
            distribution,
            output.value,
            rollout.actions,
            returns,
            rollout.labels,
            weights,
            advantages,
            None if rollout.nearer is None else rollout.nearer[..., self.network.tree.span(NAVIGATE)],
        )

    def state(self) -> dict[str, Tensor]:
        """The optimiser's tensors by `parameter/quantity`, for a checkpoint."""
        names = [name for name, _ in self.network.named_parameters()]
        slots = self.optimiser.state_dict()["state"]
        return {f"{names[i]}/{key}": value for i, slot in slots.items() for key, value in slot.items()}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""
        names = [name for name, _ in self.network.named_parameters()]
        slots: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            parameter, key = name.rsplit("/", 1)
            slots.setdefault(names.index(parameter), {})[key] = value
        self.optimiser.load_state_dict({**self.optimiser.state_dict(), "state": slots})
