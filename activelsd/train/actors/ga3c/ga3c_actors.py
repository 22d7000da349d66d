"""GA3C's actors as the trainer sees them: agents, queues, predictors and trainers behind `collect`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.envs.base import observation_space
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.actors.ga3c.agent import Agent, AgentContext
from activelsd.train.actors.ga3c.batcher import Batch, BatcherThread
from activelsd.train.actors.ga3c.dynamic import Adjuster, ThreadCounts, Walk
from activelsd.train.actors.ga3c.predictor import Predictor, PredictorState
from activelsd.train.actors.ga3c.process import EnvSpec, Lifeline, ProcessStepper
from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.ga3c.slots import Layout, Slots
from activelsd.train.actors.ga3c.stepper import Env, LocalStepper, Stepper
from activelsd.train.actors.ga3c.trajectory_writer import TrajectoryWriter
from activelsd.train.actors.gauges import Gauges
from activelsd.train.actors.trajectory import Trajectory, batch
from activelsd.train.augment import VARIATION_SIZE, Variation
from activelsd.train.rollout import Rollout
from activelsd.train.settings import GA3CSettings

_JOIN = 30.0
"""Seconds that a thread has to end; one that an environment of this process holds is left behind."""


class GA3CActors:
    """Many agents, one network, one world; nothing is started before the first `collect`."""

    places: Mapping[str, slice] = {}

    def __init__(
        self,
        world: EnvSpec | Callable[[], Env],
        network: LSDNet,
        settings: GA3CSettings,
        length: int,
        seed: int,
        *,
        vary_crops: bool = False,
        mirror: bool = False,
        dropout: float = 0.0,
    ) -> None:
        """Set out the parts.

        Args:
            world: what processes make an environment from, or what makes one for a thread of this process.
            network: plays; the learner changes it.
            settings: how many of everything.
            length: L, steps of a trajectory.
            seed: fixes which episodes are drawn; which actions, only as far as threads keep their order.
            vary_crops: whether episodes' crops are cut and lit otherwise.
            mirror: whether every other episode is seen in a mirror.
            dropout: share of the memory's features left out at every look, in acting and learning.
        """
        self._world, self._settings, self._length, self._seed = world, settings, length, seed
        shape = network.shape
        self._counts = ThreadCounts(settings.agents, settings.predictors, settings.trainers)
        self._most = ThreadCounts(*(2 * n for n in self._counts)) if settings.dynamic else self._counts
        layout = Layout.of(
            observation_space(shape.size, shape.frames, crops=shape.crops),
            agents=self._most.agents,
            lanes=settings.lanes,
            envs=settings.envs_per_agent // settings.lanes,
            actions=network.tree.n,
        )
        size = max(1, (settings.training_batch or settings.agents * settings.envs_per_agent) // layout.envs)
        self._gauges = Gauges()
        self._asks: BatchQueue[tuple[int, int]] = BatchQueue()
        self._full: BatchQueue[Trajectory] = BatchQueue(limit=size)
        self._orders: BatchQueue[None] = BatchQueue()
        self._ready: BatchQueue[Batch] = BatchQueue()
        self._ordered = 0  # batches not yet taken
        self._size, self._layout = size, layout
        memory = network.initial_state(layout.rows * layout.envs).view(layout.rows, layout.envs, -1)
        device, crops = memory.device, vary_crops and shape.crops
        self._desk = PredictorState(
            network,
            Slots(layout),
            {},
            memory,
            self._full,
            self._gauges,
            Variation([network.tree], network.tree, device, crops=crops, mirror=mirror),
            torch.zeros(layout.rows, layout.envs, VARIATION_SIZE, device=device),
            dropout,
        )
        self._predictors: list[Predictor] = []
        self._trainers: list[BatcherThread] = []
        self._adjuster: Adjuster | None = None
        self._lifeline = Lifeline.open()
        self._lock, self._begun = threading.Lock(), 0  # players so far: each has episodes of its own
        self._drawing = count()  # predictors so far: each draws actions of its own
        self._steps, self._closed, self._starting = 0, False, threading.Lock()
        self._failure: Exception | None = None

    # What the trainer asks for.

    def collect(self, epsilon: Epsilon) -> Rollout:
        """The next batch of trajectories, on the network's device.

        Raises:
            TrainingError: an agent was lost too often.
            UserError: the environment cannot be made, or is not the one the network is for.
        """
        self._desk.epsilon = epsilon
        if self._predictors:
            self._desk.version += 1
        else:
            with self._starting:
                if not self._closed:
                    self._start()
        self._gauges.mean("training_queue", len(self._full) * self._layout.envs)
        began = time.monotonic()
        try:
            while self._ordered < max(1, len(self._trainers)):
                self._orders.put(None)
                self._ordered += 1
            rollout, versions = self._ready.take(1, 1)[0]
            self._ordered -= 1
        except ClosedError:
            if self._failure is None:
                raise
            raise self._failure from None
        self._gauges.rate("learner_idle", time.monotonic() - began)
        lag = self._desk.version - versions
        self._gauges.mean("lag", float(lag.mean()))
        self._gauges.peak("lag_max", float(lag.max()))
        self._steps += lag.size
        return rollout

    def measures(self) -> dict[str, float]:
        """Queues, batches, waiting, lag and losses of the time since the last call, as `ga3c/…`."""
        found = {"agents_lost": 0.0, "episodes_cut": 0.0, "steps_lost": 0.0} | self._gauges.read()
        found["agents"] = float(sum(agent.player is not None for agent in self._desk.agents.values()))
        found |= {"predictors": float(len(self._predictors)), "trainers": float(len(self._trainers))}
        return {f"ga3c/{name}": value for name, value in found.items()}

    def state(self) -> dict[str, Tensor]:
        """How many players have begun: those of a resumed run play on with episodes not yet drawn."""
        return {"begun": torch.tensor(self._begun)}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""
        self._begun = int(tensors["begun"])

    def close(self) -> None:
        """End every thread and process."""
        if self._closed:
            return
        self._closed = True
        for queue in (self._asks, self._full, self._orders, self._ready):
            queue.close()
        with self._starting:  # another thread may be at it; after this it finds that all is closed
            self._release()
        if self._adjuster is not None:
            self._adjuster.stop()
            self._adjuster.join()
            self._release()  # those it had begun meanwhile
        for thread in (*self._predictors, *self._trainers, *self._desk.agents.values()):
            thread.join(_JOIN)
        self._lifeline.close()
        self._desk.slots.close()

    # How it comes about.

    def _release(self) -> None:
        for agent in list(self._desk.agents.values()):
            agent.stop()
            for lane in range(self._layout.lanes):
                agent.answer(lane)  # nobody else does any more

    def _start(self) -> None:
        settings = self._settings
        self._around = AgentContext(
            world=self._world.id if isinstance(self._world, EnvSpec) else "a thread's environment",
            make=self._player,
            asks=self._asks,
            starting=threading.Semaphore(settings.starting),
            restarts=settings.restarts,
            gauges=self._gauges,
            fail=self._fail,
        )
        self._resize(self._counts)
        if settings.dynamic:
            self._adjuster = Adjuster(
                Walk(self._counts, self._most, self._seed),
                every=settings.dynamic_every_s,
                steps=lambda: self._steps,
                resize=self._resize,
                fail=self._fail,
            )
            self._adjuster.start()

    def _resize(self, counts: ThreadCounts) -> None:
        """Start or end agents, predictors and trainers until there are so many."""
        agents = self._desk.agents
        for number in range(len(agents), counts.agents):
            recorders = [self._recorder() for _ in range(self._layout.lanes)]
            agents[number] = Agent(number, recorders, self._around)
            agents[number].start()
        leaving = [agents[number] for number in range(counts.agents, len(agents))]
        for agent in leaving:
            agent.stop()
        for agent in leaving:
            agent.join()
            del agents[agent.number]
        _resize(self._trainers, counts.trainers, self._trainer)
        _resize(self._predictors, counts.predictors, self._predictor)

    def _recorder(self) -> TrajectoryWriter:
        dropped = self._desk.network.memory.outputs if self._desk.dropout else 0
        return TrajectoryWriter(self._layout, self._length, dropped)

    def _player(self, number: int, wanted: Callable[[], bool]) -> Stepper:
        with self._lock:
            begun, self._begun = self._begun, self._begun + 1
        # Environments of a player are seeded one after the other; 31 bits, as simulators want them.
        seed = int(np.random.SeedSequence(self._seed, spawn_key=(begun,)).generate_state(1)[0] >> 1)
        slots = self._desk.slots
        if not isinstance(self._world, EnvSpec):
            return LocalStepper(self._world, slots, number, seed)
        return ProcessStepper(
            self._world,
            slots,
            number,
            seed,
            lifeline=self._lifeline,
            start_timeout=self._settings.start_timeout_s,
            timeout=self._settings.timeout_s,
            wanted=wanted,
        )

    def _predictor(self) -> Predictor:
        settings, key = self._settings, (1, next(self._drawing))
        return Predictor(
            self._desk,
            self._asks,
            most=max(1, settings.prediction_batch // self._layout.envs),
            patience=settings.prediction_wait_ms / 1000,
            seed=int(np.random.SeedSequence(self._seed, spawn_key=key).generate_state(1)[0]),
            fail=self._fail,
        )

    def _trainer(self) -> BatcherThread:
        return BatcherThread(
            self._make_batch, self._orders, self._full, self._ready, size=self._size, fail=self._fail
        )

    def _make_batch(self, trajectories: Sequence[Trajectory]) -> Batch:
        desk = self._desk
        left_out = ("dropout",) if desk.dropout else ()  # it is part of what was seen
        return Batch(
            *batch(
                trajectories,
                (*self._layout.observation, *left_out),
                desk.network.tree.span(CLASSIFY),
                desk.epsilon,
                desk.memory.device,
            )
        )

    def _fail(self, error: Exception) -> None:
        """Have the learner raise an error, the first if there are several."""
        self._failure = self._failure or error
        for queue in (self._asks, self._full, self._orders, self._ready):
            queue.close()


class _Worker(Protocol):
    def start(self) -> None: ...
    def stop(self) -> None: ...
    def join(self) -> None: ...


Thread = TypeVar("Thread", bound=_Worker)


def _resize(threads: list[Thread], size: int, make: Callable[[], Thread]) -> None:
    while len(threads) < size:
        threads.append(make())
        threads[-1].start()
    leaving = threads[size:]
    for thread in leaving:
        thread.stop()
    for thread in leaving:
        thread.join()
    del threads[size:]
