"""V-trace against its definition written out, and against n-step returns where nothing is to be corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from activelsd.train.learner import Learner
from activelsd.train.losses import n_step_returns
from activelsd.train.settings import TrainSettings
from activelsd.train.vtrace import vtrace
from tests.train.test_learner import rollout_of

NOW = TrainSettings().at(0.0)


def by_definition(
    ratios: NDArray[np.float64],
    rewards: NDArray[np.float64],
    ended: NDArray[np.bool_],
    values: NDArray[np.float64],
    bootstrap: float,
    gamma: float,
    rho_bar: float,
    c_bar: float,
) -> tuple[list[float], list[float]]:
    """IMPALA's equation 1, a sum of products for each step of one episode's column."""
    n = len(rewards)
    following = [*values[1:], bootstrap]
    discount = [0.0 if e else gamma for e in ended]
    vs = []
    for s in range(n):
        total = values[s]
        for t in range(s, n):
            weight = 1.0
            for i in range(s, t):
                weight *= discount[i] * min(c_bar, ratios[i])
            delta = rewards[t] + discount[t] * following[t] - values[t]
            total += weight * min(rho_bar, ratios[t]) * delta
        vs.append(float(total))
    after = [*vs[1:], bootstrap]
    advantages = [
        float(min(rho_bar, ratios[s]) * (rewards[s] + discount[s] * after[s] - values[s])) for s in range(n)
    ]
    return vs, advantages


@given(
    seed=st.integers(0, 10_000),
    length=st.integers(1, 7),
    gamma=st.floats(0, 1),
    rho_bar=st.sampled_from([0.5, 1.0, 2.0]),
    c_bar=st.sampled_from([0.5, 1.0]),
)
def test_equals_its_definition_on_both_sides_of_the_clips(
    seed: int, length: int, gamma: float, rho_bar: float, c_bar: float
) -> None:
    rng = np.random.default_rng(seed)
    log_ratios = rng.normal(0, 1.5, (length, 3))  # ratios from about 0.05 to 20
    rewards, values, bootstrap = (
        rng.normal(size=(length, 3)),
        rng.normal(size=(length, 3)),
        rng.normal(size=3),
    )
    ended = rng.random((length, 3)) < 0.3
    found = vtrace(
        *(torch.from_numpy(x) for x in (log_ratios, rewards, ended, values, bootstrap)),
        gamma,
        rho_clip=rho_bar,
        c_clip=c_bar,
    )
    for b in range(3):
        vs, advantages = by_definition(
            np.exp(log_ratios[:, b]),
            rewards[:, b],
            ended[:, b],
            values[:, b],
            bootstrap[b],
            gamma,
            rho_bar,
            c_bar,
        )
        np.testing.assert_allclose(found.vs[:, b], vs, atol=1e-9)
        np.testing.assert_allclose(found.advantages[:, b], advantages, atol=1e-9)


@given(seed=st.integers(0, 10_000), gamma=st.floats(0, 1))
def test_nothing_to_correct_leaves_n_step_returns(seed: int, gamma: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    rewards, values = torch.randn(2, 6, 4, generator=generator, dtype=torch.float64)
    ended = torch.rand(6, 4, generator=generator) < 0.3
    bootstrap = torch.randn(4, generator=generator, dtype=torch.float64)
    found = vtrace(torch.zeros_like(values), rewards, ended, values, bootstrap, gamma)
    returns = n_step_returns(rewards, ended, bootstrap, gamma)
    torch.testing.assert_close(found.vs, returns)
    torch.testing.assert_close(found.advantages, returns - values)


@pytest.mark.parametrize("lag", [0.0, 1.0])
def test_learner_corrects_what_an_older_policy_drew_and_nothing_else(lag: float) -> None:
    network, rollout = rollout_of()
    output = rollout.output
    assert output is not None
    now = network.distribution(output.logits, rollout.mask, rollout.epsilon).log_prob(rollout.actions)
    given_behaviour = replace(rollout, behaviour=now.detach() + lag)
    plain = Learner(network, TrainSettings()).losses(given_behaviour, NOW)
    corrected = Learner(network, TrainSettings(vtrace=True)).losses(given_behaviour, NOW)
    same = abs(plain["total"].item() - corrected["total"].item()) < 1e-5
    assert same == (lag == 0.0)
    on_policy = Learner(network, TrainSettings(vtrace=True)).losses(rollout, NOW)
    assert on_policy["total"].item() == pytest.approx(plain["total"].item())
