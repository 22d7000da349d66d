"""Predictors answer the agents that wait, in one pass of the network for as many as there are."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.actors.ga3c.agent import Agent
from activelsd.train.actors.ga3c.gauges import Gauges
from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.ga3c.slots import Slots
from activelsd.train.actors.ga3c.trajectory import Trajectory


@dataclass(eq=False)
class Desk:
    """What predictors share.

    Attributes:
        network: answers; the learner changes its weights meanwhile.
        slots: what the agents show, and where answers go.
        agents: by number.
        memory: (agents, envs, width) what the network remembers of every episode, on its device.
        trajectories: the training queue.
        gauges: where batches, queues and waiting are measured.
        epsilon: exploration from now on.
        version: of the weights, in updates.
    """

    network: LSDNet
    slots: Slots
    agents: dict[int, Agent]
    memory: Tensor
    trajectories: BatchQueue[Trajectory]
    gauges: Gauges
    epsilon: Epsilon = Epsilon()
    version: int = 0


class Predictor(threading.Thread):
    """A thread that answers."""

    def __init__(
        self,
        desk: Desk,
        asks: BatchQueue[int],
        *,
        most: int,
        patience: float,
        seed: int,
        fail: Callable[[Exception], None],
    ) -> None:
        """Answer what waits in a queue.

        Args:
            desk: what it shares with others.
            asks: the prediction queue, of agents' numbers.
            most: agents answered at once.
            patience: seconds that an agent may wait for others to ask too.
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
                numbers = self._asks.take(1, self._most, self._patience)
                gauges.rate("predictor_idle", time.monotonic() - began)
                gauges.mean("prediction_queue", len(numbers) + len(self._asks))
                self._answer(numbers)
        except ClosedError:
            pass
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._fail(error)

    def _answer(self, numbers: Sequence[int]) -> None:
        desk, agents = self._desk, [self._desk.agents[number] for number in numbers]
        version, states = desk.version, desk.memory[list(numbers)]
        actions, behaviour, values = self._decide(numbers, states)
        full = []
        for i, agent in enumerate(agents):
            slot = {name: array[agent.number] for name, array in desk.slots.arrays.items()}
            slot["action"][:] = actions[i]
            if slot["cut"].any():  # what came of the last action nobody knows, so nothing is learned of it
                desk.gauges.count(episodes_cut=int(slot["cut"].sum()), steps_lost=agent.recorder.drop())
            trajectory = agent.recorder.add(
                slot, states[i], behaviour=behaviour[i], value=values[i], version=version
            )
            if trajectory is not None:
                full.append(trajectory)
        desk.gauges.mean("prediction_batch", actions.size)
        desk.gauges.rate("predictions_per_second", actions.size)
        began = time.monotonic()
        for trajectory in full:
            desk.trajectories.put(trajectory)
        desk.gauges.rate("predictor_blocked", time.monotonic() - began)
        for agent in agents:
            agent.answer()

    @torch.no_grad()
    def _decide(self, numbers: Sequence[int], states: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Actions, their log-probabilities and the values of what is seen, each (N, R)."""
        desk, device, index = self._desk, self._desk.memory.device, np.asarray(numbers)
        rows = states.shape[:2]

        def put(name: str) -> Tensor:
            array = desk.slots.arrays[name][index]  # a copy: the slots are written to again
            return torch.from_numpy(array.reshape(-1, *array.shape[2:])).to(device)

        observation = {name: put(name)[None] for name in desk.slots.layout.observation}
        output = desk.network(observation, states.flatten(0, 1), put("first")[None])
        policy = desk.network.distribution(output.logits[0], put("mask"), desk.epsilon)
        action = policy.sample(self._generator)
        desk.memory[list(numbers)] = output.state.unflatten(0, rows)
        answers = (action, policy.log_prob(action), output.value[0])
        actions, behaviour, values = (x.unflatten(0, rows).cpu().numpy() for x in answers)
        return actions, behaviour, values
