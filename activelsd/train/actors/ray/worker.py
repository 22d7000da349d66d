"""A worker: an agent with environments and a policy of its own, in whatever process it is put."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from activelsd.envs.actions import ActionTree
from activelsd.envs.joint import OpenWorld
from activelsd.errors import DataError
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.resident import on_recordings
from activelsd.train.settings import TrainSettings


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """What all workers are given.

    Attributes:
        open: opens the worlds in the process that calls it; Ray sends a module's functions by name.
        fingerprint: of the learner's worlds.
        tree: the network's actions.
        shape: of the network.
        settings: of the training.
    """

    open: Callable[[], Sequence[OpenWorld]]
    fingerprint: str
    tree: ActionTree
    shape: NetworkShape
    settings: TrainSettings


class WorkerLocation(NamedTuple):
    """The node and process of a worker."""

    node: str  # Ray's id
    address: str  # of the node
    pid: int


class Played(NamedTuple):
    """L steps of B environments as plain arrays."""

    steps: dict[str, NDArray[Any]]  # each (L, B, ...), by the names that `trajectory.batch` takes
    state: dict[str, NDArray[Any]]  # of the memory before the first step, each (B, ...)
    bootstrap: NDArray[np.float32]  # (B,) value of the state after the last step


class Worker:
    """Plays the training episodes of recorded worlds, L steps at a time, with the weights it is given."""

    def __init__(self, job: Job, seed: int) -> None:
        """Store the job; `begin` opens the worlds. `seed` fixes episodes and actions."""
        self._job, self._seed, self._version = job, seed, -1

    def where(self) -> WorkerLocation:
        """The node and process in which Ray has put it."""
        import ray

        return WorkerLocation(
            ray.get_runtime_context().get_node_id(), ray.util.get_node_ip_address(), os.getpid()
        )

    def begin(self) -> None:
        """Open the worlds, preparing those that this node does not have yet, and start the episodes.

        Raises:
            UserError: a world cannot be opened, or differs from the learner's.
        """
        torch.set_num_threads(1)  # each core has its own worker
        job, worlds = self._job, self._job.open()
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
            version: of the weights, which are loaded only if it is new.
            epsilon: random exploration of branch and leaf.
        """
        if version != self._version:
            # Copied, because Ray's arrays are read-only shared memory.
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
        state = {name: tensor.numpy() for name, tensor in rollout.state.items()}
        return Played(arrays, state, rollout.bootstrap.numpy())


def fingerprint(worlds: Sequence[OpenWorld]) -> str:
    """A digest of worlds; pictures count only by their shape.

    Pictures rendered on different processors may differ in a bit, and reading them all takes long.
    """
    digest = hashlib.sha256()
    for world in worlds:
        digest.update(repr((world.name, astuple(world.rules), world.backend)).encode())
        for field in fields(world.graph):
            value = getattr(world.graph, field.name)
            if field.name == "features":
                digest.update(repr([one.shape for one in value or ()]).encode())
            elif isinstance(value, np.ndarray):
                digest.update(repr((field.name, value.shape, str(value.dtype))).encode())
                if field.name not in ("frames", "crops"):
                    digest.update(np.ascontiguousarray(value).data)
            else:
                digest.update(repr((field.name, value)).encode())
    return digest.hexdigest()
