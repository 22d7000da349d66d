"""Ray's workers on two nodes of this machine: processes and nodes are killed under them."""

from __future__ import annotations

import json
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from activelsd.envs.graphenv import tree_of
from activelsd.errors import DataError, TrainingError
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.ray.ray_actors import RayActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import RaySettings, TrainSettings
from activelsd.train.trainer import Trainer
from tests.train.actors import recordings
from tests.train.actors.mischief import GRAPH
from tests.train.actors.ray_pool import EPSILON, REASON, actors


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
    places = [handle.place for handle in crew._pool.handles if handle.place]
    return next(place.pid for place in places if (place.node == nodes.second.node_id) == second)


@pytest.mark.slow
def test_a_run_goes_on_without_what_is_killed_and_learns_what_resident_actors_learn(
    nodes: Nodes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ends, shape = {}, NetworkShape(size=GRAPH.size, trunk_settings={"features": 32})

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
        calls = crew._pool._calls
        (waiting,) = (answer for answer, call in calls.items() if call.handle.place is None)
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
