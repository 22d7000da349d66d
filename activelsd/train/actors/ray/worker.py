"""A worker: an agent with environments and a policy of its own, in whatever process it is put."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from activelsd.envs.actions import ActionTree
from activelsd.envs.cache import CacheBusyError
from activelsd.envs.joint import OpenWorld
from activelsd.errors import DataError
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.resident import on_recordings
from activelsd.train.settings import TrainSettings

_GLANCE = 1.0
"""Seconds between two tries to open what another process of the node prepares."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """What all workers are told.

    Attributes:
        open: opens the worlds where it is called; Ray sends functions of a module by their name.
        fingerprint: of the worlds that the learner has.
        tree: the network's actions.
        shape: of the network.
        settings: of training.
    """

    open: Callable[[], Sequence[OpenWorld]]
    fingerprint: str
    tree: ActionTree
    shape: NetworkShape
    settings: TrainSettings


class WorkerLocation(NamedTuple):
    """Where a worker is."""

    node: str  # Ray's id
    address: str  # of the node
    pid: int


class Played(NamedTuple):
    """L steps of B environments as plain arrays."""

    steps: dict[str, NDArray[Any]]  # each (L, B, ...), by the names that `trajectory.batch` takes
    state: NDArray[np.float32]  # (B, width) memory before the first step
    bootstrap: NDArray[np.float32]  # (B,) value of the state after the last step


class Worker:
    """Plays the training episodes of recorded worlds, L steps at a time, with the weights it is given."""

    def __init__(self, job: Job, seed: int) -> None:
        """Be there; `seed` fixes episodes and actions."""
        self._job, self._seed, self._version = job, seed, -1

    def where(self) -> WorkerLocation:
        """Where Ray has put it."""
        import ray

        return WorkerLocation(
            ray.get_runtime_context().get_node_id(), ray.util.get_node_ip_address(), os.getpid()
        )

    def begin(self) -> None:
        """Open the worlds, which are prepared where this node has not got them yet, and start the episodes.

        Raises:
            UserError: a world cannot be opened, or is not the learner's.
        """
        torch.set_num_threads(1)  # there is a worker for every core
        job, worlds = self._job, _opened(self._job.open)
        if fingerprint(worlds) != job.fingerprint:
            raise DataError(
                f"The worlds that {os.uname().nodename} opens are not those of the learner; give all nodes"
                " the same data and the same version of activelsd."
            )
        self._network = LSDNet(job.tree, job.shape)
        settings = job.settings.model_copy(update={"envs": job.settings.ray.envs_per_worker})
        self._actors = on_recordings(worlds, settings, frames=job.shape.frames)(self._network, self._seed)

    @torch.no_grad()
    def play(
        self, weights: Mapping[str, NDArray[np.float32]], version: int, epsilon: tuple[float, float]
    ) -> Played:
        """The next L steps.

        Args:
            weights: the network's, by name.
            version: of the weights; those it has already are not taken again.
            epsilon: random exploration of branch and leaf.
        """
        if version != self._version:
            # Copies: what Ray handles over lies in shared memory and is read-only.
            self._network.load_state_dict({name: torch.tensor(array) for name, array in weights.items()})
            self._version = version
        rollout = self._actors.collect(Epsilon(*epsilon))
        assert rollout.output is not None
        policy = self._network.distribution(rollout.output.logits, rollout.mask, rollout.epsilon)
        steps = rollout.observation | {
            "first": rollout.first,
            "mask": rollout.mask,
            "label": rollout.labels,
            "views": rollout.views,
            "action": rollout.actions,
            "reward": rollout.rewards,
            "terminated": rollout.terminated,
            "truncated": rollout.truncated,
            "behaviour": policy.log_prob(rollout.actions),
        }
        if rollout.nearer is not None:
            steps["nearer"] = rollout.nearer
        arrays = {name: tensor.numpy() for name, tensor in steps.items()}
        return Played(arrays, rollout.state.numpy(), rollout.bootstrap.numpy())


def fingerprint(worlds: Sequence[OpenWorld]) -> str:
    """A digest of worlds without their pictures, of which only the shapes count.

    Pictures rendered on different processors may differ in a bit, and reading them all takes long.
    """
    digest = hashlib.sha256()
    for world in worlds:
        digest.update(repr((world.name, astuple(world.rules), world.backend)).encode())
        for field in fields(world.graph):
            value = getattr(world.graph, field.name)
            if isinstance(value, np.ndarray):
                digest.update(repr((field.name, value.shape, str(value.dtype))).encode())
                if field.name not in ("frames", "crops"):
                    digest.update(np.ascontiguousarray(value).data)
            else:
                digest.update(repr((field.name, value)).encode())
    return digest.hexdigest()


def _opened(open_worlds: Callable[[], Sequence[OpenWorld]]) -> Sequence[OpenWorld]:
    """The worlds, as soon as no other process of this node prepares them."""
    while True:
        try:
            return open_worlds()
        except CacheBusyError:  # noqa: PERF203  it is tried again, seconds later
            time.sleep(_GLANCE)
