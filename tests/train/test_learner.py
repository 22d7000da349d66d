"""The learner: the kept acting pass gives the step of a pass of its own; each setting does its part."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from activelsd.envs.actions import NAVIGATE
from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.oracle import moves_to_go
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.errors import ConfigError
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.resident import ResidentActors
from activelsd.train.learner import Learner
from activelsd.train.rollout import Rollout
from activelsd.train.settings import TrainSettings
from activelsd.train.trainer import new_network
from tests.graphs import ring_graph, room_graph

NOW = TrainSettings().at(0.3)


def rollout_of(
    memory: str = "pool",
    head: str = "tree",
    rules: str = "V4",
    dropout: float = 0.0,
    *,
    nearer: bool = False,
    **settings: Any,
) -> tuple[LSDNet, Rollout]:
    """A second rollout, so that episodes and memory reach over from the first."""
    graph = ring_graph()
    network = new_network(
        tree_of(graph),
        NetworkShape(memory=memory, head=head, size=graph.size, trunk_settings={"features": 32}),
        1,
    )
    env = ViewGraphVectorEnv(graph, PRESETS[rules], num_envs=6, frames=1)
    actors = ResidentActors(env, network, settings.get("length", 5), seed=2, dropout=dropout, nearer=nearer)
    actors.collect(Epsilon(0.5, 0.5))
    return network, actors.collect(Epsilon(0.5, 0.5))


@pytest.mark.parametrize("memory", ["stack", "lstm", "pool"])
@pytest.mark.parametrize("head", ["tree", "flat"])
@pytest.mark.parametrize("dropout", [0.0, 0.5])
def test_kept_acting_pass_gives_the_gradient_of_a_pass_of_its_own(
    memory: str, head: str, dropout: float
) -> None:
    network, rollout = rollout_of(memory, head, dropout=dropout)
    learner = Learner(network, TrainSettings())
    gradients = []
    for given in (rollout, replace(rollout, output=None)):
        network.zero_grad()
        learner.losses(given, NOW)["total"].backward()  # type: ignore[no-untyped-call]
        gradients.append([p.grad.clone() for p in network.parameters() if p.grad is not None])
    assert any(float(g.abs().max()) > 0 for g in gradients[0])
    for kept, again in zip(*gradients, strict=True):
        torch.testing.assert_close(kept, again, rtol=1e-4, atol=1e-6)


def test_dropout_leaves_out_a_share_of_the_features_at_every_look() -> None:
    network, rollout = rollout_of(dropout=0.25)
    factors = rollout.observation["dropout"]
    assert factors.shape == (*rollout.first.shape, network.memory.outputs)
    assert factors.unique().tolist() == pytest.approx([0, 4 / 3])
    assert float(factors.mean()) == pytest.approx(1, abs=0.05)
    assert not torch.equal(factors[0], factors[1])
    assert "dropout" not in rollout_of()[1].observation
    # What comes after the rollout is valued by all features, where an episode goes on.
    env = ViewGraphVectorEnv(ring_graph(), PRESETS["V4"], num_envs=6, frames=1)
    actors = ResidentActors(env, network, 5, seed=2, dropout=0.25)
    rollout = actors.collect(Epsilon(0.5, 0.5))
    goes_on = ~(rollout.terminated | rollout.truncated)[-1]
    observation = {name: value[None] for name, value in env.observe().items()}
    again = network(observation, actors._memory, actors._first[None]).value[0]
    assert 0 < goes_on.sum() < 6
    torch.testing.assert_close(rollout.bootstrap, again * goes_on)


def test_guided_moves_lead_nearer_also_in_a_mirror() -> None:
    """What a rollout calls nearer is, as its environment takes it, a move on a shortest way."""
    graph = room_graph(rooms=4, size=16)
    graph = replace(graph, move_names=("forward", "backward", "left", "right"))
    network = new_network(
        tree_of(graph), NetworkShape(size=graph.size, trunk_settings={"features": 8}, crops=True), 1
    )
    env = ViewGraphVectorEnv(graph, replace(PRESETS["V4"], try_again=True), num_envs=32, frames=1)
    actors = ResidentActors(env, network, 1, seed=2, mirror=True, nearer=True)
    away, moves = moves_to_go(graph), network.tree.span(NAVIGATE)
    found = 0
    for _ in range(20):
        views, targets = env.views_seen()[:, -1].tolist(), env.targets.tolist()
        rollout = actors.collect(Epsilon(0.5, 0.5))
        assert rollout.nearer is not None
        inside = (rollout.observation["frames"][0] != torch.from_numpy(graph.frames[views])[:, None]).flatten(
            1
        )
        for b, (view, target, flipped) in enumerate(zip(views, targets, inside.any(1).tolist(), strict=True)):
            called = rollout.nearer[0, b, moves][[0, 1, 3, 2]] if flipped else rollout.nearer[0, b, moves]
            to = graph.moves[view]
            nearer = (to >= 0) & (away[to, target] >= 0) & (away[to, target] < away[view, target])
            assert called.tolist() == nearer.tolist()
            found += int(flipped and nearer[2] != nearer[3])
    assert found > 10
    assert not rollout.nearer[..., : moves.start].any()
    assert rollout_of(nearer=True)[1].nearer is not None
    assert not rollout_of(nearer=True)[1].nearer.any(), "there are no boxes on a ring"  # type: ignore[union-attr]


def test_learning_rate_falls_linearly_to_zero() -> None:
    network, rollout = rollout_of()
    learner = Learner(network, TrainSettings(learning_rate=1e-3, decay=True))
    learner.update(replace(rollout, output=None), learner.settings.at(0.75))
    assert learner.optimiser.param_groups[0]["lr"] == pytest.approx(2.5e-4)
    before = [p.detach().clone() for p in network.parameters()]
    learner.update(replace(rollout, output=None), learner.settings.at(1.0))
    assert all(torch.equal(a, b) for a, b in zip(before, network.parameters(), strict=True))


def test_gradient_is_clipped_to_the_norm_asked_for() -> None:
    network, rollout = rollout_of()
    learner = Learner(network, TrainSettings(clip_norm=1e-3))
    norm = learner.update(replace(rollout, output=None), NOW)["gradient"]
    clipped = torch.cat([p.grad.flatten() for p in network.parameters() if p.grad is not None]).norm()
    assert float(norm) > 1e-3
    assert float(clipped) == pytest.approx(1e-3, rel=1e-3)


def test_rewards_are_clipped() -> None:
    network, rollout = rollout_of()
    big = replace(rollout, rewards=rollout.rewards * 100)
    clipped = Learner(network, TrainSettings(reward_clip=1.0)).losses(big, NOW)
    plain = Learner(network, TrainSettings()).losses(rollout, NOW)
    assert rollout.rewards.abs().sum() > 0
    assert clipped["value"].item() == pytest.approx(plain["value"].item())


def test_a_cut_episode_is_valued_on_only_when_asked() -> None:
    network, rollout = rollout_of(rules="V1", length=13)
    assert bool(rollout.truncated.any())
    off = Learner(network, TrainSettings(bootstrap_at_limit=False)).losses(rollout, NOW)
    on = Learner(network, TrainSettings(bootstrap_at_limit=True)).losses(rollout, NOW)
    assert off["value"].item() != pytest.approx(on["value"].item(), rel=1e-6)


def test_repeated_steps_on_one_rollout_learn_its_labels() -> None:
    network, rollout = rollout_of()
    learner = Learner(network, TrainSettings())
    now = NOW._replace(learning_rate=3e-3)
    again = replace(rollout, output=None)
    losses = [float(learner.update(again, now)["loss/supervised"]) for _ in range(60)]
    assert losses[-1] < 0.3 * losses[0]


@pytest.mark.parametrize("head", ["tree", "flat"])
def test_rewards_leave_the_classes_alone_where_they_are_not_to_teach_them(head: str) -> None:
    network, rollout = rollout_of(head=head)
    taught = []
    for rewarded in (True, False):
        learner = Learner(network, TrainSettings(rewarded_classes=rewarded, terms={"supervised": 1.0}))
        losses = learner.losses(replace(rollout, output=None), NOW)
        network.zero_grad()
        (losses["policy"] - losses["entropy_leaf"] - losses["entropy_branch"]).backward()
        gradient = network.policy.weight.grad
        assert gradient is not None
        classes = torch.zeros(len(gradient), dtype=torch.bool)
        classes[network.class_logits] = True
        assert gradient[~classes].any(1).all(), "whether to answer and where to go are learned from reward"
        taught.append(bool(gradient[classes].any()))
        network.zero_grad()
        learner.losses(replace(rollout, output=None), NOW)["supervised"].backward()
        assert network.policy.weight.grad[classes].any(1).all()  # type: ignore[index]
    assert taught == [True, False]


def test_somebody_must_teach_the_classes() -> None:
    for terms in ({"supervised": 0.0}, {"smoothing": 0.1, "guided": 1.0}):
        with pytest.raises(ConfigError, match="leaves nobody to teach the classes; leave it true, or set"):
            TrainSettings(rewarded_classes=False, terms=terms)
