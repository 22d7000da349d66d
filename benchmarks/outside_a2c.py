"""Stable-Baselines3's A2C in one of our worlds, as a contestant of the throughput benchmark.

It is set up like the trainer here: the same observations, number of environments, trunk size, one-layer
heads, rollout length, and one optimiser step per rollout. It has no memory over views, which is a cheap part.
The trunk is either the same function in plain PyTorch, in the layout of the frames, or this project's
optimised one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
import torch
from rates import Step
from stable_baselines3 import A2C
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import Tensor, nn

from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.policy.lsdnet import NetworkShape
from activelsd.policy.trunks import Compact
from activelsd.train.settings import TrainSettings


class Plain(BaseFeaturesExtractor):
    """The compact trunk in plain PyTorch; the trunk's first two layers are one convolution here."""

    def __init__(self, observation_space: gymnasium.spaces.Dict, shape: NetworkShape) -> None:
        super().__init__(observation_space, 256 + 5 * shape.frames)
        self.trunk = nn.Sequential(
            nn.Conv2d(shape.frames, 32, 12, 4, 4),
            nn.ReLU(),
            nn.Conv2d(32, 64, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(64, 64, 3, 2, 1),
            nn.ReLU(),
            nn.Flatten(),
            nn.LazyLinear(256),
            nn.ReLU(),
        )
        self.trunk(torch.zeros(1, shape.frames, shape.size, shape.size))

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """Features from frames float (N, K, S, S) in [0, 1] and boxes (N, K, 5)."""
        return torch.cat([self.trunk(observation["frames"]), observation["target"].flatten(1)], 1)


class Fast(BaseFeaturesExtractor):
    """Concatenates this project's trunk features and the target boxes."""

    def __init__(self, observation_space: gymnasium.spaces.Dict, shape: NetworkShape) -> None:
        trunk = Compact(shape.frames, shape.size)
        super().__init__(observation_space, trunk.features + 5 * shape.frames)
        self.trunk = trunk.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """Features from frames float (N, K, S, S) in [0, 1] and boxes (N, K, 5)."""
        frames = observation["frames"].contiguous(memory_format=torch.channels_last)
        return torch.cat([self.trunk(frames), observation["target"].flatten(1)], 1)


@contextmanager
def a2c(
    make: Callable[[], ViewGraphEnv],
    shape: NetworkShape,
    settings: TrainSettings,
    features: type[Plain] | type[Fast],
    device: str = "cpu",
) -> Iterator[Step]:
    """Gives a function that runs one A2C update, in a `DummyVecEnv` as its manual advises for fast ones."""
    policy: dict[str, Any] = {
        "features_extractor_class": features,
        "features_extractor_kwargs": {"shape": shape},
        "net_arch": [],
        "ortho_init": features is Plain,  # it does not support weights in channels-last layout
    }
    envs = DummyVecEnv([make] * settings.envs)
    steps = settings.envs * settings.length
    model = A2C(
        "MultiInputPolicy", envs, n_steps=settings.length, policy_kwargs=policy, device=device, seed=0
    )

    def step() -> int:
        model.learn(steps, reset_num_timesteps=False)
        return steps

    yield step
