"""The action tree: order, spans and numbers for any number of branches, and its errors' sentences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError

NAMES = st.text("abcdef_0", min_size=1, max_size=4)
TREES = st.dictionaries(NAMES, st.lists(NAMES, min_size=1, max_size=5, unique=True), min_size=1, max_size=5)


def test_paper_tree_has_classes_first_then_moves() -> None:
    tree = ActionTree.answer_or_move(["airplane", "bathtub", "bed"], ["orbit_cw", "orbit_ccw"])
    assert tree.branches == ("classify", "navigate")
    assert tree.n == 5
    assert tree.names[0] == ("classify", "airplane")
    assert tree.names[3] == ("navigate", "orbit_cw")
    assert tree.span("classify") == slice(0, 3)
    assert tree.span("navigate") == slice(3, 5)
    assert tree.index("classify", "bed") == 2
    assert tree.index("navigate", "orbit_ccw") == 4


@settings(max_examples=60)
@given(TREES)
def test_actions_are_numbered_branch_after_branch(branches: dict[str, list[str]]) -> None:
    tree = ActionTree(branches)
    expected = [(branch, leaf) for branch, leaves in branches.items() for leaf in leaves]
    assert list(tree.names) == expected
    assert tree.n == len(expected)
    assert tree.sizes == tuple(len(leaves) for leaves in branches.values())
    assert tree.branch_of.dtype == np.int64
    for number, (branch, leaf) in enumerate(expected):
        assert tree.index(branch, leaf) == number
        assert tree.branches[tree.branch_of[number]] == branch
        span = tree.span(branch)
        assert tree.leaves[tree.branches.index(branch)][number - span.start] == leaf
    assert ActionTree(tree.to_dict()) == tree
    assert hash(ActionTree(tree.to_dict())) == hash(tree)


def test_the_same_leaf_in_two_branches_is_two_actions() -> None:
    tree = ActionTree({"walk": ["left", "right"], "turn": ["left", "right"]})
    assert tree.index("walk", "left") == 0
    assert tree.index("turn", "left") == 2


def test_trees_differ_by_order_and_by_branch() -> None:
    one = ActionTree({"a": ["x", "y"]})
    assert one != ActionTree({"a": ["y", "x"]})
    assert one != ActionTree({"b": ["x", "y"]})
    assert one != "ActionTree(a: 2)"
    assert repr(one) == "ActionTree(a: 2)"


@pytest.mark.parametrize(
    ("branches", "sentence"),
    [
        ({}, "An action tree needs at least one branch."),
        (
            {"classify": ["cup"], "navigate": []},
            "Branch 'navigate' of the action tree has no action; name at least one.",
        ),
        ({"classify": ["cup", "bowl", "cup"]}, "Branch 'classify' of the action tree names 'cup' twice."),
    ],
)
def test_errors_are_one_sentence(branches: dict[str, list[str]], sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        ActionTree(branches)
    assert str(error.value) == sentence


def test_unknown_names_are_refused() -> None:
    tree = ActionTree({"classify": ["cup"]})
    with pytest.raises(KeyError):
        tree.index("classify", "bowl")
    with pytest.raises(ValueError, match="not in tuple"):
        tree.span("navigate")
