"""GA3C's actors for the trainer: agents, queues, predictors and trainers behind `collect`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Protocol, TypeVar

import gymnasium
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
"""Seconds that a thread has to end; one that hangs in an environment of this process is left behind."""


class GA3CActors:
    """Many agents, one network, one world; the first `collect` starts them."""

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
        features: tuple[int, int] | None = None,
    ) -> None:
        """Set up the parts.

        Args:
            world: from what processes make an environment, or makes one for a thread of this process.
            network: acts; the learner changes it.
            settings: numbers of threads and sizes of batches.
            length: L, steps of a trajectory.
            seed: fixes which episodes are drawn; which actions, only as far as threads keep their order.
            vary_crops: whether crops vary from episode to episode.
            mirror: whether every other episode is mirrored.
            dropout: share of the memory's outputs dropped at every view, in acting and learning.
            features: (W, F) if observations hold features in place of what the trunk is shown.

        Raises:
            ConfigError: episodes are to be mirrored, and a move has no opposite.
        """
        self._world, self._settings, self._length, self._seed = world, settings, length, seed
        shape = network.shape
        self._counts = ThreadCounts(settings.agents, settings.predictors, settings.trainers)
        self._most = ThreadCounts(*(2 * n for n in self._counts)) if settings.dynamic else self._counts
        space = observation_space(
            shape.size, shape.frames, crops=shape.crops, channels=shape.channels, features=features
        )
        if features is not None:
            names = ("features", "target", *network.pictures)
            space = gymnasium.spaces.Dict({name: space[name] for name in names})
        layout = Layout.of(
            space,
            agents=self._most.agents,
            lanes=settings.lanes,
            envs=settings.envs_per_agent // settings.lanes,
            actions=network.tree.n,
        )
        size = max(1, (settings.training_batch or settings.agents * settings.envs_per_agent) // layout.envs)
        self._gauges = Gauges()
        self._requests: BatchQueue[tuple[int, int]] = BatchQueue()
        self._full: BatchQueue[Trajectory] = BatchQueue(limit=size)
        self._orders: BatchQueue[None] = BatchQueue()
        self._ready: BatchQueue[Batch] = BatchQueue()
        self._ordered = 0  # batches ordered and not yet taken
        self._size, self._layout = size, layout
        rows, device, crops = (layout.rows, layout.envs), network.device, vary_crops and shape.crops
        state = network.initial_state(layout.rows * layout.envs)
        self._predictor_state = PredictorState(
            network,
            Slots(layout),
            {},
            {name: x.view(*rows, *x.shape[1:]) for name, x in state.items()},
            self._full,
            self._gauges,
            Variation([network.tree], network.tree, device, crops=crops, mirror=mirror),
            torch.zeros(*rows, VARIATION_SIZE, device=device),
            dropout,
        )
        self._predictors: list[Predictor] = []
        self._trainers: list[BatcherThread] = []
        self._adjuster: Adjuster | None = None
        self._lifeline = Lifeline.open()
        self._lock, self._begun = threading.Lock(), 0  # players so far: each has its own episodes
        self._drawing = count()  # predictors so far: each has its own generator
        self._steps, self._closed, self._starting = 0, False, threading.Lock()
        self._failure: Exception | None = None

    # The interface of `Actors`.

    def collect(self, epsilon: Epsilon) -> Rollout:
        """The next batch of trajectories, on the network's device.

        Raises:
            TrainingError: an agent was lost too often.
            UserError: the environment cannot be made, or is not the one the network is for.
        """
        self._predictor_state.epsilon = epsilon
        if self._predictors:
            self._predictor_state.version += 1
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
        lag = self._predictor_state.version - versions
        self._gauges.mean("lag", float(lag.mean()))
        self._gauges.peak("lag_max", float(lag.max()))
        self._steps += lag.size
        return rollout

    def measures(self) -> dict[str, float]:
        """Metrics of queues, batches, waiting, lag and losses since the last call, as `ga3c/…`."""
        found = {"agents_lost": 0.0, "episodes_cut": 0.0, "steps_lost": 0.0} | self._gauges.read()
        found["agents"] = float(
            sum(agent.player is not None for agent in self._predictor_state.agents.values())
        )
        found |= {"predictors": float(len(self._predictors)), "trainers": float(len(self._trainers))}
        return {f"ga3c/{name}": value for name, value in found.items()}

    def state(self) -> dict[str, Tensor]:
        """The number of players so far, so that those of a resumed run get other episodes."""
        return {"begun": torch.tensor(self._begun)}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""
        self._begun = int(tensors["begun"])

    def close(self) -> None:
        """End every thread and process."""
        if self._closed:
            return
        self._closed = True
        for queue in (self._requests, self._full, self._orders, self._ready):
            queue.close()
        with self._starting:  # another thread may be starting agents; it then finds that all is closed
            self._release()
        if self._adjuster is not None:
            self._adjuster.stop()
            self._adjuster.join()
            self._release()  # the agents it has started meanwhile
        for thread in (*self._predictors, *self._trainers, *self._predictor_state.agents.values()):
            thread.join(_JOIN)
        self._lifeline.close()
        self._predictor_state.slots.close()

    # Threads.

    def _release(self) -> None:
        for agent in list(self._predictor_state.agents.values()):
            agent.stop()
            for lane in range(self._layout.lanes):
                agent.answer(lane)  # no predictor does any more

    def _start(self) -> None:
        settings = self._settings
        self._context = AgentContext(
            world=self._world.id if isinstance(self._world, EnvSpec) else "a thread's environment",
            make=self._player,
            requests=self._requests,
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
        """Start or end agents, predictors and trainers until the counts are reached."""
        agents = self._predictor_state.agents
        for number in range(len(agents), counts.agents):
            writers = [self._writer() for _ in range(self._layout.lanes)]
            agents[number] = Agent(number, writers, self._context)
            agents[number].start()
        leaving = [agents[number] for number in range(counts.agents, len(agents))]
        for agent in leaving:
            agent.stop()
        for agent in leaving:
            agent.join()
            del agents[agent.number]
        _resize(self._trainers, counts.trainers, self._trainer)
        _resize(self._predictors, counts.predictors, self._predictor)

    def _writer(self) -> TrajectoryWriter:
        dropped = self._predictor_state.network.memory.outputs if self._predictor_state.dropout else 0
        return TrajectoryWriter(self._layout, self._length, dropped)

    def _player(self, number: int, wanted: Callable[[], bool]) -> Stepper:
        with self._lock:
            begun, self._begun = self._begun, self._begun + 1
        # A player's environments have consecutive seeds, of 31 bits, which simulators accept.
        seed = int(np.random.SeedSequence(self._seed, spawn_key=(begun,)).generate_state(1)[0] >> 1)
        slots = self._predictor_state.slots
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
            self._predictor_state,
            self._requests,
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
        state = self._predictor_state
        dropout = ("dropout",) if state.dropout else ()  # its factors are part of the observation
        return Batch(
            *batch(
                trajectories,
                (*self._layout.observation, *dropout),
                state.network.tree.span(CLASSIFY),
                state.epsilon,
                state.network.device,
            )
        )

    def _fail(self, error: Exception) -> None:
        """Have the learner raise an error; the first if there are several."""
        self._failure = self._failure or error
        for queue in (self._requests, self._full, self._orders, self._ready):
            queue.close()


class _Stoppable(Protocol):
    def start(self) -> None: ...
    def stop(self) -> None: ...
    def join(self) -> None: ...


Thread = TypeVar("Thread", bound=_Stoppable)


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
