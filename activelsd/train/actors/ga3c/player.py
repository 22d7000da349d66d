"""An agent's hands: the environments it steps, and what they show written where predictors read it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np

from activelsd.envs.base import Observation
from activelsd.errors import ConfigError
from activelsd.train.actors.ga3c.slots import Slots

Env = gymnasium.Env[Observation, np.int64]


class Player(Protocol):
    """Steps the environments of one agent.

    `go` is called by whoever has written the actions, everything else by the agent's thread.
    """

    def begin(self) -> None:
        """Begin the first episodes."""

    def go(self) -> None:
        """Have the actions that stand in the slots taken; an episode that ends is followed by the next."""

    def wait(self) -> None:
        """Return when that is done, called before it or after."""

    def close(self) -> None:
        """Let go of the environments."""


class EnvPlayer:
    """Plays environments of this process, one after the other."""

    def __init__(self, make: Callable[[], Env], slots: Slots, agent: int, seed: int) -> None:
        """Make the environments of an agent.

        Raises:
            ConfigError: they do not show or do what the network was built for.
        """
        self._envs: list[Env] = []
        self._slots = {name: array[agent] for name, array in slots.arrays.items()}
        self._parts = tuple(slots.layout.observation)
        self._seed, self._told = seed, threading.Semaphore(0)
        try:
            for _ in range(slots.layout.envs):
                self._envs.append(make())
                _check(self._envs[-1], slots)
        except BaseException:
            self.close()
            raise

    def begin(self) -> None:
        """Begin the first episodes; the seeds of an agent's environments follow one another."""
        slots = self._slots
        for i, env in enumerate(self._envs):
            observation, info = env.reset(seed=self._seed + i)
            slots["reward"][i], slots["terminated"][i], slots["truncated"][i] = 0.0, False, False
            slots["cut"][i] = False
            self._show(i, observation, info, first=True)

    def go(self) -> None:
        """Let `wait` take the step: this thread has others to answer."""
        self._told.release()

    def wait(self) -> None:
        """Take the step when told to."""
        self._told.acquire()
        self.step()

    def step(self) -> None:
        """Take an action in each environment."""
        slots = self._slots
        for i, env in enumerate(self._envs):
            observation, reward, terminated, truncated, info = env.step(slots["action"][i])
            slots["reward"][i], slots["terminated"][i], slots["truncated"][i] = reward, terminated, truncated
            slots["cut"][i] = "cut" in info
            if terminated or truncated:
                observation, info = env.reset()
            self._show(i, observation, info, first=terminated or truncated)

    def _show(self, i: int, observation: Observation, info: dict[str, Any], *, first: bool) -> None:
        slots = self._slots
        for name in self._parts:
            slots[name][i] = observation[name]
        slots["mask"][i], slots["label"][i] = info["action_mask"], info["label"]
        slots["views"][i], slots["first"][i] = info["views"], first

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            env.close()


def check_actions(env: Env, actions: dict[str, Sequence[str]]) -> None:
    """Refuse an environment whose tree is not the network's. Raises ConfigError."""
    found = env.get_wrapper_attr("tree").to_dict()
    if found != actions:
        raise ConfigError(
            f"The environment's actions {found} are not the network's {actions}; train a network for them."
        )


def _check(env: Env, slots: Slots) -> None:
    layout, space = slots.layout, env.observation_space
    assert isinstance(space, gymnasium.spaces.Dict)
    found = {name: (box.shape or (), str(box.dtype)) for name, box in space.items()}
    wanted = {name: (tuple(shape), dtype) for name, (shape, dtype) in layout.observation.items()}
    if found != wanted:
        raise ConfigError(
            f"The environment shows {found}, but the network was built for {wanted}; make both alike."
        )
