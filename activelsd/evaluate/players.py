"""Who plays: a trained run, and the baselines that share its network or do without one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.envs.draws import draw, draw_key
from activelsd.envs.viewgraph import ViewGraph
from activelsd.policy.heads import ActionDistribution
from activelsd.policy.lsdnet import LSDNet


class Trained:
    """A network's own recognition, stopping and moves.

    Class and move are the likeliest. It stops at the median of the time at which the policy does, were its
    actions drawn as in training: at the view by which it would have answered in half of all cases. Asking at
    every view alone whether an answer is likelier than a move would have it go on to the last one where each
    view's chance of an answer is a little below a half.
    """

    def __init__(self, network: LSDNet, name: str = "trained") -> None:
        self.name, self.network = name, network
        self.frames = network.shape.frames
        self.classes = network.tree.span(CLASSIFY)
        self._classify = network.tree.branches.index(CLASSIFY)

    def begin(self, batch: int) -> None:
        """Clear the memory."""
        self._memory = self.network.initial_state(batch)
        self._unanswered = torch.ones(batch, device=self._memory.device)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """The likeliest class where it stops, else the likeliest move."""
        self.look(observation, mask, first)
        return torch.where(self.stops(), self.name_class(), self.likeliest_move())

    def stops(self) -> Tensor:
        """(B,) bool whether it answers now."""
        return self._unanswered <= 0.5

    def answer(self) -> Tensor:
        """The likeliest class, after all views in memory."""
        classes: Tensor = self._policy.class_log_probs().argmax(-1)
        return classes

    def look(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> ActionDistribution:
        """Take a view into memory; the policy over the actions that `mask` leaves."""
        one = {name: value[None] for name, value in observation.items()}
        output = self.network(one, self._memory, first[None])
        self._memory = output.state
        self._policy: ActionDistribution = self.network.distribution(output.logits[0], mask)
        answers = self._policy.branch_probs()[:, self._classify]
        # The chance that, drawn, it would not have answered up to here.
        self._unanswered = torch.where(first, 1.0, self._unanswered) * (1.0 - answers)
        return self._policy

    def name_class(self) -> Tensor:
        """(B,) int64 the action that names the likeliest class."""
        actions: Tensor = self.answer() + self.classes.start
        return actions

    def likeliest_move(self) -> Tensor:
        """(B,) int64 the likeliest move, where one is legal."""
        moves: Tensor = self._policy.move_log_probs().argmax(-1) + self.classes.stop
        return moves


class NoMove(Trained):
    """The network answers at the first view."""

    def __init__(self, network: LSDNet) -> None:
        super().__init__(network, "no_move")

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """The likeliest class."""
        self.look(observation, mask, first)
        return self.name_class()


class AllViews(Trained):
    """Sweeps the orbit view by view, then the network answers: the ceiling of what looking can give it."""

    def __init__(self, network: LSDNet, graph: ViewGraph) -> None:
        super().__init__(network, "all_views")
        column, self.length = longest_sweep(graph)
        self.move = self.classes.stop + column

    def begin(self, batch: int) -> None:
        """Clear the memory and the count of views."""
        super().begin(batch)
        self._seen = torch.zeros(batch, dtype=torch.int64, device=self._memory.device)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Move on until the sweep is whole or no move is legal."""
        self.look(observation, mask, first)
        self._seen = torch.where(first, 1, self._seen + 1)
        goes_on = (self._seen < self.length) & mask[:, self.move]
        return torch.where(goes_on, self.move, self.name_class())


class Draws:
    """Uniform draws numbered by episode and view, so that neither batch nor device changes them."""

    def __init__(self, seed: int) -> None:
        self._key = draw_key(np.random.default_rng(seed))

    def begin(self, batch: int) -> None:
        """Place i will play episodes i, i + batch and so on."""
        self._batch = batch
        self._episode, self._view = torch.arange(-batch, 0), torch.zeros(batch, dtype=torch.int64)

    def look(self, first: Tensor) -> None:
        """Count a view of every episode; `first` bool (B,) where the next episode begins."""
        episode = self._episode.to(first.device)
        self._episode = torch.where(first, episode + self._batch, episode)
        self._view = torch.where(first, 0, self._view.to(first.device) + 1)
        self._keys = draw(torch.full_like(self._episode, self._key), self._episode, 2**62)

    def choose(self, among: Tensor, number: int, per_view: int) -> Tensor:
        """One of the columns where `among` bool (B, n) is true; 0 in rows where none is.

        Args:
            among: (B, n) what to choose from.
            number: which of the view's draws this is.
            per_view: how many draws a view has.
        """
        drawn = draw(self._keys, self._view * per_view + number, 2**62)
        rank = drawn % among.sum(1).clamp(min=1)
        return ((among.cumsum(1) - 1 == rank[:, None]) & among).int().argmax(1)


class RandomWalk(Trained):
    """The network recognises and decides when to stop; moves are drawn uniformly from the legal ones."""

    def __init__(self, network: LSDNet, seed: int) -> None:
        super().__init__(network, "random_walk")
        self._draws = Draws(seed)

    def begin(self, batch: int) -> None:
        """Clear the memory, and draw as at first."""
        super().begin(batch)
        self._draws.begin(batch)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """The network's answer, or any legal move where it would move."""
        self.look(observation, mask, first)
        self._draws.look(first)
        moves = mask.clone()
        moves[:, self.classes] = False
        return torch.where(self.stops(), self.name_class(), self._draws.choose(moves, 0, 1))


class RandomPolicy:
    """No network: a branch drawn uniformly, then one of its legal actions."""

    name = "random_policy"
    frames = 1

    def __init__(self, tree: ActionTree, seed: int) -> None:
        self._spans = [tree.span(branch) for branch in tree.branches]
        self._classify = tree.branches.index(CLASSIFY)
        self._draws = Draws(seed)

    def begin(self, batch: int) -> None:
        """Draw as at first."""
        self._draws.begin(batch)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Any branch with a legal action, any legal action of it."""
        self._draws.look(first)
        per_view = 1 + len(self._spans)
        open_branch = torch.stack([mask[:, span].any(1) for span in self._spans], 1)
        branch = self._draws.choose(open_branch, 0, per_view)
        leaves = [
            self._draws.choose(mask[:, span], 1 + i, per_view) + span.start
            for i, span in enumerate(self._spans)
        ]
        self._named: Tensor = leaves[self._classify] - self._spans[self._classify].start
        return torch.stack(leaves, 1).gather(1, branch[:, None]).squeeze(1)

    def answer(self) -> Tensor:
        """Any class."""
        return self._named


def longest_sweep(graph: ViewGraph) -> tuple[int, int]:
    """The column of the move that, repeated, sees the most views from the first start, and how many."""
    best, most = 0, 0
    for column in range(len(graph.move_names)):
        view, seen = int(graph.start_view[0]), set[int]()
        while view >= 0 and view not in seen:
            seen.add(view)
            view = int(graph.moves[view, column])
        if len(seen) > most:
            best, most = column, len(seen)
    return best, most
