"""Stable-Baselines3's A2C on a world of ours, as a step to be measured.

It gets what the trainer here has: the same observations from as many environments, a trunk of the same size
and heads of one layer, rollouts as long, an optimiser step per rollout. It lacks a memory over views, a cheap
part. The trunk is either the same function as a user would write it, in the layout that frames come in, or
the one here with all that makes it fast.
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
from activelsd.policy.trunks import make_trunk
from activelsd.train.settings import TrainSettings


class Plain(BaseFeaturesExtractor):
    """The compact trunk's function, weight for weight: its first two layers are one convolution on pixels."""

    def __init__(self, observation_space: gymnasium.spaces.Dict, shape: NetworkShape) -> None:
        super().__init__(observation_space, shape.features + 5 * shape.frames)
        self.trunk = nn.Sequential(
            nn.Conv2d(shape.frames, 32, 12, 4, 4),
            nn.ReLU(),
            nn.Conv2d(32, 64, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(64, 64, 3, 2, 1),
            nn.ReLU(),
            nn.Flatten(),
            nn.LazyLinear(shape.features),
            nn.ReLU(),
        )
        self.trunk(torch.zeros(1, shape.frames, shape.size, shape.size))

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """From frames float (N, K, S, S) in [0, 1] and boxes (N, K, 5)."""
        return torch.cat([self.trunk(observation["frames"]), observation["target"].flatten(1)], 1)


class Fast(BaseFeaturesExtractor):
    """The trunk's features of the frames, and the target's boxes beside them."""

    def __init__(self, observation_space: gymnasium.spaces.Dict, shape: NetworkShape) -> None:
        trunk = make_trunk(shape.trunk, shape.frames, shape.size, shape.features)
        super().__init__(observation_space, trunk.features + 5 * shape.frames)
        self.trunk = trunk.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """From frames float (N, K, S, S) in [0, 1] and boxes (N, K, 5)."""
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
    """An update of A2C; environments stand in a `DummyVecEnv`, as its manual advises for light ones."""
    policy: dict[str, Any] = {
        "features_extractor_class": features,
        "features_extractor_kwargs": {"shape": shape},
        "net_arch": [],
        "ortho_init": features is Plain,  # it cannot fill weights that are laid out channels last
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
