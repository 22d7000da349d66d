"""Ray's workers for the trainer: sends out the newest weights, and collects rollouts for an update."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate

import numpy as np
import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.envs.base import observation_space
from activelsd.envs.joint import OpenWorld, shares
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.actors.gauges import Gauges
from activelsd.train.actors.ray import cluster
from activelsd.train.actors.ray.worker import Job, Played, fingerprint
from activelsd.train.actors.ray.worker_pool import Policy, WorkerPool
from activelsd.train.actors.trajectory import Trajectory, batch
from activelsd.train.rollout import Rollout
from activelsd.train.settings import TrainSettings

_LEAST_STORE = 100_000_000
"""Bytes of shared memory; Ray needs at least about that."""


class RayActors:
    """N workers, each with its own policy and environments; the first `collect` starts them."""

    def __init__(
        self,
        open_worlds: Callable[[], Sequence[OpenWorld]],
        worlds: Sequence[OpenWorld],
        network: LSDNet,
        settings: TrainSettings,
        seed: int,
    ) -> None:
        """Set up the parts.

        Args:
            open_worlds: a module's function, or a partial of one, that opens the worlds on any node.
            worlds: the same, opened here.
            network: the learner changes it.
            settings: of the training.
            seed: fixes what every worker plays, but not which rollouts share an update.

        Raises:
            ConfigError: Ray is not installed.
            DataError: a world has nothing to train on.
        """
        self._network, self._settings, self._own = network, settings, settings.ray
        for world in worlds:
            world.graph.starts("train")
        job = Job(
            open=open_worlds,
            fingerprint=fingerprint(worlds),
            tree=network.tree,
            shape=network.shape,
            settings=settings,
        )
        self._gauges = Gauges()
        self._pool = WorkerPool(job, seed, self._gauges)
        self._size = self._own.training_batch or self._own.workers
        ends = list(accumulate(shares(self._own.envs_per_worker, len(worlds)), initial=0))
        # A worker's columns of each world; a rollout holds those of all workers, world by world.
        self._columns = {world.name: slice(*ends[i : i + 2]) for i, world in enumerate(worlds)}
        shape = network.shape
        self._space = observation_space(
            shape.size,
            shape.frames,
            crops=shape.crops,
            channels=shape.channels,
            features=None if worlds[0].graph.features is None else (1, network.trunk.embedding),
        )
        self._version, self._joined = 0, False

    @property
    def places(self) -> Mapping[str, slice]:
        """The columns of a rollout that each world has, if there are several."""
        if len(self._columns) == 1:
            return {}
        size = self._size
        return {world: slice(own.start * size, own.stop * size) for world, own in self._columns.items()}

    def collect(self, epsilon: Epsilon) -> Rollout:
        """The next complete rollouts, side by side, on the network's device.

        Raises:
            TrainingError: a worker was lost too often, or the cluster has no room for any.
            UserError: the cluster cannot be joined, or a worker cannot open the worlds.
        """
        first = not self._joined
        if first:
            self._join()
        else:
            self._version += 1
        self._pool.policy = Policy(self._sent_out(), self._version, epsilon)
        if first:
            self._pool.start_workers()
        began = time.monotonic()
        played = self._pool.rollouts(self._size)
        self._gauges.rate("learner_idle", time.monotonic() - began)
        lags = self._version - np.array([version for _, version in played])
        self._gauges.mean("lag", float(lags.mean()))
        self._gauges.peak("lag_max", float(lags.max()))
        return self._rollout(played, epsilon)

    def measures(self) -> dict[str, float]:
        """Metrics of workers, losses, lag and waiting since the last call, as `ray/…`."""
        found = {"workers_lost": 0.0, "steps_lost": 0.0} | self._gauges.read()
        found["workers"] = float(self._pool.playing)
        return {f"ray/{name}": value for name, value in found.items()}

    def state(self) -> dict[str, Tensor]:
        """The number of workers so far, so that those of a resumed run get other episodes."""
        return {"begun": torch.tensor(self._pool.begun)}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""
        self._pool.begun = int(tensors["begun"])

    def close(self) -> None:
        """End the workers, and the cluster if it was started here."""
        if self._joined:
            self._joined = False
            self._pool.dismiss()
            cluster.leave()

    # The cluster.

    def _join(self) -> None:
        if self._own.address is None:
            cluster.start(cpus=self._own.workers, store=self._store())
        else:
            cluster.join(self._own.address)
        self._joined = True

    def _store(self) -> int:
        """Bytes of shared memory for a few versions of the weights and two rollouts of each worker."""
        own = self._own
        views = 2 * own.workers * own.envs_per_worker * self._settings.length
        view: int = sum(part.sample().nbytes for part in self._space.values())
        weights: int = 4 * sum(value.nbytes for value in self._network.state_dict().values())
        return max(_LEAST_STORE, 2 * (views * view + weights))

    def _sent_out(self) -> object:
        """Ray's reference to the current weights; a node fetches them once for all its workers."""
        weights = self._network.state_dict()
        arrays = {name: value.cpu().contiguous().numpy() for name, value in weights.items()}
        return cluster.import_ray().put(arrays)

    def _rollout(self, played: Sequence[tuple[Played, int]], epsilon: Epsilon) -> Rollout:
        network = self._network
        device = network.device
        trajectories = [
            Trajectory(
                steps={name: array[:, columns] for name, array in one.steps.items()}
                | {"version": np.full_like(one.steps["action"][:, columns], version)},
                state={name: torch.tensor(x[columns], device=device) for name, x in one.state.items()},
                bootstrap=one.bootstrap[columns],
            )
            for columns in self._columns.values()
            for one, version in played
        ]
        # Dropout's factors are part of the observation.
        parts = [name for name in (*self._space, "dropout") if name in trajectories[0].steps]
        rollout, _ = batch(trajectories, parts, network.tree.span(CLASSIFY), epsilon, device)
        return rollout
