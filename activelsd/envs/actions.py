"""The action tree: named branches of named actions (paper section 3.3), flattened to one `Discrete`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import ConfigError, some

CLASSIFY = "classify"
NAVIGATE = "navigate"


class ActionTree:
    """Named branches of named actions.

    Actions are numbered branch after branch, in the given order: if `classify` is first, class `i` is action
    `i`. Every action of another branch is a move. A user adds a move by its name, or a whole branch by the
    names of its actions.

    Attributes:
        branches: branch names, in order.
        leaves: for each branch, the names of its actions.
        n: total number of actions.
        branch_of: int64 (n,), index of each action's branch.
        sizes: for each branch, its number of actions.
    """

    def __init__(self, branches: Mapping[str, Sequence[str]]) -> None:
        """Builds the tree.

        Raises:
            ConfigError: there is no branch, a branch is empty, or a branch has a name twice.
        """
        if not branches:
            raise ConfigError("An action tree needs at least one branch.")
        for branch, leaves in branches.items():
            if not leaves:
                raise ConfigError(f"Branch '{branch}' of the action tree has no action; name at least one.")
            if len(set(leaves)) != len(leaves):
                twice = next(leaf for leaf in leaves if list(leaves).count(leaf) > 1)
                raise ConfigError(f"Branch '{branch}' of the action tree names '{twice}' twice.")
        self.branches: tuple[str, ...] = tuple(branches)
        self.leaves: tuple[tuple[str, ...], ...] = tuple(tuple(leaves) for leaves in branches.values())
        self.sizes: tuple[int, ...] = tuple(len(leaves) for leaves in self.leaves)
        self.n: int = sum(self.sizes)
        self.branch_of: NDArray[np.int64] = np.repeat(np.arange(len(self.sizes)), self.sizes)
        self._first = np.concatenate([[0], np.cumsum(self.sizes)]).tolist()
        self._index = {name: i for i, name in enumerate(self.names)}

    @classmethod
    def answer_or_move(
        cls, classes: Iterable[str], moves: Iterable[str] | Mapping[str, Sequence[str]]
    ) -> ActionTree:
        """The tree of `classify` and then the moves by branch; a list of moves becomes branch `navigate`."""
        branches = moves if isinstance(moves, Mapping) else {NAVIGATE: tuple(moves)}
        return cls({CLASSIFY: tuple(classes), **branches})

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """(branch, action) of every action, in order."""
        pairs = zip(self.branches, self.leaves, strict=True)
        return tuple((branch, leaf) for branch, leaves in pairs for leaf in leaves)

    def index(self, branch: str, leaf: str) -> int:
        """The index of an action. Raises KeyError if the tree has no action of that name."""
        return self._index[branch, leaf]

    def span(self, branch: str) -> slice:
        """The slice of a branch's actions."""
        i = self.branches.index(branch)
        return slice(self._first[i], self._first[i + 1])

    @property
    def moves(self) -> slice:
        """The slice of the actions that are not answers; `classify` must be the first branch."""
        return slice(self.span(CLASSIFY).stop, self.n)

    def to_dict(self) -> dict[str, list[str]]:
        """The tree as plain lists, for JSON and YAML."""
        return {b: list(leaves) for b, leaves in zip(self.branches, self.leaves, strict=True)}

    def differences(self, world: ActionTree) -> str:
        """What a world's tree has otherwise than this one, for a sentence."""
        only_world = [leaf for branch, leaf in world.names if (branch, leaf) not in self._index]
        only_self = [leaf for branch, leaf in self.names if (branch, leaf) not in world._index]
        parts = [("only the world has", only_world), ("the world lacks", only_self)]
        return (
            ", ".join(f"{what} {some(names)}" for what, names in parts if names)
            or "they stand in another order"
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ActionTree) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.branches, self.leaves))

    def __repr__(self) -> str:
        return f"ActionTree({', '.join(f'{b}: {n}' for b, n in zip(self.branches, self.sizes, strict=True))})"
