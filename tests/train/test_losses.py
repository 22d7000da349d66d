"""The loss against numbers worked out by hand, and returns against the sum they stand for."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.envs.actions import ActionTree
from activelsd.policy.heads import TreeCategorical
from activelsd.train.losses import Weights, a3c_losses, n_step_returns


@settings(derandomize=True, deadline=None, max_examples=50)
@given(seed=st.integers(0, 10_000), length=st.integers(1, 7), gamma=st.floats(0, 1))
def test_returns_are_discounted_sums_up_to_the_end_of_the_episode(
    seed: int, length: int, gamma: float
) -> None:
    generator = torch.Generator().manual_seed(seed)
    rewards = torch.randn(length, 3, generator=generator)
    ended = torch.rand(length, 3, generator=generator) < 0.3
    bootstrap = torch.randn(3, generator=generator)
    returns = n_step_returns(rewards, ended, bootstrap, gamma)
    for b in range(3):
        for t in range(length):
            expected, weight = 0.0, 1.0
            for k in range(t, length):
                expected += weight * float(rewards[k, b])
                weight *= gamma
                if ended[k, b]:
                    break
            else:
                expected += weight * float(bootstrap[b])
            assert float(returns[t, b]) == pytest.approx(expected, abs=1e-5)


def test_loss_of_one_step_worked_out_by_hand() -> None:
    """Two classes, two moves; branch odds 3:1, class odds 4:1, even moves; class 0 is named, rightly."""
    tree = ActionTree.answer_or_move(["a", "b"], ["left", "right"])
    branch = torch.tensor([[[math.log(3.0), 0.0]]], requires_grad=True)
    leaf = torch.tensor([[[math.log(4.0), 0.0, 0.0, 0.0]]], requires_grad=True)
    value = torch.tensor([[0.25]], requires_grad=True)
    distribution = TreeCategorical(tree, branch, leaf, torch.ones(1, 1, 4, dtype=torch.bool))
    weights = Weights(value=0.5, entropy_branch=0.1, entropy_leaf=0.01)
    zero = torch.zeros(1, 1, dtype=torch.int64)
    losses = a3c_losses(distribution, value, zero, torch.ones(1, 1), weights)

    policy = -(math.log(3 / 4) + math.log(4 / 5)) * (1.0 - 0.25)
    h_branch = -(3 / 4) * math.log(3 / 4) - (1 / 4) * math.log(1 / 4)
    h_leaf = (3 / 4) * (-(4 / 5) * math.log(4 / 5) - (1 / 5) * math.log(1 / 5)) + (1 / 4) * math.log(2)
    assert losses.policy.item() == pytest.approx(policy)
    assert losses.value.item() == pytest.approx(0.5 * 0.75**2)
    assert losses.entropy_branch.item() == pytest.approx(h_branch)
    assert losses.entropy_leaf.item() == pytest.approx(h_leaf)
    total = policy + 0.5 * 0.5 * 0.75**2 - 0.1 * h_branch - 0.01 * h_leaf
    assert losses.total.item() == pytest.approx(total)

    losses.total.backward()  # type: ignore[no-untyped-call]
    assert value.grad is not None
    # d/dV of weight * (R - V)^2 / 2; the policy's (R - V) is held fixed.
    assert value.grad.item() == pytest.approx(-0.5 * 0.75)


def test_a_better_outcome_than_valued_makes_the_action_likelier() -> None:
    tree = ActionTree.answer_or_move(["a", "b"], ["left", "right"])
    for advantage in (1.0, -1.0):
        leaf = torch.zeros(1, 1, 4, requires_grad=True)
        branch = torch.zeros(1, 1, 2, requires_grad=True)
        distribution = TreeCategorical(tree, branch, leaf, torch.ones(1, 1, 4, dtype=torch.bool))
        action = torch.full((1, 1), 2)
        losses = a3c_losses(
            distribution,
            torch.zeros(1, 1),
            action,
            torch.full((1, 1), advantage),
            Weights(0.0, 0.0, 0.0),
        )
        losses.total.backward()  # type: ignore[no-untyped-call]
        assert branch.grad is not None
        assert leaf.grad is not None
        assert -branch.grad[0, 0, 1] * advantage > 0
        assert -leaf.grad[0, 0, 2] * advantage > 0
