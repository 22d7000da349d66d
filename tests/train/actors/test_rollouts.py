"""What agents play is what their environments did: replayed step by step, and judged by the network again."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import fields

import numpy as np
import pytest
import torch

from activelsd.envs.actions import NAVIGATE
from activelsd.policy.heads import Epsilon
from activelsd.train.augment import in_mirror
from activelsd.train.rollout import Rollout
from tests.train.actors.mischief import Mischief
from tests.train.actors.worlds import actors, network

EPSILON = Epsilon(0.3, 0.2)


def collect(
    kind: str, rollouts: int, memory: str = "pool", *, mirror: bool = False, dropout: float = 0.0
) -> list[Rollout]:
    """Of one agent, whose trajectories come in order."""
    crew = actors(kind, network(memory), agents=1, envs_per_agent=3, mirror=mirror, dropout=dropout)
    try:
        return [crew.collect(EPSILON) for _ in range(rollouts)]
    finally:
        crew.close()


class Replay:
    """An environment of an agent, stepped again by what its trajectories say."""

    def __init__(self, number: int, swapped: list[int] | None = None) -> None:
        """Replay an agent's environment; `swapped` are the actions' numbers in a mirror, if there is one."""
        seed = int(np.random.SeedSequence(3, spawn_key=(0,)).generate_state(1)[0] >> 1)
        self.env, self.first, self.ends = Mischief(), True, 0
        self.seen, self.info = self.env.reset(seed=seed + number)
        self.swapped, self.flipped = swapped, list[bool]()  # which episodes were

    def follows(self, rollout: Rollout, column: int = 0) -> bool:
        """Whether a column of a rollout is what happens next, which then has happened."""
        tensors = {
            field.name: getattr(rollout, field.name) for field in fields(Rollout)
        } | rollout.observation
        columns = {
            name: value[:, column].numpy()
            for name, value in tensors.items()
            if isinstance(value, torch.Tensor) and name not in ("state", "bootstrap")
        }
        steps = [{name: value[t] for name, value in columns.items()} for t in range(len(rollout.first))]
        return all(self._follows(step) for step in steps)

    def _follows(self, step: dict[str, np.ndarray]) -> bool:
        action, mask = int(step["actions"]), step["mask"]
        if self.first:
            straight = np.array_equal(step["frames"], self.seen["frames"])
            self.flipped.append(self.swapped is not None and not straight)
        if self.flipped[-1] and self.swapped is not None:
            step = step | {"frames": step["frames"][..., ::-1]}
            action, mask = self.swapped[action], mask[self.swapped]
        shown = (
            np.array_equal(step["frames"], self.seen["frames"])
            and np.array_equal(step["target"], self.seen["target"])
            and np.array_equal(mask, self.info["action_mask"])
            and step["first"] == self.first
            and step["views"] == self.info["views"]
            and step["labels"] == self.info["label"]
            and step["right"] == (action == self.info["label"])
        )
        if not shown:
            return False
        self.seen, reward, terminated, truncated, self.info = self.env.step(np.int64(action))
        came = (step["rewards"] == reward, step["terminated"] == terminated, step["truncated"] == truncated)
        self.first = terminated or truncated
        self.ends += self.first
        if self.first:
            self.seen, self.info = self.env.reset()
        return all(came)


def test_every_step_is_what_the_environment_did() -> None:
    replays = [Replay(i) for i in range(3)]
    for rollout in collect("threads", 12):
        assert all(replay.follows(rollout, i) for i, replay in enumerate(replays))
    assert sum(replay.ends for replay in replays) > 20


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_lanes_are_played_each_on_its_own(kind: str) -> None:
    """Trajectories of two lanes come in any order: some way to share them out is what the two did."""
    crew = actors(kind, agents=1, envs_per_agent=2, lanes=2, training_batch=1)
    ways = [[Replay(0), Replay(1)]]
    try:
        for _ in range(16):
            rollout = crew.collect(EPSILON)
            tries = [(deepcopy(way), lane) for way in ways for lane in range(2)]
            ways = [way for way, lane in tries if way[lane].follows(rollout)]
            assert ways
    finally:
        crew.close()
    assert any(min(replay.ends for replay in way) > 3 for way in ways)


@pytest.mark.parametrize("dropout", [0.0, 0.5])
@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
def test_network_judges_the_same_when_it_looks_again(memory: str, dropout: float) -> None:
    """Memory is carried over trajectories, and actions were drawn with the probabilities written down."""
    net, rollouts = network(memory), collect("threads", 5, memory, mirror=True, dropout=dropout)
    values = []
    for rollout in rollouts:
        output = net(rollout.observation, rollout.state, rollout.first)
        policy = net.distribution(output.logits, rollout.mask, EPSILON)
        torch.testing.assert_close(policy.log_prob(rollout.actions), rollout.behaviour, rtol=1e-4, atol=1e-5)
        values.append(output.value)
    for rollout, following in zip(rollouts, values[1:], strict=False):
        torch.testing.assert_close(rollout.bootstrap, following[0], rtol=1e-4, atol=1e-5)
        if dropout:
            assert 0.4 < (rollout.observation["dropout"] == 0).float().mean() < 0.6
    kept = [x for rollout in rollouts[1:] for x in rollout.state.values()]
    assert any(bool((x != 0).any()) for x in kept) == (memory != "stack")


def test_every_other_episode_is_played_in_a_mirror() -> None:
    """Its pictures are flipped, and moves go the other way round: what is legal and done agrees behind it."""
    tree = network().tree
    swapped = [
        tree.index(branch, in_mirror(leaf)) if branch == NAVIGATE else i
        for i, (branch, leaf) in enumerate(tree.names)
    ]
    replays, seen = [Replay(i, swapped) for i in range(3)], {True: 0, False: 0}
    for rollout in collect("threads", 12, mirror=True):
        assert all(replay.follows(rollout, i) for i, replay in enumerate(replays))
    for replay in replays:
        for flipped in replay.flipped:
            seen[flipped] += 1
    assert min(seen.values()) > 5


def test_processes_play_what_threads_play() -> None:
    for ours, theirs in zip(collect("threads", 4), collect("processes", 4), strict=True):
        for field in fields(Rollout):
            one, other = getattr(ours, field.name), getattr(theirs, field.name)
            if isinstance(one, torch.Tensor):
                assert torch.equal(one, other), field.name
        assert torch.equal(ours.observation["frames"], theirs.observation["frames"])
        torch.testing.assert_close(ours.state, theirs.state, rtol=0, atol=0)


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
