"""What agents play is what their environments did: replayed step by step, and judged by the network again."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch

from activelsd.policy.heads import Epsilon
from activelsd.train.rollout import Rollout
from tests.train.actors.mischief import Mischief
from tests.train.actors.worlds import actors, network

EPSILON = Epsilon(0.3, 0.2)


def collect(kind: str, rollouts: int, memory: str = "pool", envs: int = 3) -> list[Rollout]:
    """Of one agent, whose trajectories come in order."""
    crew = actors(kind, network(memory), agents=1, envs_per_agent=envs)
    try:
        return [crew.collect(EPSILON) for _ in range(rollouts)]
    finally:
        crew.close()


def test_every_step_is_what_the_environment_did() -> None:
    rollouts = collect("threads", 12)
    seed = int(np.random.SeedSequence(3, spawn_key=(0,)).generate_state(1)[0] >> 1)
    ends = 0
    for i in range(3):
        env = Mischief()
        seen, info = env.reset(seed=seed + i)
        first = True
        for rollout in rollouts:
            for t in range(4):
                assert np.array_equal(rollout.observation["frames"][t, i].numpy(), seen["frames"])
                assert np.array_equal(rollout.observation["target"][t, i].numpy(), seen["target"])
                assert np.array_equal(rollout.mask[t, i].numpy(), info["action_mask"])
                assert bool(rollout.first[t, i]) == first
                assert int(rollout.views[t, i]) == info["views"]
                assert int(rollout.labels[t, i]) == info["label"]
                action = int(rollout.actions[t, i])
                assert bool(rollout.right[t, i]) == (action == info["label"])
                seen, reward, terminated, truncated, info = env.step(action)
                assert float(rollout.rewards[t, i]) == reward
                assert bool(rollout.terminated[t, i]) == terminated
                assert bool(rollout.truncated[t, i]) == truncated
                first = terminated or truncated
                ends += first
                if first:
                    seen, info = env.reset()
    assert ends > 20


@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
def test_network_judges_the_same_when_it_looks_again(memory: str) -> None:
    """Memory is carried over trajectories, and actions were drawn with the probabilities written down."""
    net, rollouts = network(memory), collect("threads", 5, memory)
    values = []
    for rollout in rollouts:
        output = net(rollout.observation, rollout.state, rollout.first)
        policy = net.distribution(output.logits, rollout.mask, EPSILON)
        torch.testing.assert_close(policy.log_prob(rollout.actions), rollout.behaviour, rtol=1e-4, atol=1e-5)
        values.append(output.value)
    for rollout, following in zip(rollouts, values[1:], strict=False):
        torch.testing.assert_close(rollout.bootstrap, following[0], rtol=1e-4, atol=1e-5)
    if memory != "stack":
        assert any(bool((rollout.state != 0).any()) for rollout in rollouts[1:])


def test_processes_play_what_threads_play() -> None:
    for ours, theirs in zip(collect("threads", 4), collect("processes", 4), strict=True):
        for field in fields(Rollout):
            one, other = getattr(ours, field.name), getattr(theirs, field.name)
            if isinstance(one, torch.Tensor):
                assert torch.equal(one, other), field.name
        assert torch.equal(ours.observation["frames"], theirs.observation["frames"])


def test_batches_hold_whole_trajectories_of_many_agents() -> None:
    crew = actors(agents=4, envs_per_agent=2, training_batch=6, predictors=2, trainers=2, prediction_batch=4)
    try:
        for _ in range(8):
            rollout = crew.collect(EPSILON)
            assert rollout.rewards.shape == (4, 6)
            ended = rollout.terminated | rollout.truncated
            assert torch.equal(rollout.first[1:], ended[:-1])
        measures = crew.measures()
    finally:
        crew.close()
    assert measures["ga3c/agents"] == 4
    assert 2 <= measures["ga3c/prediction_batch"] <= 4
    assert measures["ga3c/predictions_per_second"] > 0


def test_lag_is_counted_in_updates() -> None:
    crew = actors(agents=1, training_batch=1)
    try:
        crew.collect(EPSILON)
        assert crew.measures()["ga3c/lag"] == 0  # nothing was learned yet
        for _ in range(6):
            crew.collect(EPSILON)
        measures = crew.measures()
    finally:
        crew.close()
    assert 0 < measures["ga3c/lag"] <= measures["ga3c/lag_max"] <= 4


def test_a_resumed_run_plays_other_episodes() -> None:
    first = actors(agents=2)
    first.collect(EPSILON)
    state = first.state()
    first.close()
    again = actors(agents=2)
    again.load_state(state)
    assert int(again.state()["begun"]) == 2
    again.close()
