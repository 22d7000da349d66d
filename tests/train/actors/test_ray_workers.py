"""Ray's workers without a cluster: they play what resident actors play, and it is learned from."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from activelsd.envs.joint import OpenWorld
from activelsd.errors import ConfigError, DataError
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.actors.ray.worker import Job, Worker, fingerprint
from activelsd.train.actors.resident import on_recordings
from activelsd.train.learner import Learner
from tests.train.actors import recordings
from tests.train.actors.mischief import GRAPH
from tests.train.actors.ray_pool import EPSILON, REASON, actors, network_for, settings_of


def worker_of(open_worlds: Callable[[], Sequence[OpenWorld]], seed: int = 5, dropout: float = 0.0) -> Worker:
    """A worker of this process that has begun."""
    worlds = open_worlds()
    network = network_for(worlds)
    found = Worker(
        Job(
            open=open_worlds,
            fingerprint=fingerprint(worlds),
            tree=network.tree,
            shape=network.shape,
            settings=settings_of(dropout),
        ),
        seed,
    )
    found.begin()
    return found


def weights_of(network: LSDNet) -> dict[str, Any]:
    """As Ray handles them over: read-only."""
    arrays = {name: value.numpy().copy() for name, value in network.state_dict().items()}
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


@pytest.mark.parametrize("open_worlds", [recordings.rings, recordings.rooms])
def test_a_worker_plays_what_resident_actors_play_with_the_weights_it_is_given(
    open_worlds: Callable[[], Sequence[OpenWorld]],
) -> None:
    worlds = open_worlds()
    network = network_for(worlds)
    settings = settings_of().model_copy(update={"envs": 3})
    resident = on_recordings(worlds, settings, frames=1)(network, 5)
    ours = worker_of(open_worlds)
    for version in range(3):
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.add_(0.05 * version)
        steps, state, bootstrap = ours.play(weights_of(network), version, EPSILON)
        rollout = resident.collect(EPSILON)
        for name, tensor in {
            **rollout.observation,
            **{"first": rollout.first, "mask": rollout.mask, "label": rollout.labels},
            **{"views": rollout.views, "action": rollout.actions, "reward": rollout.rewards},
            **{"terminated": rollout.terminated, "truncated": rollout.truncated, "nearer": rollout.nearer},
        }.items():
            assert np.array_equal(steps[name], tensor), name
        assert state.keys() == rollout.state.keys()
        assert all(np.array_equal(state[name], tensor) for name, tensor in rollout.state.items())
        assert np.array_equal(bootstrap, rollout.bootstrap)


@pytest.mark.parametrize("dropout", [0.0, 0.5])
def test_without_lag_nothing_is_corrected_and_with_it_something_is(dropout: float) -> None:
    pytest.importorskip("ray", reason=REASON)
    crew = actors()
    network, settings = crew._network, settings_of()
    now = settings.at(0.0)
    workers = [worker_of(recordings.rings, seed, dropout) for seed in (1, 2)]
    played = [(worker.play(weights_of(network), 0, EPSILON), 0) for worker in workers]
    rollout = crew._rollout(played, EPSILON)
    assert rollout.rewards.shape == (4, 6)
    assert rollout.nearer is not None
    assert rollout.nearer.shape == rollout.mask.shape
    corrected = Learner(network, settings).losses(rollout, now)["total"].item()
    plain = Learner(network, settings).losses(replace(rollout, behaviour=None), now)["total"].item()
    assert corrected == pytest.approx(plain, rel=1e-5)
    with torch.no_grad():
        network.policy.bias.copy_(torch.arange(len(network.policy.bias)) % 5)  # the learner is ahead
    corrected = Learner(network, settings).losses(rollout, now)["total"].item()
    plain = Learner(network, settings).losses(replace(rollout, behaviour=None), now)["total"].item()
    assert corrected != pytest.approx(plain, rel=1e-4)


def test_columns_of_each_world_stand_together() -> None:
    pytest.importorskip("ray", reason=REASON)
    crew = actors(recordings.two_worlds, recordings.two_worlds)
    weights = weights_of(crew._network)
    played = [(worker_of(recordings.two_worlds, seed).play(weights, 0, EPSILON), 0) for seed in (1, 2)]
    rollout = crew._rollout(played, EPSILON)
    assert crew.places == {"rings": slice(0, 4), "others": slice(4, 6)}
    only_there = crew._network.tree.index("navigate", "orbit_cw_90")
    assert not rollout.mask[:, :4, only_there].any()
    assert rollout.mask[:, 4:, only_there].any()


def test_a_rollout_is_where_the_learner_is() -> None:
    pytest.importorskip("ray", reason=REASON)
    crew = actors()
    played = worker_of(recordings.rings).play(weights_of(crew._network), 0, EPSILON)
    crew._network.to("meta")
    rollout = crew._rollout([(played, 0)], EPSILON)
    for value in (*vars(rollout).values(), *rollout.observation.values(), *rollout.state.values()):
        assert not isinstance(value, torch.Tensor) or value.device.type == "meta"


def test_other_worlds_than_the_learners_are_refused_and_other_pixels_are_not() -> None:
    (world,) = recordings.rings()
    brighter = world._replace(graph=replace(GRAPH, frames=GRAPH.frames // 2))
    assert fingerprint([brighter]) == fingerprint([world])
    for other in (
        world._replace(rules=replace(world.rules, max_views=5)),
        world._replace(graph=replace(GRAPH, labels=GRAPH.labels[::-1])),
        world._replace(graph=replace(GRAPH, classes=GRAPH.classes[::-1])),
        world._replace(graph=replace(GRAPH, frames=GRAPH.frames[:, ::2])),
    ):
        assert fingerprint([other]) != fingerprint([world])
    elsewhere = worker_of(recordings.rings)
    elsewhere._job = replace(elsewhere._job, open=recordings.two_worlds)
    with pytest.raises(DataError, match=r"opens are not those of the learner; give all nodes the same data"):
        elsewhere.begin()


def test_without_ray_one_sentence_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"not installed; get it with: pip install 'activelsd\[ray\]'"):
        actors()


def test_a_cluster_that_is_not_there_is_said_at_once() -> None:
    pytest.importorskip("ray", reason=REASON)
    began = time.monotonic()
    with pytest.raises(ConfigError, match=r"train\.ray\.address=127\.0\.0\.1:9 cannot be joined \(.*refused"):
        actors(address="127.0.0.1:9").collect(EPSILON)
    assert time.monotonic() < began + 30
