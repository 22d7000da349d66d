"""Predictors answer the agents that wait, in one pass of the network for as many as there are."""

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
from activelsd.train.actors.ga3c.agent import Agent
from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.ga3c.slots import Slots
from activelsd.train.actors.gauges import Gauges
from activelsd.train.actors.trajectory import Trajectory
from activelsd.train.augment import Variation, kept


@dataclass(eq=False)
class PredictorState:
    """What predictors share.

    Attributes:
        network: answers; the learner changes its weights meanwhile.
        slots: what the agents show, and where answers go.
        agents: by number.
        memory: (rows, envs, width) what the network remembers of every episode, on its device.
        trajectories: the training queue.
        gauges: where batches, queues and waiting are measured.
        variation: how episodes differ from what environments show.
        ways: (rows, envs, VARIATION_SIZE) of every episode, on the network's device.
        dropout: share of the memory's features left out at every look.
        epsilon: exploration from now on.
        version: of the weights, in updates.
    """

    network: LSDNet
    slots: Slots
    agents: dict[int, Agent]
    memory: Tensor
    trajectories: BatchQueue[Trajectory]
    gauges: Gauges
    variation: Variation
    ways: Tensor
    dropout: float = 0.0
    epsilon: Epsilon = Epsilon()
    version: int = 0


class Predictor(threading.Thread):
    """A thread that answers."""

    def __init__(
        self,
        desk: PredictorState,
        asks: BatchQueue[tuple[int, int]],
        *,
        most: int,
        patience: float,
        seed: int,
        fail: Callable[[Exception], None],
    ) -> None:
        """Answer what waits in a queue.

        Args:
            desk: what it shares with others.
            asks: the prediction queue, of agents' numbers and lanes.
            most: lanes answered at once.
            patience: seconds that one may wait for others to be asked about too.
            seed: of the actions drawn.
            fail: called with what ends the training.
        """
        super().__init__(name="predictor", daemon=True)
        self._desk, self._asks, self._most, self._patience, self._fail = desk, asks, most, patience, fail
        self._generator = torch.Generator(desk.memory.device).manual_seed(seed)
        self._stopping = False

    def stop(self) -> None:
        """End after the next batch."""
        self._stopping = True

    def run(self) -> None:
        """Answer until stopped."""
        gauges = self._desk.gauges
        try:
            while not self._stopping:
                began = time.monotonic()
                asked = self._asks.take(1, self._most, self._patience)
                gauges.rate("predictor_idle", time.monotonic() - began)
                gauges.mean("prediction_queue", len(asked) + len(self._asks))
                self._answer(asked)
        except ClosedError:
            pass
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._fail(error)

    def _answer(self, asked: Sequence[tuple[int, int]]) -> None:
        desk = self._desk
        rows = [desk.slots.layout.row(number, lane) for number, lane in asked]
        version, states = desk.version, desk.memory[rows]
        actions, values, seen = self._decide(rows, states)
        full = []
        for i, (row, (number, lane)) in enumerate(zip(rows, asked, strict=True)):
            recorder = desk.agents[number].recorders[lane]
            slot = {name: array[row] for name, array in desk.slots.arrays.items()}
            slot["action"][:] = actions[i]
            if slot["cut"].any():  # what came of the last action nobody knows, so nothing is learned of it
                desk.gauges.count(episodes_cut=int(slot["cut"].sum()), steps_lost=recorder.drop())
            own = {name: array[i] for name, array in seen.items()}
            trajectory = recorder.add(slot, states[i], own, value=values[i], version=version)
            if trajectory is not None:
                full.append(trajectory)
        desk.gauges.mean("prediction_batch", actions.size)
        desk.gauges.rate("predictions_per_second", actions.size)
        began = time.monotonic()
        for trajectory in full:
            desk.trajectories.put(trajectory)
        desk.gauges.rate("predictor_blocked", time.monotonic() - began)
        for number, lane in asked:
            desk.agents[number].answer(lane)

    @torch.no_grad()
    def _decide(
        self, rows: list[int], states: Tensor
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], dict[str, NDArray[Any]]]:
        """Actions to take, values of what is seen, and what was seen and chosen; each (N, R, ...)."""
        desk, device = self._desk, self._desk.memory.device
        shape = states.shape[:2]

        def put(name: str) -> Tensor:
            array = desk.slots.arrays[name][rows]  # a copy: the slots are written to again
            return torch.from_numpy(array.reshape(-1, *array.shape[2:])).to(device)

        first, vary = put("first"), desk.variation
        ways = vary.ways(desk.ways[rows].flatten(0, 1), first, self._generator)
        desk.ways[rows] = ways.view(*shape, -1)
        seen = vary.look({name: put(name) for name in desk.slots.layout.observation}, ways)
        mask = vary.mask(put("mask"), ways)
        if desk.dropout:
            seen["dropout"] = kept((len(first), desk.network.memory.outputs), desk.dropout, self._generator)
        output = desk.network({name: x[None] for name, x in seen.items()}, states.flatten(0, 1), first[None])
        policy = desk.network.distribution(output.logits[0], mask, desk.epsilon)
        action = policy.sample(self._generator)
        desk.memory[rows] = output.state.view(*shape, -1)
        seen |= {"mask": mask, "action": action, "behaviour": policy.log_prob(action)}

        def take(tensor: Tensor) -> NDArray[Any]:
            array: NDArray[Any] = tensor.reshape(*shape, *tensor.shape[1:]).cpu().numpy()
            return array

        return take(vary.actions(action, ways)), take(output.value[0]), {k: take(x) for k, x in seen.items()}
