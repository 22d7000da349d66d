"""Loss terms: those of this package by hand, and what the learner does with terms of others."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from activelsd import registry
from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError, RunError, TrainingError
from activelsd.policy.checkpoint import load_network
from activelsd.policy.heads import FlatCategorical, TreeCategorical
from activelsd.policy.lsdnet import LSDNet, Output
from activelsd.registry import BrokenPartError, UnknownPartError
from activelsd.train.learner import Learner
from activelsd.train.parallel import Group
from activelsd.train.rollout import Rollout
from activelsd.train.settings import TrainSettings
from activelsd.train.terms import Guided, Smoothing, Supervised, Term, needs_nearer
from tests.train.test_learner import NOW, rollout_of
from tests.train.test_trainer import assert_same, new_run, trainer


class Reward(Term):
    """Predicts rewards from the trunk's features, with weights and a count of its own; keeps the network."""

    def __init__(self, network: LSDNet) -> None:
        super().__init__(network)
        self.network, self.out = network, nn.Linear(network.trunk.features, 1)
        self.register_buffer("calls", torch.zeros(()))

    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        self.calls += 1
        return (self.out(output.features).squeeze(-1) - rollout.rewards).square().mean()


class Shapeless(Term):
    """Forgets to take the mean."""

    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        return output.value


class Infinite(Term):
    """Divides by zero from the third update on."""

    def __init__(self, network: LSDNet) -> None:
        super().__init__(network)
        self.calls = 0

    def forward(self, rollout: Rollout, output: Output) -> Tensor:
        self.calls += 1
        return output.value.mean() / (0.0 if self.calls > 2 else 1.0)


@pytest.fixture(autouse=True)
def _another_package(monkeypatch: pytest.MonkeyPatch) -> None:
    brought = {"reward": Reward, "shapeless": Shapeless, "infinite": Infinite}
    monkeypatch.setattr(registry.terms, "_added", brought)


def evaluated(term: type[Term], distribution: Any, tree: ActionTree, **rollout: Any) -> Tensor:
    """A term of a policy, on a rollout of which there is only what it needs."""
    output = SimpleNamespace(policy=distribution, value=torch.zeros(1))
    loss: Tensor = term(SimpleNamespace(tree=tree))(SimpleNamespace(**rollout), output)  # type: ignore[arg-type]
    return loss


def test_smoothing_beside_supervised_is_pytorchs_label_smoothing() -> None:
    tree = ActionTree.answer_or_move(["a", "b", "c"], ["left"])
    logits, labels = torch.randn(4, 2, 6), torch.tensor([[0, 1], [2, 0], [1, 1], [2, 2]])
    legal = torch.ones(4, 2, 4, dtype=torch.bool)
    distribution = TreeCategorical(tree, logits[..., :2], logits[..., 2:], legal)
    plain = evaluated(Supervised, distribution, tree, labels=labels)
    smooth = evaluated(Smoothing, distribution, tree, labels=labels)
    expected = nn.functional.cross_entropy(
        logits[..., 2:5].flatten(0, 1), labels.flatten(), label_smoothing=0.1 / 1.1
    )
    torch.testing.assert_close(plain + 0.1 * smooth, 1.1 * expected)


def test_smoothing_is_among_the_classes_that_a_world_has() -> None:
    """In a joint run the classes of other worlds are illegal."""
    tree = ActionTree.answer_or_move(["a", "b", "c"], ["left"])
    legal = torch.tensor([True, False, True, True]).expand(1, 1, 4)
    distribution = TreeCategorical(tree, torch.zeros(1, 1, 2), torch.zeros(1, 1, 4), legal)
    assert float(evaluated(Smoothing, distribution, tree)) == pytest.approx(math.log(2.0))


def test_supervised_is_the_cross_entropy_of_the_class_branch() -> None:
    """Class odds 4:1; the label is the first class, then the second."""
    tree = ActionTree.answer_or_move(["a", "b"], ["left", "right"])
    leaf = torch.tensor([math.log(4.0), 0.0, 0.0, 0.0]).repeat(2, 1, 1)
    distribution = TreeCategorical(tree, torch.zeros(2, 1, 2), leaf, torch.ones(2, 1, 4, dtype=torch.bool))
    loss = evaluated(Supervised, distribution, tree, labels=torch.tensor([[0], [1]]))
    assert loss.item() == pytest.approx(-(math.log(4 / 5) + math.log(1 / 5)) / 2)


@pytest.mark.parametrize("moves", [["left", "right", "on"], {"navigate": ["left", "right"], "walk": ["on"]}])
@pytest.mark.parametrize("head", ["tree", "flat"])
def test_guided_moves_are_learned_and_nothing_else(head: str, moves: Any) -> None:
    """-log of the share that nearer moves have of all, if one is legal; the mean over all steps."""
    tree = ActionTree.answer_or_move(["a", "b"], moves)
    leaf = torch.tensor([0.3, -0.2, math.log(4.0), 0.0, math.log(3.0)]).repeat(4, 1, 1).requires_grad_()
    branch = torch.zeros(4, 1, len(tree.branches))
    if len(tree.branches) == 3:
        branch[..., 1:] = torch.tensor([math.log(5.0), math.log(3.0)])  # what the leaves below weigh
    branch.requires_grad_()
    mask = torch.ones(4, 1, 5, dtype=torch.bool)
    mask[2, 0, 2] = False  # the only move that is nearer is blocked
    mask[3, 0, 2:] = False  # no move at all, as at the last view
    nearer = torch.tensor([[1, 1, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0]], dtype=torch.bool)[:, None]
    nearer = torch.cat([torch.ones(4, 1, 2, dtype=torch.bool), nearer], -1)  # classes do not count
    distribution = (
        TreeCategorical(tree, branch, leaf, mask) if head == "tree" else FlatCategorical(tree, leaf, mask)
    )
    loss = evaluated(Guided, distribution, tree, nearer=nearer)
    assert loss.item() == pytest.approx(-math.log(5 / 8) / 4)
    loss.backward()  # type: ignore[no-untyped-call]
    assert leaf.grad is not None
    assert not leaf.grad[1:].any()
    assert not leaf.grad[..., :2].any()
    if len(tree.branches) == 2 or head == "flat":
        expected = torch.tensor([4 / 8 - 4 / 5, 1 / 8 - 1 / 5, 3 / 8]) / 4
        torch.testing.assert_close(leaf.grad[0, 0, 2:], expected)
        assert branch.grad is None or not branch.grad.any()
    elif branch.grad is not None:
        torch.testing.assert_close(branch.grad[0, 0], torch.tensor([0, -3 / 8, 3 / 8]) / 4)


def test_a_rollout_that_does_not_know_what_is_nearer_guides_nothing() -> None:
    tree = ActionTree.answer_or_move(["a"], ["left"])
    assert evaluated(Guided, object(), tree, nearer=None).item() == 0.0


def test_a_term_is_learned_clipped_and_logged_with_the_rest() -> None:
    network, rollout = rollout_of()
    settings = TrainSettings(terms={"supervised": 1.0, "reward": 2.0, "guided": 0}, clip_norm=1e-3)
    learner = Learner(network, settings, seed=3)
    given = replace(rollout, output=None)
    losses = learner.losses(given, NOW)
    assert list(losses)[-2:] == ["supervised", "reward"]
    without = Learner(network, TrainSettings()).losses(given, NOW)["total"]
    assert losses["total"].item() == pytest.approx(without.item() + 2 * losses["reward"].item(), rel=1e-5)
    weight = learner.terms["reward"].out.weight
    before = weight.detach().clone()
    found = learner.update(given, NOW)
    assert {"loss/reward", "loss/supervised", "loss/total"} < found.keys()
    parameters = [*network.parameters(), *learner.terms["reward"].out.parameters()]
    norm = torch.cat([p.grad.flatten() for p in parameters if p.grad is not None]).norm()
    assert float(norm) == pytest.approx(1e-3, rel=1e-3)
    assert not torch.equal(before, weight)
    for _ in range(60):
        last = learner.update(given, NOW._replace(learning_rate=3e-3))
    assert last["loss/reward"] < found["loss/reward"]


def test_gradients_of_terms_are_averaged_over_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    network, rollout = rollout_of()
    group, averaged = Group(), []
    monkeypatch.setattr(group, "average", averaged.extend)
    learner = Learner(network, TrainSettings(terms={"reward": 1.0}), group)
    learner.update(replace(rollout, output=None), NOW)
    assert averaged == [*network.parameters(), *learner.terms["reward"].out.parameters()]


def test_first_weights_follow_from_the_seed_and_from_no_other_term() -> None:
    network, _ = rollout_of()

    def first(seed: int, **terms: float) -> Tensor:
        weight: Tensor = Learner(network, TrainSettings(terms=terms), seed=seed).terms["reward"].out.weight
        return weight

    torch.manual_seed(11)
    one = first(3, reward=1.0)
    assert torch.equal(one, first(3, supervised=1.0, reward=0.5))
    assert not torch.equal(one, first(4, reward=1.0))


TERMS = {"supervised": 1.0, "reward": 0.5}


def test_a_run_with_a_term_resumes_to_the_bit_and_its_network_knows_nothing_of_it(tmp_path: Path) -> None:
    whole, halved = new_run(tmp_path, "whole"), new_run(tmp_path, "halved")
    trained = trainer(whole, terms=TERMS)
    trained.train()
    first = trainer(halved, terms=TERMS)
    while first.step < 480:
        first._update(SimpleNamespace(add=lambda _: None))  # type: ignore[arg-type]
    first.save()
    again = trainer(halved, terms=TERMS, resume=True)
    again.train()
    assert_same(*(load_network(run.checkpoint).state_dict() for run in (whole, halved)))
    assert_same(trained.learner.state(), again.learner.state())
    tensors, _ = whole.load_training()
    assert "learner/terms/reward/out.weight/value" in tensors
    assert "learner/terms/reward/calls/value" in tensors
    assert not any("network" in name for name in tensors)
    assert load_network(whole.checkpoint).state_dict().keys() == trainer(halved).network.state_dict().keys()


@pytest.mark.parametrize(
    ("begun", "resumed", "sentence"),
    [
        (TERMS, {"supervised": 1.0}, "are reward in the checkpoint and none in train.terms; resume with"),
        ({"supervised": 1.0}, TERMS, "are none in the checkpoint and reward in train.terms; resume with"),
    ],
)
def test_other_terms_than_those_of_the_checkpoint_are_one_sentence(
    begun: dict[str, float], resumed: dict[str, float], sentence: str, tmp_path: Path
) -> None:
    run = new_run(tmp_path)
    trainer(run, terms=begun, steps=64).train()
    with pytest.raises(RunError, match=f"^The loss terms with weights {sentence}"):
        trainer(run, terms=resumed, resume=True)


def test_terms_without_weights_may_come_and_go(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    trainer(run, terms={"supervised": 1.0}, steps=64).train()
    trainer(run, terms={"guided": 1.0}, steps=128, resume=True).train()


def test_a_term_that_is_no_scalar_or_not_finite_is_named(tmp_path: Path) -> None:
    network, rollout = rollout_of()
    learner = Learner(network, TrainSettings(terms={"shapeless": 1.0}))
    with pytest.raises(
        BrokenPartError, match=r"^The loss term 'shapeless' returns a tensor \(5, 6\) and must"
    ):
        learner.losses(rollout, NOW)
    with pytest.raises(
        TrainingError, match=r"^The loss term 'infinite' is no longer finite at step .* lower its"
    ):
        trainer(new_run(tmp_path), terms=TERMS | {"infinite": 1.0}).train()


def test_an_unknown_term_is_one_sentence_unless_its_weight_is_zero() -> None:
    network, _ = rollout_of()
    with pytest.raises(UnknownPartError, match=r"no loss term 'supervise'; did you mean supervised\?"):
        Learner(network, TrainSettings(terms={"supervise": 1.0}))
    assert not Learner(network, TrainSettings(terms={"supervise": 0.0})).terms


def test_a_term_may_not_be_called_as_a_loss_of_a3c() -> None:
    with pytest.raises(ConfigError, match=r"^train\.terms\.value is the name of one of A3C's own losses"):
        needs_nearer({"value": 1.0})


@pytest.mark.parametrize("weight", [-1.0, math.inf, math.nan])
def test_weights_are_finite_and_not_negative(weight: float) -> None:
    with pytest.raises(ValueError, match="terms"):
        TrainSettings(terms={"supervised": weight})
