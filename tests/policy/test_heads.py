"""Distributions over action trees against their definition, written out action by action."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from activelsd.envs.actions import ActionTree
from activelsd.policy.heads import ActionDistribution, Epsilon, FlatCategorical, TreeCategorical

TREES = (
    ActionTree.answer_or_move(["a", "b", "c"], ["left", "right"]),
    ActionTree.answer_or_move(["a"], ["on"]),
    ActionTree({"classify": ["a", "b"], "walk": ["on", "back", "aside"], "touch": ["push"]}),
)


def case(tree: ActionTree, seed: int) -> tuple[list[float], list[float], list[bool]]:
    """Logits of branches and leaves, and a mask with something legal in it."""
    generator = torch.Generator().manual_seed(seed)
    branch = (2 * torch.randn(len(tree.branches), generator=generator)).tolist()
    leaf = (2 * torch.randn(tree.n, generator=generator)).tolist()
    mask = torch.rand(tree.n, generator=generator) < 0.6
    mask[int(torch.randint(tree.n, (1,), generator=generator))] = True
    return branch, leaf, mask.tolist()


def softmax(logits: list[float], legal: list[bool]) -> list[float]:
    weights = [math.exp(x) if ok else 0.0 for x, ok in zip(logits, legal, strict=True)]
    return [w / sum(weights) for w in weights] if any(legal) else [0.0] * len(legal)


def mixed(p: list[float], legal: list[bool], epsilon: float) -> list[float]:
    count = max(sum(legal), 1)
    return [(1 - epsilon) * x + epsilon * ok / count for x, ok in zip(p, legal, strict=True)]


def entropy(p: list[float]) -> float:
    return -sum(x * math.log(x) for x in p if x > 0)


def spans(tree: ActionTree) -> list[slice]:
    return [tree.span(branch) for branch in tree.branches]


def make_tree(
    tree: ActionTree, branch: list[float], leaf: list[float], mask: list[bool], epsilon: Epsilon = Epsilon()
) -> TreeCategorical:
    return TreeCategorical(tree, torch.tensor(branch), torch.tensor(leaf), torch.tensor(mask), epsilon)


@given(
    which=st.integers(0, len(TREES) - 1),
    seed=st.integers(0, 10**6),
    epsilon=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_a_tree_is_what_enumerating_it_says(which: int, seed: int, epsilon: tuple[float, float]) -> None:
    tree = TREES[which]
    branch, leaf, mask = case(tree, seed)
    policy = make_tree(tree, branch, leaf, mask, Epsilon(*epsilon))

    opened = [any(mask[s]) for s in spans(tree)]
    pi_branch = softmax(branch, opened)
    pi_leaf = [softmax(leaf[s], mask[s]) for s in spans(tree)]
    acting_branch = mixed(pi_branch, opened, epsilon[0])
    acting = [
        b * x
        for b, p, s in zip(acting_branch, pi_leaf, spans(tree), strict=True)
        for x in mixed(p, mask[s], epsilon[1])
    ]
    assert policy.probs.tolist() == pytest.approx(acting, abs=1e-6)
    assert policy.probs.sum().item() == pytest.approx(1.0, abs=1e-5)
    assert [p == 0 for p in policy.probs.tolist()] == [not ok for ok in mask]
    assert policy.branch_probs().tolist() == pytest.approx(pi_branch, abs=1e-6)
    assert policy.entropy().branch.item() == pytest.approx(entropy(pi_branch), abs=1e-5)
    per_branch = sum(b * entropy(p) for b, p in zip(pi_branch, pi_leaf, strict=True))
    assert policy.entropy().leaf.item() == pytest.approx(per_branch, abs=1e-5)
    # The chain rule: both levels together are the entropy of the whole.
    whole = entropy([b * x for b, p in zip(pi_branch, pi_leaf, strict=True) for x in p])
    assert sum(float(level) for level in policy.entropy()) == pytest.approx(whole, abs=1e-5)
    if opened[0]:
        assert policy.class_log_probs().exp().tolist() == pytest.approx(pi_leaf[0], abs=1e-6)
    if any(opened[1:]):
        moving = [b * x for b, p in zip(pi_branch[1:], pi_leaf[1:], strict=True) for x in p]
        expected = [x / sum(moving) for x in moving]
        assert policy.move_log_probs().exp().tolist() == pytest.approx(expected, abs=1e-6)
    else:
        assert policy.move_log_probs().isneginf().all()
    if len(opened) == 2 and opened[1]:  # the paper's tree: the moves are one branch, and nothing is added
        assert torch.equal(policy.move_log_probs(), policy._leaves[1])


@given(which=st.integers(0, len(TREES) - 1), seed=st.integers(0, 10**6), epsilon=st.floats(0, 1))
def test_a_flat_head_is_one_softmax(which: int, seed: int, epsilon: float) -> None:
    tree = TREES[which]
    _, leaf, mask = case(tree, seed)
    policy = FlatCategorical(tree, torch.tensor(leaf), torch.tensor(mask), Epsilon(0.9, epsilon))
    p = softmax(leaf, mask)
    assert policy.probs.tolist() == pytest.approx(mixed(p, mask, epsilon), abs=1e-6)
    assert policy.entropy().branch.item() == 0.0
    assert policy.entropy().leaf.item() == pytest.approx(entropy(p), abs=1e-5)
    assert policy.branch_probs().tolist() == pytest.approx([sum(p[s]) for s in spans(tree)], abs=1e-6)
    for span, given_branch in (
        (tree.span("classify"), policy.class_log_probs),
        (tree.moves, policy.move_log_probs),
    ):
        if any(mask[span]):
            expected = softmax(leaf[span], mask[span])
            assert given_branch().exp().tolist() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("head", ["tree", "flat"])
def test_gradients_are_finite_though_a_branch_is_closed(head: str) -> None:
    tree = TREES[0]
    mask = torch.tensor([True, True, True, False, False])
    branch, leaf = torch.zeros(2, requires_grad=True), torch.zeros(5, requires_grad=True)
    policy: ActionDistribution
    if head == "tree":
        policy = TreeCategorical(tree, branch, leaf, mask, Epsilon(0.3, 0.2))
    else:
        policy = FlatCategorical(tree, leaf, mask, Epsilon(0.3, 0.2))
    loss = policy.log_prob(torch.tensor(1)) + sum(policy.entropy()) + policy.class_log_probs()[0]
    loss = loss + policy.move_log_probs().masked_fill(~mask[3:], 0.0).sum()
    loss.backward()
    assert leaf.grad is not None
    assert leaf.grad.isfinite().all()
    assert not leaf.grad[3:].any()
    if head == "tree":
        assert branch.grad is not None
        assert branch.grad.isfinite().all()


def test_gradients_through_epsilon_are_those_of_finite_differences() -> None:
    tree = TREES[2]
    mask = torch.tensor([True, True, True, False, True, True])

    def log_prob(branch: Tensor, leaf: Tensor) -> Tensor:
        policy = TreeCategorical(tree, branch, leaf, mask, Epsilon(0.3, 0.1))
        return policy.log_prob(torch.tensor([4, 0]).expand(2)) + policy.entropy().leaf

    generator = torch.Generator().manual_seed(0)
    branch = torch.randn(2, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    leaf = torch.randn(2, 6, generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(log_prob, (branch, leaf))


def test_what_is_out_of_reach_is_finite_and_teaches_nothing() -> None:
    tree = TREES[0]
    leaf = torch.tensor([0.0, 200.0, 0.0, 0.0, 0.0], requires_grad=True)
    policy = TreeCategorical(tree, torch.zeros(2), leaf, torch.ones(5, dtype=torch.bool))
    drawn = policy.log_prob(torch.tensor(0))
    drawn.backward()
    assert drawn.isfinite()
    assert leaf.grad is not None
    assert not leaf.grad.any()


@pytest.mark.parametrize("epsilon", [0.0, 0.25, 1.0])
@pytest.mark.parametrize("head", ["tree", "flat"])
def test_epsilon_may_be_a_tensor(head: str, epsilon: float) -> None:
    """As in a CUDA graph, which is written once for all that epsilon will be."""
    tree = TREES[0]
    branch, leaf, mask = case(tree, 3)

    def policy(given: Epsilon) -> ActionDistribution:
        if head == "tree":
            return make_tree(tree, branch, leaf, mask, given)
        return FlatCategorical(tree, torch.tensor(leaf), torch.tensor(mask), given)

    number = policy(Epsilon(epsilon, epsilon))
    tensor = policy(Epsilon(torch.tensor(epsilon), torch.tensor(epsilon)))
    torch.testing.assert_close(tensor.probs, number.probs)
    actions = torch.arange(tree.n)[torch.tensor(mask)]
    found = torch.stack([tensor.log_prob(action) for action in actions])
    torch.testing.assert_close(found, number.probs[actions].log())


def test_sampling_follows_the_probabilities_and_the_generator() -> None:
    tree = TREES[0]
    branch, leaf, mask = case(tree, 3)
    policy = make_tree(tree, branch, leaf, mask, Epsilon(0.2, 0.2))
    many = make_tree(tree, branch, leaf, mask, Epsilon(0.2, 0.2))
    many.probs = policy.probs.expand(40_000, -1)
    drawn = many.sample(torch.Generator().manual_seed(0))
    shares = torch.bincount(drawn, minlength=tree.n) / len(drawn)
    assert shares.tolist() == pytest.approx(policy.probs.tolist(), abs=0.015)
    assert torch.equal(drawn, many.sample(torch.Generator().manual_seed(0)))
    assert not torch.equal(drawn, many.sample(torch.Generator().manual_seed(1)))
