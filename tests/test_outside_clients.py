"""The registered worlds are plain Gymnasium: what others wrote trains on them unchanged."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import activelsd.envs  # noqa: F401  registers the worlds

stable_baselines3 = pytest.importorskip("stable_baselines3")

WORLD = {
    "classes": ["cup", "vase"],
    "train_per_class": 3,
    "test_per_class": 1,
    "size": 36,
    "navigate": ["orbit_cw", "orbit_ccw"],
}


@pytest.mark.parametrize("algorithm", ["A2C", "PPO"])
def test_stable_baselines3_trains_on_a_registered_world(algorithm: str) -> None:
    env = gymnasium.make("activelsd/ModelNet-v0", rules="V0", **WORLD)
    model = getattr(stable_baselines3, algorithm)("MultiInputPolicy", env, n_steps=64, seed=0, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(64)
    assert model.num_timesteps >= 64
    changed = [(a != b).any().item() for a, b in zip(before, model.policy.parameters(), strict=True)]
    assert all(changed)
    # Its policy plays an episode to the end.
    observation, _ = env.reset(seed=1)
    for _ in range(12):
        action, _ = model.predict(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        assert np.isfinite(reward)
        if terminated or truncated:
            break
    assert terminated or truncated
    assert info["views"] <= 12
