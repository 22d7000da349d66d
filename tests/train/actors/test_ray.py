"""Ray's workers: they play what resident actors play, anywhere; processes and nodes are killed under them."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from activelsd import launch
from activelsd.compose import resolve
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import Recording, union
from activelsd.errors import ConfigError, DataError, TrainingError
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.ray import worker
from activelsd.train.actors.ray.actors import RayActors
from activelsd.train.actors.ray.worker import Job, Worker, fingerprint
from activelsd.train.actors.resident import on_recordings
from activelsd.train.learner import Learner
from activelsd.train.run import Run
from activelsd.train.settings import RaySettings, TrainSettings
from activelsd.train.trainer import Trainer, new_network
from tests.train.actors import recordings
from tests.train.actors.mischief import GRAPH
from tests.train.actors.test_failures import alive

EPSILON = Epsilon(0.3, 0.2)
REASON = "needs Ray: pip install 'activelsd[ray]'"


def network_for(worlds: Sequence[Recording]) -> LSDNet:
    tree = union([tree_of(world.graph) for world in worlds])
    return new_network(tree, NetworkShape(size=GRAPH.size, features=16), 1)


def settings_of(dropout: float = 0.0, **ray: Any) -> TrainSettings:
    chosen = {"workers": 2, "envs_per_worker": 3, **ray}
    return TrainSettings(actors="ray", length=4, dropout=dropout, guided=0.5, ray=RaySettings(**chosen))


def worker_of(open_worlds: Callable[[], Sequence[Recording]], seed: int = 5, dropout: float = 0.0) -> Worker:
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
    """As Ray hands them over: read-only."""
    arrays = {name: value.numpy().copy() for name, value in network.state_dict().items()}
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


def actors(
    open_worlds: Callable[[], Sequence[Recording]] = recordings.rings,
    worlds: Callable[[], Sequence[Recording]] = recordings.rings,
    **ray: Any,
) -> RayActors:
    return RayActors(open_worlds, worlds(), network_for(worlds()), settings_of(**ray), 3)


# What needs no cluster.


@pytest.mark.parametrize("open_worlds", [recordings.rings, recordings.rooms])
def test_a_worker_plays_what_resident_actors_play_with_the_weights_it_is_given(
    open_worlds: Callable[[], Sequence[Recording]],
) -> None:
    worlds = open_worlds()
    network = network_for(worlds)
    resident = on_recordings(worlds, TrainSettings(envs=3, length=4, guided=0.5), frames=1)(network, 5)
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
        assert np.array_equal(state, rollout.state)
        assert np.array_equal(bootstrap, rollout.bootstrap)


@pytest.mark.parametrize("dropout", [0.0, 0.5])
def test_without_lag_nothing_is_corrected_and_with_it_something_is(dropout: float) -> None:
    pytest.importorskip("ray", reason=REASON)
    crew = actors()
    network, settings = crew._network, settings_of()
    workers = [worker_of(recordings.rings, seed, dropout) for seed in (1, 2)]
    played = [(worker.play(weights_of(network), 0, EPSILON), 0) for worker in workers]
    rollout = crew._rollout(played, EPSILON)
    assert rollout.rewards.shape == (4, 6)
    assert rollout.nearer is not None
    assert rollout.nearer.shape == rollout.mask.shape
    corrected = Learner(network, settings).losses(rollout, 0.0).total.item()
    plain = Learner(network, settings).losses(replace(rollout, behaviour=None), 0.0).total.item()
    assert corrected == pytest.approx(plain, rel=1e-5)
    with torch.no_grad():
        network.policy.weight.mul_(20.0)  # the learner is ahead
    corrected = Learner(network, settings).losses(rollout, 0.0).total.item()
    plain = Learner(network, settings).losses(replace(rollout, behaviour=None), 0.0).total.item()
    assert corrected != pytest.approx(plain, rel=5e-5)


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
    for value in (*vars(rollout).values(), *rollout.observation.values()):
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


def test_a_worker_waits_for_the_process_that_prepares_its_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "_GLANCE", 0.01)
    found = worker_of(recordings.rings)
    found._job = replace(found._job, open=partial(recordings.busy, tmp_path / "tried"))
    found.begin()
    assert (tmp_path / "tried").exists()


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


# On two nodes of this machine.


class Nodes:
    """A cluster of two nodes: the head, which is not lost, and one that may be."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster

        self._cluster = Cluster(
            initialize_head=True,
            head_node_args={"num_cpus": 2, "include_dashboard": False, "object_store_memory": 100_000_000},
        )
        self.address: str = self._cluster.address
        self.second: Any = None
        self.extend()

    def extend(self) -> None:
        """Have a second node, if there is none."""
        if self.second is None:
            self.second = self._cluster.add_node(num_cpus=1, object_store_memory=100_000_000)

    def kill(self) -> None:
        """Kill the second node, all its processes at once."""
        self._cluster.remove_node(self.second, allow_graceful=False)
        self.second = None

    def shutdown(self) -> None:
        self._cluster.shutdown()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Nodes]:
    pytest.importorskip("ray", reason=REASON)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_health_check_period_ms", "500")  # a lost node is found out in a second, not ten
        patch.setenv("RAY_health_check_failure_threshold", "2")
        nodes = Nodes()
        yield nodes
        nodes.shutdown()


@pytest.fixture
def nodes(cluster: Nodes) -> Nodes:
    cluster.extend()
    return cluster


def collect_until(crew: RayActors, happened: Callable[[dict[str, float]], bool]) -> dict[str, float]:
    """Collect until the measures, losses summed up, show something."""
    deadline, lost = time.monotonic() + 60, 0.0
    while True:
        rollout = crew.collect(EPSILON)
        ended = rollout.terminated | rollout.truncated
        assert bool((rollout.first[1:] == ended[:-1]).all())
        measures = crew.measures()
        lost += measures["ray/workers_lost"]
        if happened(measures | {"ray/workers_lost": lost}):
            return measures
        assert time.monotonic() < deadline


def process_on(crew: RayActors, *, second: bool, nodes: Nodes) -> int:
    places = [hand.place for hand in crew._crew.hands if hand.place]
    return next(place.pid for place in places if (place.node == nodes.second.node_id) == second)


@pytest.mark.slow
def test_a_run_goes_on_without_what_is_killed_and_learns_what_resident_actors_learn(
    nodes: Nodes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ends, shape = {}, NetworkShape(size=GRAPH.size, features=32)

    def lose(network: LSDNet) -> dict[str, float]:
        """Once each: a process, then a node."""
        crew = trainer.actors
        if isinstance(crew, RayActors) and not caplog.messages:
            collect_until(crew, lambda now: now["ray/workers"] == 2)
            os.kill(process_on(crew, second=False, nodes=nodes), signal.SIGKILL)
            collect_until(crew, lambda now: now["ray/workers_lost"] == 1)
        elif isinstance(crew, RayActors) and nodes.second is not None:
            collect_until(crew, lambda now: now["ray/workers"] == 2)
            process_on(crew, second=True, nodes=nodes)
            nodes.kill()
            collect_until(crew, lambda now: now["ray/workers_lost"] >= 1 and now["ray/workers"] == 2)
        return {}

    for kind in ("resident", "ray"):
        settings = TrainSettings(
            **{"actors": kind, "steps": 24_000, "evaluate_every": 6_000, "log_every": 2_000, "envs": 16},
            **{"loggers": [], "learning_rate": 2e-3},
            ray=RaySettings(address=nodes.address, workers=2, envs_per_worker=8),
        )
        make = on_recordings(recordings.rings(), settings, frames=1)
        if kind == "ray":
            make = partial(make_ray, settings)
        run = Run.create(tmp_path, kind, "")
        trainer = Trainer(run, tree_of(GRAPH), shape, settings, make, seed=0, evaluate=lose)
        trainer.train()
        assert trainer.step >= 24_000
        rows = [json.loads(line) for line in (run.folder / "metrics.jsonl").read_text().splitlines()]
        ends[kind] = sum(row["accuracy"] for row in rows if "accuracy" in row and row["step"] > 18_000) / 3
    assert nodes.second is None
    assert ends["resident"] > 0.9
    assert ends["ray"] > ends["resident"] - 0.15
    assert "is gone" in caplog.messages[0]
    assert "40 steps of an unfinished rollout are lost" in caplog.messages[0]
    assert any("node has died" in message or "unavailable" in message for message in caplog.messages[1:])
    lagging = [row for row in rows if "ray/lag" in row]
    assert all(0 < row["ray/lag"] <= row["ray/lag_max"] for row in lagging)
    assert lagging[-1]["ray/workers"] == 2
    assert int(trainer.actors.state()["begun"]) >= 4


def make_ray(settings: TrainSettings, network: LSDNet, seed: int) -> RayActors:
    return RayActors(recordings.rings, recordings.rings(), network, settings, seed)


@pytest.mark.slow
def test_a_worker_that_hangs_is_replaced_and_one_without_room_is_waited_for(
    nodes: Nodes, caplog: pytest.LogCaptureFixture
) -> None:
    crew = actors(address=nodes.address, workers=4, timeout_s=3.0, training_batch=1)
    try:
        collect_until(crew, lambda now: now["ray/workers"] == 3)
        calls = crew._crew._calls
        (waiting,) = (answer for answer, call in calls.items() if call.hand.place is None)
        calls[waiting] = replace(calls[waiting], deadline=0.0)
        collect_until(crew, lambda now: bool(caplog.messages))
        assert "has found no room for 600 s: the cluster has 3 CPUs of which 0 are free" in caplog.messages[0]
        os.kill(process_on(crew, second=False, nodes=nodes), signal.SIGSTOP)
        collect_until(crew, lambda now: now["ray/workers_lost"] == 1)
        assert "was silent for 3 s" in caplog.messages[1]
        collect_until(crew, lambda now: now["ray/workers"] == 3)  # the one that waited has its place
    finally:
        crew.close()


@pytest.mark.slow
def test_what_cannot_be_mended_ends_it(nodes: Nodes) -> None:
    crew = actors(recordings.broken, address=nodes.address, workers=1, restarts=1)
    with pytest.raises(
        TrainingError, match=r"(?s)Worker 0 \(.* was lost 2 times, more than train.ray.restarts=1"
    ) as error:
        crew.collect(EPSILON)
    crew.close()
    assert "the shelf fell over" in str(error.value)

    crew = actors(recordings.missing, address=nodes.address, workers=1)
    with pytest.raises(DataError, match=r"^There are no views on this node\.$"):
        crew.collect(EPSILON)
    crew.close()


@pytest.mark.slow
def test_a_joined_cluster_goes_on_without_our_workers_and_a_full_one_is_an_error(nodes: Nodes) -> None:
    import ray

    before = signal.getsignal(signal.SIGTERM)
    crew = actors(address=nodes.address)
    crew.collect(EPSILON)
    assert signal.getsignal(signal.SIGTERM) is before  # Ray puts its own in place, which saves nothing
    crew.close()
    crew.close()
    ray.init(address=nodes.address, log_to_driver=False, logging_level=logging.ERROR, namespace="tests")
    make = ray.remote(recordings.Idle)
    names = [f"idle {i}" for i in range(3)]
    try:
        idle = [make.options(num_cpus=1, lifetime="detached", name=name).remote() for name in names]
        ray.get([one.ready.remote() for one in idle], timeout=60)  # all CPUs were free again
        ray.shutdown()
        crew = actors(address=nodes.address, start_timeout_s=1.0)
        with pytest.raises(
            TrainingError, match=r"Worker 0 has found no room for 1 s: the cluster has 3 CPUs of which 0"
        ):
            crew.collect(EPSILON)
        crew.close()
        ray.init(address=nodes.address, log_to_driver=False, logging_level=logging.ERROR, namespace="tests")
        for name in names:
            ray.kill(ray.get_actor(name))
    finally:
        ray.shutdown()


# With a cluster of its own.

WORDS = [
    *("env=modelnet", "env.size=32", "env.dataset.classes=cup,sofa", "env.dataset.train_per_class=2"),
    *("env.dataset.test_per_class=1", "device=cpu", "policy.features=8", "train.loggers=[]"),
    *(
        "train.actors=ray",
        "train.ray.workers=2",
        "train.ray.envs_per_worker=2",
        "train.evaluate_every=10000000",
    ),
    *("train.checkpoint_every=100", "train.log_every=100"),
]


def children(parent: int) -> list[int]:
    """All processes that descend from one."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(FileNotFoundError, ProcessLookupError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
    found, grown = {parent}, True
    while grown:
        more = {pid for pid, of in parents.items() if of in found} - found
        found, grown = found | more, bool(more)
    return sorted(found - {parent})


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_the_cluster_started_for_a_run_ends_at_ctrl_c_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray", reason=REASON)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(Path(launch.__file__).parents[1])
    process = subprocess.Popen(
        [sys.executable, "-m", "activelsd", "train", *WORDS, "train.steps=100000000"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    while not (checkpoints := list(tmp_path.glob("runs/*/checkpoints/[0-9]*"))):
        assert process.poll() is None
        time.sleep(0.05)
    folder, started = checkpoints[0].parents[1], children(process.pid)
    assert len(started) > 3
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    said = process.communicate(timeout=60)[1].decode()
    assert process.returncode == 130
    assert said.splitlines()[-1].endswith(f"activelsd train --resume runs/{folder.name}")
    assert "Traceback" not in said
    assert not any(alive(pid) for pid in started)

    before = set(children(os.getpid()))
    reached = int(Run(folder).checkpoint.name)
    launch.resume(folder, [f"train.steps={reached + 200}"])
    assert int(Run(folder).checkpoint.name) >= reached + 200
    assert not any(alive(pid) for pid in set(children(os.getpid())) - before)


def test_v_trace_comes_with_ray_and_is_not_turned_off() -> None:
    assert resolve(WORDS).train.corrects_lag
    assert not resolve([*WORDS, "train.actors=ga3c"]).train.corrects_lag
    with pytest.raises(ConfigError, match=r"^train\.vtrace=false would leave the lag of train\.actors=ray"):
        resolve([*WORDS, "train.vtrace=false"])
    with pytest.raises(ConfigError, match=r"^train\.ray\.envs_per_worker=1 leaves a world of 2 without any"):
        resolve(["env=modelnet,avd", "train.actors=ray", "env.size=64", "train.ray.envs_per_worker=1"])
