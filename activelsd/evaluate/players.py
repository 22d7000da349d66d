"""Players: a trained run, and those that share its network or do without one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from activelsd import registry
from activelsd.envs.actions import CLASSIFY
from activelsd.envs.draws import draw, draw_key
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.protocol import Player
from activelsd.evaluate.stops import Learned, Stop
from activelsd.policy.heads import ActionDistribution
from activelsd.policy.lsdnet import LSDNet


def make_player(name: str, network: LSDNet, graph: ViewGraph, seed: int) -> Player:
    """Returns the player of a name, called by that name: a registered one, or MOVES+STOP.

    MOVES is a registered player whose moves are combined with another stop, or `learned` for the run's own.

    Raises:
        UnknownPartError: no player or stop has that name.
        ConfigError: the player needs moves or boxes that this world does not have, or takes no other stop.
    """
    moves, stop = registry.moves_and_stop(name)
    check_stop(moves, stop)
    make = _class_of(moves, stop)
    with registry.players.blaming(moves, "cannot be made"):
        player: Player = make(network, graph, seed)
        player.name, _ = name, player.frames
    if stop:
        with registry.stops.blaming(stop, "cannot be made"):
            player.stop = registry.stops.get(stop)(network)  # type: ignore[attr-defined]
    return player


def check_stop(moves: str, stop: str) -> None:
    """Raises ConfigError if a stop is given to a player that decides by itself when to answer."""
    if stop and not takes_stops(moves, stop):
        raise ConfigError(
            f"{moves} decides by itself when to answer; write {moves} in place of {moves}+{stop}."
        )


def takes_stops(moves: str, stop: str = "") -> bool:
    """Returns whether the player of a name asks a stop."""
    return bool(getattr(_class_of(moves, stop), "takes_stops", False))


def _class_of(moves: str, stop: str) -> Any:
    return Trained if stop and moves == registry.LEARNED else registry.players.get(moves)


class Trained:
    """A network that recognises, moves and decides when to stop.

    It takes the likeliest class and the likeliest move, and answers when its stop says so.

    Other players derive from it, and define `act`, or `move` alone.

    Attributes:
        name: what tables and files call the player.
        network: the network that looks.
        frames: K, how many views are stacked.
        classes: the actions that answer.
        moves: the actions that move, of all branches.
        draws: random draws that the seed fixes, for players that need them.
        stop: decides when to answer; `stops.Learned`, as the run was trained, unless replaced.
        takes_stops: whether it asks its stop, so that another may replace it; of the class. Unless a class
            says otherwise, not if it has an `act` of its own.
    """

    name = "trained"
    takes_stops: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        """Sets `takes_stops` of a class that does not."""
        super().__init_subclass__()
        if "act" in vars(cls) and "takes_stops" not in vars(cls):
            cls.takes_stops = False

    def __init__(
        self, network: LSDNet, graph: ViewGraph | None = None, seed: int = 0, *, name: str | None = None
    ) -> None:
        """Sets the player up; a name given replaces the class's own, and `graph` is for subclasses."""
        self.name = name or self.name
        self.network, self.frames = network, network.shape.frames
        self.classes, self.moves = network.tree.span(CLASSIFY), network.tree.moves
        self.stop: Stop = Learned(network)
        self.draws = Draws(seed)

    def begin(self, batch: int) -> None:
        """Clears the memory and starts the draws again."""
        self.draws.begin(batch)
        self._memory = self.network.initial_state(batch)
        self.stop.begin(batch, self.network.device)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the likeliest class if it stops here or no move is legal, else a move."""
        self.look(observation, mask, first)
        ends = self.stop.stops() | ~mask[:, self.moves].any(1)
        return torch.where(ends, self.name_class(), self.move(mask))

    def move(self, mask: Tensor) -> Tensor:
        """Returns the next move, int64 (B,); illegal only if no move is legal."""
        return self.likeliest_move()

    def answer(self) -> Tensor:
        """Returns the likeliest class given all views in memory, int64 (B,)."""
        classes: Tensor = self._policy.class_log_probs().argmax(-1)
        return classes

    def look(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> ActionDistribution:
        """Adds a view to the memory and returns the policy over the legal actions; call it once in `act`."""
        self.draws.look(first)
        one = {name: value[None] for name, value in observation.items()}
        output = self.network(one, self._memory, first[None])
        self._memory = output.state
        self._policy: ActionDistribution = self.network.distribution(output.logits[0], mask)
        self.stop.look(self._policy, first)
        return self._policy

    def name_class(self) -> Tensor:
        """Returns the action that answers with the likeliest class, int64 (B,)."""
        actions: Tensor = self.answer() + self.classes.start
        return actions

    def likeliest_move(self) -> Tensor:
        """Returns the likeliest move of all branches, int64 (B,); illegal only if no move is legal."""
        moves: Tensor = self._policy.move_log_probs().argmax(-1) + self.moves.start
        return moves

    def random_move(self, mask: Tensor) -> Tensor:
        """Draws one of the legal moves uniformly, int64 (B,); illegal only if no move is legal."""
        return self.draws.choose(mask[:, self.moves], 0, 1) + int(self.moves.start)


class NoMove(Trained):
    """The network answers at the first view."""

    name = "no_move"

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the likeliest class."""
        self.look(observation, mask, first)
        return self.name_class()


class Sweep(Trained):
    """Repeats the move that sees the most views from the episode's start, until its stop or all are seen."""

    name = "sweep"
    takes_stops = True

    def __init__(self, network: LSDNet, graph: ViewGraph, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        self._graph = graph

    def begin(self, batch: int) -> None:
        """Clears the memory and the count of views."""
        super().begin(batch)
        self._move, self._length, self._seen = torch.zeros(
            3, batch, dtype=torch.int64, device=self.network.device
        )

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Takes the view that every episode is at; see `protocol.Insider`."""
        self._views = views

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the repeated move until it stops, all its views are seen, or it is not legal."""
        self.look(observation, mask, first)
        for i in first.nonzero().squeeze(1).tolist():
            column, length = longest_sweep(self._graph, int(self._views[i]))
            self._move[i], self._length[i], self._seen[i] = self.moves.start + column, length, 0
        self._seen += 1
        legal = mask.gather(1, self._move[:, None]).squeeze(1)
        goes = (self._seen < self._length) & legal & ~self.stops_early()
        return torch.where(goes, self._move, self.name_class())

    def stops_early(self) -> Tensor:
        """Returns whether it answers before all is seen, bool (B,)."""
        return self.stop.stops()


class AllViews(Sweep):
    """Sees all views that one repeated move leads to: the most that looking can give a network."""

    name = "all_views"
    takes_stops = False

    def stops_early(self) -> Tensor:
        """Never."""
        return torch.zeros_like(self._seen, dtype=torch.bool)


class Draws:
    """Uniform draws that depend on episode and view only, not on the batch or the device."""

    def __init__(self, seed: int) -> None:
        self._key = draw_key(np.random.default_rng(seed))

    def begin(self, batch: int) -> None:
        """Starts again; environment i of the batch will play episodes i, i + batch and so on."""
        self._batch = batch
        self._episode, self._view = torch.arange(-batch, 0), torch.zeros(batch, dtype=torch.int64)

    def look(self, first: Tensor) -> None:
        """Counts a view of every episode; `first` bool (B,) is true where the next episode begins."""
        episode = self._episode.to(first.device)
        self._episode = torch.where(first, episode + self._batch, episode)
        self._view = torch.where(first, 0, self._view.to(first.device) + 1)
        self._keys = draw(torch.full_like(self._episode, self._key), self._episode, 2**62)

    def choose(self, among: Tensor, number: int, per_view: int) -> Tensor:
        """Draws one true column of every row, int64 (B,); 0 in rows without one.

        Args:
            among: bool (B, n) the columns to choose from.
            number: index of this draw among those of the view.
            per_view: how many draws a view has.
        """
        drawn = draw(self._keys, self._view * per_view + number, 2**62)
        rank = drawn % among.sum(1).clamp(min=1)
        return ((among.cumsum(1) - 1 == rank[:, None]) & among).int().argmax(1)


class RandomWalk(Trained):
    """The network recognises and decides when to stop; moves are drawn uniformly from the legal ones."""

    name = "random_walk"

    def move(self, mask: Tensor) -> Tensor:
        """Returns any legal move."""
        return self.random_move(mask)


class RandomPolicy:
    """Draws a branch uniformly, then one of its legal actions; it needs the network's action tree only."""

    name = "random_policy"
    frames = 1

    def __init__(self, network: LSDNet, graph: ViewGraph | None = None, seed: int = 0) -> None:
        tree = network.tree
        self._spans = [tree.span(branch) for branch in tree.branches]
        self._classify = tree.branches.index(CLASSIFY)
        self._draws = Draws(seed)

    def begin(self, batch: int) -> None:
        """Starts the draws again."""
        self._draws.begin(batch)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns any legal action of any branch that has one."""
        self._draws.look(first)
        per_view = 1 + len(self._spans)
        open_branch = torch.stack([mask[:, span].any(1) for span in self._spans], 1)
        branch = self._draws.choose(open_branch, 0, per_view)
        leaves = [
            self._draws.choose(mask[:, span], 1 + i, per_view) + span.start
            for i, span in enumerate(self._spans)
        ]
        self._class: Tensor = leaves[self._classify] - self._spans[self._classify].start
        return torch.stack(leaves, 1).gather(1, branch[:, None]).squeeze(1)

    def answer(self) -> Tensor:
        """Returns the class drawn at this view, int64 (B,)."""
        return self._class


def longest_sweep(graph: ViewGraph, start: int) -> tuple[int, int]:
    """Returns the column of the move that, repeated from a view, sees the most views, and how many."""
    best, most = 0, 0
    for column in range(len(graph.move_names)):
        view, seen = start, set[int]()
        while view >= 0 and view not in seen:
            seen.add(view)
            view = int(graph.moves[view, column])
        if len(seen) > most:
            best, most = column, len(seen)
    return best, most
