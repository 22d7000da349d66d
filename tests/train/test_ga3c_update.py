"""`train=paper` moves the parameters as GA3C does: against its update in NumPy, on the same trajectories."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from activelsd.compose import resolve
from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.resident import ResidentActors
from activelsd.train.learner import Learner
from activelsd.train.optimisers import TFRMSprop
from activelsd.train.rollout import Rollout
from activelsd.train.settings import GA3CSettings, TrainSettings
from activelsd.train.trainer import new_network
from tests.graphs import ring_graph
from tests.train.ga3c_reference import Reference, Trajectory

GRAPH = ring_graph()
PAPER = resolve(["experiment=paper"]).train


class Dense(nn.Module):
    """A trunk of one hidden layer, which the reference has too."""

    def __init__(self, inputs: int, features: int) -> None:
        super().__init__()
        self.features = features
        self.dense = nn.Linear(inputs, features)

    def forward(self, frames: Tensor) -> Tensor:
        return self.dense(frames.flatten(1).float() / 255).relu()


def small(seed: int = 1) -> LSDNet:
    network = new_network(tree_of(GRAPH), NetworkShape(memory="stack", size=GRAPH.size), seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network.trunk = Dense(GRAPH.size**2, 24)
        network.policy = nn.Linear(24 + 5, network.policy.out_features)
        network.value = nn.Linear(24 + 5, 1)
    return network


def actors_for(network: LSDNet, rules: str, envs: int, seed: int = 2) -> ResidentActors:
    env = ViewGraphVectorEnv(GRAPH, PRESETS[rules], num_envs=envs, frames=1)
    return ResidentActors(env, network, PAPER.length, seed)


def cut(rollout: Rollout) -> list[Trajectory]:
    """GA3C's trajectories of a rollout: cut at ends of episodes, in the order in which they end."""
    frames = rollout.observation["frames"].flatten(2).double().numpy() / 255
    ended = (rollout.terminated | rollout.truncated).numpy()
    found: list[tuple[int, Trajectory]] = []
    for b in range(ended.shape[1]):
        start = 0
        for t in range(len(ended)):
            if ended[t, b] or t == len(ended) - 1:
                steps = np.s_[start : t + 1, b]
                one = Trajectory(
                    frames[steps],
                    rollout.observation["target"].flatten(2).double().numpy()[steps],
                    rollout.mask.numpy()[steps],
                    rollout.actions.numpy()[steps],
                    rollout.rewards.double().numpy()[steps],
                    0.0 if ended[t, b] else float(rollout.bootstrap[b]),
                )
                found.append((t, one))
                start = t + 1
    return [one for _, one in sorted(found, key=lambda each: each[0])]


def flat(parameters: dict[str, Any]) -> np.ndarray:
    return np.concatenate([np.asarray(parameters[name], np.float64).ravel() for name in sorted(parameters)])


def weights(network: LSDNet) -> dict[str, np.ndarray]:
    return {name: value.detach().double().numpy().copy() for name, value in network.named_parameters()}


def reference(network: LSDNet, settings: TrainSettings) -> Reference:
    return Reference(
        weights(network),
        network.tree.sizes[0],
        rate=settings.learning_rate,
        gamma=settings.gamma,
        beta=settings.entropy_leaf.start,
        epsilon=settings.epsilon_leaf.start,
    )


def test_a_step_of_tensorflows_rmsprop_worked_out_by_hand() -> None:
    """The mean square begins at 1, and epsilon is inside the root."""
    weight = nn.Parameter(torch.tensor([1.0, -1.0]))
    optimiser = TFRMSprop([{"params": [weight]}], lr=0.01, eps=0.1)
    weight.grad = torch.tensor([0.5, 2.0])
    optimiser.step()
    # 0.99 * 1 + 0.01 * 0.25 = 0.9925, and 0.99 + 0.01 * 4 = 1.03
    first = [1.0 - 0.01 * 0.5 / 1.0925**0.5, -1.0 - 0.01 * 2.0 / 1.13**0.5]
    assert weight.tolist() == pytest.approx(first)
    weight.grad = torch.tensor([-1.0, 0.0])
    optimiser.step()
    # 0.99 * 0.9925 + 0.01 = 0.992575; a parameter without gradient stays
    assert weight.tolist() == pytest.approx([first[0] + 0.01 / 1.092575**0.5, first[1]])


def test_a_summed_gradient_ages_the_mean_square_as_its_trajectories_would() -> None:
    """n updates by gradients whose squares are alike, and one by their sum, which independent ones have."""
    n, g = 16, 0.3
    each, summed = (nn.Parameter(torch.zeros(1)) for _ in range(2))
    small, large = (TFRMSprop([{"params": [one]}], lr=0.0, eps=0.1) for one in (each, summed))
    for _ in range(n):
        each.grad = torch.tensor([g])
        small.step()
    summed.grad = torch.tensor([g * n**0.5])
    large.trajectories = torch.tensor(n)
    large.step()
    found, expected = large.state[summed]["mean_square"], small.state[each]["mean_square"]
    torch.testing.assert_close(found, expected)


def test_the_reference_has_the_gradient_of_the_learners_loss() -> None:
    """To rounding, where both take the same steps with the same weights: sums, clipped rewards, cut logs."""
    network = small()
    for rules in ("V0", "V5"):
        rollout = actors_for(network, rules, 8).collect(Epsilon(0.1, 0.1))
        learner, ours = Learner(network, PAPER), reference(network, PAPER)
        network.zero_grad()
        learner.losses(rollout, PAPER.at(0.0))["total"].backward()  # type: ignore[no-untyped-call]
        parts = [ours.gradient(one) for one in cut(rollout)]
        for name, parameter in network.named_parameters():
            assert parameter.grad is not None
            total = sum(part[name] for part in parts)
            np.testing.assert_allclose(parameter.grad.numpy(), total, rtol=1e-3, atol=1e-4, err_msg=name)


def movement(rules: str, trajectories: int) -> tuple[np.ndarray, np.ndarray]:
    """How the parameters move in 12,800 steps, with so many trajectories an update, and by the reference.

    The trajectories are those that the learner's network plays.
    """
    network = small()
    learner, ours = Learner(network, PAPER), reference(network, PAPER)
    actors, start = actors_for(network, rules, PAPER.envs), flat(weights(network))
    for _ in range(40):
        with torch.no_grad():
            rollout = replace(actors.collect(Epsilon(0.1, 0.1)), output=None)
        for one in cut(rollout):
            ours.update(one)
        for first in range(0, PAPER.envs, trajectories):
            learner.update(rollout.columns(slice(first, first + trajectories)), PAPER.at(0.0))
    return flat(weights(network)) - start, flat(ours.p) - start


@pytest.mark.parametrize("rules", ["V0", "V6"])
def test_parameters_move_as_far_as_in_ga3c_and_the_same_way(rules: str) -> None:
    """From the first episode on. GA3C makes an update for every trajectory, the preset one for several."""
    assert PAPER.trajectories is not None
    found, expected = movement(rules, PAPER.trajectories)
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(expected), rel=0.2)
    assert np.linalg.norm(found - expected) < 0.2 * np.linalg.norm(expected)


def test_a_mean_over_all_moves_about_a_hundred_times_less() -> None:
    """What this preset once did: the gradient is 320 times smaller, and epsilon outside the root 3 times."""
    network = small()
    rollout = actors_for(network, "V0", PAPER.envs).collect(Epsilon(0.1, 0.1))
    moved = []
    for changed in ({}, {"loss": "mean", "optimiser": "rmsprop"}):
        learner = Learner(network, PAPER.model_copy(update=changed))
        for group in learner.optimiser.param_groups:
            for parameter in group["params"]:
                if isinstance(learner.optimiser, TFRMSprop):  # as after some thousand updates
                    learner.optimiser.state[parameter]["mean_square"] = torch.zeros_like(parameter)
        start = flat(weights(network))
        learner.update(replace(rollout, output=None), PAPER.at(0.0))
        moved.append(float(np.linalg.norm(flat(weights(network)) - start)))
    assert moved[0] > 80 * moved[1]


def test_an_update_of_ga3cs_agents_is_a_trajectory() -> None:
    network = small()
    settings = GA3CSettings(kind="threads", agents=4, predictors=2, trainers=2, training_batch=1)
    actors = GA3CActors(
        lambda: ViewGraphEnv(GRAPH, PRESETS["V0"], frames=1), network, settings, PAPER.length, 3
    )
    try:
        shapes = {tuple(actors.collect(Epsilon(0.1, 0.1)).first.shape) for _ in range(20)}
    finally:
        actors.close()
    assert shapes == {(PAPER.length, 1)}
