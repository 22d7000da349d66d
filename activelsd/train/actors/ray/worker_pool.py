"""The workers of a run: starts them, asks them for rollouts, and replaces lost ones."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

import numpy as np

from activelsd.errors import TrainingError, UserError
from activelsd.policy.heads import Epsilon
from activelsd.train.actors.gauges import Gauges
from activelsd.train.actors.ray import cluster
from activelsd.train.actors.ray.worker import Job, Played, Worker, WorkerLocation

_GLANCE = 0.5
"""Seconds between two checks for overdue workers."""

_COLOUR = re.compile(r"\x1b\[\d*m")
"""A terminal's colour codes, which Ray puts into its errors."""

log = logging.getLogger("activelsd.ray")


class Policy(NamedTuple):
    """The weights and exploration for a worker's next rollout."""

    weights: Any  # Ray's reference to arrays by name
    version: int
    epsilon: Epsilon


@dataclass(eq=False)
class WorkerHandle:
    """The learner's record of a worker."""

    number: int
    actor: Any = None  # Ray's handle
    place: WorkerLocation | None = None  # None while the cluster has no free CPU for it
    lost: int = 0  # how often

    def __str__(self) -> str:
        where = self.place
        found = f" (process {where.pid} on node {where.address}, {where.node[:8]})" if where else ""
        return f"Worker {self.number}{found}"


@dataclass(frozen=True, eq=False)
class _Call:
    """A pending call of a worker."""

    handle: WorkerHandle
    then: Callable[[WorkerHandle, Any], None]  # called with the result
    patience: float  # seconds
    deadline: float
    version: int | None  # of the weights, if the call plays a rollout


class WorkerPool:
    """N workers, each with one pending call at any time, so that none plays far ahead of the learner.

    Attributes:
        handles: the workers.
        begun: how many were started so far, including those that were replaced.
        policy: for their next rollouts.
    """

    def __init__(self, job: Job, seed: int, gauges: Gauges) -> None:
        """Start no worker yet; `seed` fixes what every worker plays."""
        self._ray = cluster.import_ray()
        self._job, self._own, self._seed, self._gauges = job, job.settings.ray, seed, gauges
        self.handles = [WorkerHandle(number) for number in range(self._own.workers)]
        self.begun = 0
        self.policy: Policy | None = None
        self._calls: dict[Any, _Call] = {}  # by Ray's reference to the result, the oldest first
        self._played: list[tuple[Played, int]] = []

    @property
    def playing(self) -> int:
        """How many workers are playing."""
        return sum(call.version is not None for call in self._calls.values())

    def start_workers(self) -> None:
        """Start all workers."""
        for handle in self.handles:
            self._start_worker(handle)

    def rollouts(self, size: int) -> list[tuple[Played, int]]:
        """The next `size` rollouts, the oldest first, each with the version of the weights that played it.

        Raises:
            TrainingError: a worker was lost too often, or the cluster has no room for any.
            UserError: a worker cannot open the worlds, and the mistake is the user's.
        """
        while len(self._played) < size:
            self._hear(size)
        played, self._played = self._played, []
        return played

    def dismiss(self) -> None:
        """End all workers."""
        for handle in self.handles:
            self._dismiss(handle)
        self._calls.clear()
        self.policy = None

    # The calls of a worker, one after the other.

    def _start_worker(self, handle: WorkerHandle) -> None:
        """Start a worker on any free CPU of the cluster, with episodes that no other has played."""
        begun, self.begun = self.begun, self.begun + 1
        # A worker's environments have consecutive seeds; 31 bits leave room for them.
        seed = int(np.random.SeedSequence(self._seed, spawn_key=(begun,)).generate_state(1)[0] >> 1)
        make = self._ray.remote(Worker).options(num_cpus=1, max_restarts=0, scheduling_strategy="SPREAD")
        handle.actor, handle.place = make.remote(self._job, seed), None
        self._ask(handle, handle.actor.where.remote(), self._own.start_timeout_s, self._begin)

    def _begin(self, handle: WorkerHandle, place: WorkerLocation) -> None:
        handle.place = place
        self._ask(handle, handle.actor.begin.remote(), self._own.start_timeout_s, self._play)

    def _play(self, handle: WorkerHandle, _: object = None) -> None:
        assert self.policy is not None
        weights, version, epsilon = self.policy
        answer = handle.actor.play.remote(weights, version, tuple(epsilon))
        self._ask(handle, answer, self._own.timeout_s, self._play, version)

    def _ask(
        self,
        handle: WorkerHandle,
        answer: Any,
        patience: float,
        then: Callable[[WorkerHandle, Any], None],
        version: int | None = None,
    ) -> None:
        self._calls[answer] = _Call(handle, then, patience, time.monotonic() + patience, version)

    # Their results.

    def _hear(self, size: int) -> None:
        """Handle the results that are ready, the oldest call's first, while rollouts are missing."""
        answers = list(self._calls)
        self._ray.wait(answers, num_returns=1, timeout=_GLANCE)
        there = set(self._ray.wait(answers, num_returns=len(answers), timeout=0)[0])
        now = time.monotonic()
        for answer in answers:
            call = self._calls[answer]
            if answer not in there:
                if now > call.deadline:
                    self._overdue(answer, call)
            elif len(self._played) < size:
                del self._calls[answer]
                self._answered(answer, call)

    def _answered(self, answer: Any, call: _Call) -> None:
        errors = self._ray.exceptions
        try:
            found = self._ray.get(answer, timeout=self._own.timeout_s)
        except errors.RayError as error:
            mistake = isinstance(error, errors.RayTaskError) and isinstance(error.cause, UserError)
            failure = error.cause if mistake else error
        else:
            if call.version is not None:
                self._played.append((found, call.version))
            call.then(call.handle, found)
            return
        if mistake:
            raise failure
        self._lose(call, f"failed or is gone:\n{_COLOUR.sub('', str(failure))}")

    def _overdue(self, answer: Any, call: _Call) -> None:
        del self._calls[answer]
        if call.handle.place is not None:
            self._lose(call, f"was silent for {call.patience:g} s")
            return
        text = f"{call.handle} has found no room for {call.patience:g} s: {cluster.room()}"
        if not any(handle.place for handle in self.handles):
            raise TrainingError(
                f"{text}; free some or add nodes, or raise train.ray.start_timeout_s, and resume from"
                " the last checkpoint."
            )
        log.warning("%s. It keeps waiting, and the others play without it.", text)
        self._ask(call.handle, answer, inf, call.then)

    def _lose(self, call: _Call, how: str) -> None:
        """Replace a worker, whose unfinished rollout is lost; too many losses raise TrainingError."""
        handle, own = call.handle, self._own
        handle.lost += 1
        steps = 0 if call.version is None else own.envs_per_worker * self._job.settings.length
        self._gauges.count(workers_lost=1, steps_lost=steps)
        who = str(handle)
        self._dismiss(handle)
        if handle.lost > own.restarts:
            raise TrainingError(
                f"{who} was lost {handle.lost} times, more than train.ray.restarts={own.restarts}; fix what"
                f" fails there and resume from the last checkpoint. The last time it {how}"
            )
        log.warning(
            "%s %s\nAnother is started (%d of %d times); %d steps of an unfinished rollout are lost.",
            who,
            how,
            handle.lost,
            own.restarts,
            steps,
        )
        self._start_worker(handle)

    def _dismiss(self, handle: WorkerHandle) -> None:
        if handle.actor is not None:
            with suppress(self._ray.exceptions.RayError):
                self._ray.kill(handle.actor)
            handle.actor = None
