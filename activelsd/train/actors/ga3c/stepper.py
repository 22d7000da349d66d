"""Steppers: step an agent's environments, and write their observations where predictors read them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.base import Observation
from activelsd.errors import ConfigError
from activelsd.train.actors.ga3c.slots import Slots

Env = gymnasium.Env[Observation, np.int64]


class Stepper(Protocol):
    """Steps the environments of one agent, one lane at a time.

    The predictor that has written the actions calls `go`; the agent's thread calls everything else.
    """

    def begin(self) -> None:
        """Begin the first episodes."""

    def go(self, lane: int) -> None:
        """Start a step with the actions in a lane's slots; an episode that ends is followed by the next."""

    def wait(self) -> int:
        """Wait for the next lane whose step is done; may be called before or after `go`."""

    def close(self) -> None:
        """Close the environments."""


class LocalStepper:
    """Steps environments of this process, one after the other."""

    def __init__(self, make: Callable[[], Env], slots: Slots, agent: int, seed: int) -> None:
        """Make the environments of an agent.

        Raises:
            ConfigError: their observations or actions are not the network's.
        """
        layout = slots.layout
        rows = [layout.row(agent, lane) for lane in range(layout.lanes)]
        self._slots = [{name: array[row] for name, array in slots.arrays.items()} for row in rows]
        self._envs: list[list[Env]] = [[] for _ in rows]
        self._parts = tuple(layout.observation)
        self._seed, self._lanes = seed, SimpleQueue[int]()
        try:
            for envs in self._envs:
                for _ in range(layout.envs):
                    envs.append(make())
                    _check(envs[-1], slots)
        except BaseException:
            self.close()
            raise

    def begin(self) -> None:
        """Begin the first episodes; the environments of an agent have consecutive seeds."""
        seed = self._seed
        for slots, envs in zip(self._slots, self._envs, strict=True):
            for i, env in enumerate(envs):
                observation, info = env.reset(seed=seed)
                slots["reward"][i], slots["terminated"][i], slots["truncated"][i] = 0.0, False, False
                slots["cut"][i] = False
                self._show(slots, i, observation, info, first=True)
                seed += 1

    def go(self, lane: int) -> None:
        """Leave the step to `wait`: the calling thread has other requests to answer."""
        self._lanes.put(lane)

    def wait(self) -> int:
        """Take a step as soon as `go` was called."""
        lane = self._lanes.get()
        self.step(lane)
        return lane

    def step(self, lane: int) -> None:
        """Take an action in each environment of a lane."""
        slots = self._slots[lane]
        for i, env in enumerate(self._envs[lane]):
            observation, reward, terminated, truncated, info = env.step(slots["action"][i])
            slots["reward"][i], slots["terminated"][i], slots["truncated"][i] = reward, terminated, truncated
            slots["cut"][i] = "cut" in info
            if terminated or truncated:
                observation, info = env.reset()
            self._show(slots, i, observation, info, first=terminated or truncated)

    def _show(
        self,
        slots: dict[str, NDArray[Any]],
        i: int,
        observation: Observation,
        info: dict[str, Any],
        *,
        first: bool,
    ) -> None:
        for name in self._parts:
            slots[name][i] = observation[name]
        slots["mask"][i], slots["label"][i] = info["action_mask"], info["label"]
        slots["views"][i], slots["first"][i] = info["views"], first

    def close(self) -> None:
        """Close the environments."""
        for envs in self._envs:
            for env in envs:
                env.close()


def check_actions(env: Env, actions: dict[str, Sequence[str]]) -> None:
    """Raises ConfigError if an environment's actions are not the network's."""
    found = env.get_wrapper_attr("tree").to_dict()
    if found != actions:
        raise ConfigError(
            f"The environment's actions {found} are not the network's {actions}; train a network with them."
        )


def _check(env: Env, slots: Slots) -> None:
    layout, space = slots.layout, env.observation_space
    assert isinstance(space, gymnasium.spaces.Dict)
    wanted = {name: (tuple(shape), dtype) for name, (shape, dtype) in layout.observation.items()}
    found = {
        name: (box.shape or (), str(box.dtype))
        for name, box in space.items()
        if name in wanted or "features" not in wanted  # which take the place of pictures
    }
    if found != wanted:
        raise ConfigError(
            f"The environment's observations are {found}, and the network was built for {wanted}; change one."
        )
