"""Stable-Baselines3's A2C on a world of ours, as a step to be measured.

It gets what the trainer here has: the same observations from as many environments, the same trunk and heads
of one layer, rollouts as long, an optimiser step per rollout. It lacks a memory over views, a cheap part.
"""

from __future__ import annotations

from collections.abc import Callable

import gymnasium
import torch
from rates import Step
from stable_baselines3 import A2C
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import Tensor

from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.policy.lsdnet import NetworkShape
from activelsd.policy.trunk import make_trunk
from activelsd.train.settings import TrainSettings


class Features(BaseFeaturesExtractor):
    """The trunk's features of the frames, and the target's boxes beside them."""

    def __init__(self, observation_space: gymnasium.spaces.Dict, shape: NetworkShape) -> None:
        trunk = make_trunk(shape.trunk, shape.frames, shape.size, shape.features)
        super().__init__(observation_space, trunk.features + 5 * shape.frames)
        self.trunk = trunk.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """From frames float (N, K, S, S) in [0, 1] and boxes (N, K, 5)."""
        frames = observation["frames"].contiguous(memory_format=torch.channels_last)
        return torch.cat([self.trunk(frames), observation["target"].flatten(1)], 1)


def a2c(make: Callable[[], ViewGraphEnv], shape: NetworkShape, settings: TrainSettings) -> Step:
    """An update of A2C; environments stand in a `DummyVecEnv`, as its manual advises for light ones."""
    policy = {
        "features_extractor_class": Features,
        "features_extractor_kwargs": {"shape": shape},
        "net_arch": [],
        "ortho_init": False,  # it cannot fill weights that are laid out channels last
    }
    envs = DummyVecEnv([make] * settings.envs)
    steps = settings.envs * settings.length
    model = A2C("MultiInputPolicy", envs, n_steps=settings.length, policy_kwargs=policy, device="cpu", seed=0)

    def step() -> int:
        model.learn(steps, reset_num_timesteps=False)
        return steps

    return step
