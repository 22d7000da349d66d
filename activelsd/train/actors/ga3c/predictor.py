"""Predictors answer waiting requests of agents, as many as there are in one pass of the network."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet
from activelsd.policy.memories import State
from activelsd.train.actors.ga3c.agent import Agent
from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.ga3c.slots import Slots
from activelsd.train.actors.gauges import Gauges
from activelsd.train.actors.trajectory import Trajectory
from activelsd.train.augment import Variation, kept


@dataclass(eq=False)
class PredictorState:
    """State that the predictors share.

    Attributes:
        network: chooses actions; the learner changes its weights meanwhile.
        slots: agents write observations there, and predictors actions.
        agents: by index.
        memory: the memory's state of every episode, each (rows, envs, ...), on the network's device.
        trajectories: the training queue.
        gauges: measures batches, queues and waiting.
        variation: augments what environments show.
        variations: (rows, envs, VARIATION_SIZE) of every episode, on the network's device.
        dropout: share of the memory's outputs dropped at every view.
        epsilon: current exploration.
        version: of the weights, in updates.
    """

    network: LSDNet
    slots: Slots
    agents: dict[int, Agent]
    memory: State
    trajectories: BatchQueue[Trajectory]
    gauges: Gauges
    variation: Variation
    variations: Tensor
    dropout: float = 0.0
    epsilon: Epsilon = Epsilon()
    version: int = 0


class Predictor(threading.Thread):
    """A thread that answers requests."""

    def __init__(
        self,
        state: PredictorState,
        requests: BatchQueue[tuple[int, int]],
        *,
        most: int,
        patience: float,
        seed: int,
        fail: Callable[[Exception], None],
    ) -> None:
        """Answer the requests in a queue.

        Args:
            state: shared with other predictors.
            requests: the prediction queue, of agents' indices and lanes.
            most: lanes answered at once.
            patience: seconds that a request may wait for others.
            seed: of the actions drawn.
            fail: called with the error that ends the training.
        """
        super().__init__(name="predictor", daemon=True)
        self._state, self._requests, self._fail = state, requests, fail
        self._most, self._patience = most, patience
        self._generator = torch.Generator(state.network.device).manual_seed(seed)
        self._stopping = False

    def stop(self) -> None:
        """End after the next batch."""
        self._stopping = True

    def run(self) -> None:
        """Answer until stopped."""
        gauges = self._state.gauges
        try:
            while not self._stopping:
                began = time.monotonic()
                requests = self._requests.take(1, self._most, self._patience)
                gauges.rate("predictor_idle", time.monotonic() - began)
                gauges.mean("prediction_queue", len(requests) + len(self._requests))
                self._answer(requests)
        except ClosedError:
            pass
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._fail(error)

    def _answer(self, requests: Sequence[tuple[int, int]]) -> None:
        state = self._state
        rows = [state.slots.layout.row(number, lane) for number, lane in requests]
        version, memory = state.version, {name: x[rows] for name, x in state.memory.items()}
        actions, values, seen = self._decide(rows, memory)
        full = []
        for i, (row, (number, lane)) in enumerate(zip(rows, requests, strict=True)):
            writer = state.agents[number].writers[lane]
            slot = {name: array[row] for name, array in state.slots.arrays.items()}
            slot["action"][:] = actions[i]
            if slot["cut"].any():  # the outcome of the last action is unknown, so its steps are dropped
                state.gauges.count(episodes_cut=int(slot["cut"].sum()), steps_lost=writer.drop())
            own = {name: array[i] for name, array in seen.items()}
            before = {name: x[i] for name, x in memory.items()}
            trajectory = writer.add(slot, before, own, value=values[i], version=version)
            if trajectory is not None:
                full.append(trajectory)
        state.gauges.mean("prediction_batch", actions.size)
        state.gauges.rate("predictions_per_second", actions.size)
        began = time.monotonic()
        for trajectory in full:
            state.trajectories.put(trajectory)
        state.gauges.rate("predictor_blocked", time.monotonic() - began)
        for number, lane in requests:
            state.agents[number].answer(lane)

    @torch.no_grad()
    def _decide(
        self, rows: list[int], memory: State
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], dict[str, NDArray[Any]]]:
        """Actions for the environments, values, and observations with choices; each (N, R, ...)."""
        state, device = self._state, self._state.network.device
        shape = (len(rows), state.slots.layout.envs)

        def put(name: str) -> Tensor:
            array = state.slots.arrays[name][rows]  # a copy, as the slots are written to again
            return torch.from_numpy(array.reshape(-1, *array.shape[2:])).to(device)

        first, vary = put("first"), state.variation
        variations = vary.draw(state.variations[rows].flatten(0, 1), first, self._generator)
        state.variations[rows] = variations.view(*shape, -1)
        seen = vary.look({name: put(name) for name in state.slots.layout.observation}, variations)
        mask = vary.mask(put("mask"), variations)
        if state.dropout:
            seen["dropout"] = kept((len(first), state.network.memory.outputs), state.dropout, self._generator)
        before = {name: x.flatten(0, 1) for name, x in memory.items()}
        output = state.network({name: x[None] for name, x in seen.items()}, before, first[None])
        policy = state.network.distribution(output.logits[0], mask, state.epsilon)
        action = policy.sample(self._generator)
        for name, x in output.state.items():
            state.memory[name][rows] = x.view(*shape, *x.shape[1:])
        seen |= {"mask": mask, "action": action, "behaviour": policy.log_prob(action)}

        def take(tensor: Tensor) -> NDArray[Any]:
            array: NDArray[Any] = tensor.reshape(*shape, *tensor.shape[1:]).cpu().numpy()
            return array

        return (
            take(vary.actions(action, variations)),
            take(output.value[0]),
            {k: take(x) for k, x in seen.items()},
        )
