"""Players for worlds that are walked through: straight on, towards the target, and on the shortest path.

They use the observation (the target's box, and whether the picture changed) and the names of their moves.
Only the oracle knows where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.envs.oracle import Guide
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.players import Trained
from activelsd.policy.lsdnet import LSDNet

CENTRED = 0.25
"""How far from the middle of the frame a box may be, as a fraction of it: half of what a turn shifts it."""

TURNS, DETOURS = 12, 3
"""Turns in a full circle, and the most obstacles that a search walks around in an episode."""

BORDER = 1e-3
"""A box nearer than this to the frame's border, as a fraction of the frame, counts as cut off by it."""


class Blocked:
    """Notices moves that were blocked: the picture has not changed."""

    def __init__(self) -> None:
        self._before = torch.zeros(0)

    def look(self, observation: Mapping[str, Tensor], first: Tensor) -> Tensor:
        """Returns whether the newest picture is the same as the one before in its episode, bool (B,)."""
        pictures, views = observation["frames"], observation["target"].shape[1]
        frames, before = pictures[:, -(pictures.shape[1] // views) :], self._before
        self._before = frames
        if frames.shape != before.shape:
            return torch.zeros_like(first)
        return (frames == before).flatten(1).all(1) & ~first


class Forward(Trained):
    """Walks forward to the last view allowed and turns where that is blocked; then the network answers."""

    name = "forward"

    def __init__(self, network: LSDNet, graph: ViewGraph | None = None, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        self._forward, self._turn = (move_of(network, move, self.name) for move in ("forward", "rotate_cw"))
        self._blocked = Blocked()

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns forward, a turn after forward was blocked, or the answer if that move is not legal."""
        self.look(observation, mask, first)
        move = torch.where(self._blocked.look(observation, first), self._turn, self._forward)
        return torch.where(mask.gather(1, move[:, None]).squeeze(1), move, self.name_class())


class Oracle(Trained):
    """Walks the shortest path to a view that shows the target well, then the network answers.

    If no path leads to such a view, it answers at once.
    """

    name = "oracle"

    def __init__(self, network: LSDNet, graph: ViewGraph, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        if graph.pair_of is None:
            raise ConfigError(
                f"{self.name} needs a world whose targets have boxes, like env=avd; leave it out here."
            )
        self._guide = Guide(graph, network.device)

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Takes the view and the target of every episode; see `protocol.Insider`."""
        nearer = self._guide.nearer(views, targets)
        self._goes_on, self._move = nearer.any(1), nearer.int().argmax(1) + self.moves.start

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the first move that leads nearer, else the answer."""
        self.look(observation, mask, first)
        legal = mask.gather(1, self._move[:, None]).squeeze(1)
        return torch.where(self._goes_on & legal, self._move, self.name_class())


class Look(NamedTuple):
    """What a search sees in one view."""

    middle: float  # horizontal centre of the box, from -0.5 at the left to 0.5 at the right
    height: float  # vertical centre of the box, from -0.5 at the top to 0.5 at the bottom
    area: float  # of the box as a fraction of the frame; 0 if the target is out of sight
    cut: bool  # the box touches the frame's border: a part of the target may be beyond it
    stuck: bool  # the last move was blocked


Search = Generator[str, Look, Look]
"""Yields names of moves, is sent the view that each leads to, and returns the last view."""


def _look(target: Sequence[float], stuck: bool) -> Look:
    """Makes a `Look` from the target's box (cx, cy, w, h, present) and whether the last move was blocked."""
    cx, cy, width, height, present = target
    edges = (cx - width / 2, cy - height / 2, 1 - cx - width / 2, 1 - cy - height / 2)
    return Look(cx - 0.5, cy - 0.5, width * height * present, present > 0 and min(edges) < BORDER, stuck)


def object_search(look: Look, *, tilts: bool = False) -> Search:
    """Turns until the target is in sight, centres it, and approaches until it no longer grows.

    A step after which the frame cuts the target off is taken back. If the camera `tilts`, the target is
    centred vertically too.
    """
    while not look.area:
        look = yield from _look_around(look)
    look = yield from _centre(look, tilts)
    detours = 0
    while look.area:
        if look.cut:
            return (yield from _back_off(look))
        before = look
        look = yield "forward"
        if look.stuck:
            detours += 1
            look = yield from _around(look)
            if look.stuck or detours > DETOURS:
                return look
        elif look.area <= before.area:
            # The last step did not help; it is taken back if it lost the target.
            return look if look.area else (yield "backward")
        if look.area:
            look = yield from _centre(look, tilts)
    return look


def _look_around(look: Look) -> Search:
    """Turns in a full circle; if the target is not in sight, makes the first step that is not blocked."""
    for _ in range(TURNS - 1):
        look = yield "rotate_cw"
        if look.area:
            return look
    for move in ("forward", "left", "right", "backward"):
        look = yield move
        if not look.stuck:
            return look
    return look


def _centre(look: Look, tilts: bool) -> Search:
    """Turns, and tilts, towards the target."""
    look = yield from _reduce(look, attrgetter("middle"), "rotate_cw", "rotate_ccw")
    if tilts and look.area:
        look = yield from _reduce(look, attrgetter("height"), "look_down", "look_up")
    return look


def _reduce(look: Look, offset: Callable[[Look], float], more: str, less: str) -> Search:
    """Makes one of two opposite moves until the offset is small; takes back one that does not reduce it."""
    while abs(offset(look)) > CENTRED:
        before = look
        move, back = (more, less) if offset(look) > 0 else (less, more)
        look = yield move
        if look.stuck:
            return look
        if not look.area or abs(offset(look)) >= abs(offset(before)):
            return (yield back)
    return look


def _back_off(look: Look) -> Search:
    """Steps back until the frame no longer cuts the target off."""
    while look.cut and not look.stuck:
        look = yield "backward"
    return look


def _around(blocked: Look) -> Search:
    """Walks around an obstacle, first on the side where the target is.

    If forward is blocked after the step aside too, that step is taken back, unless it shows the target
    larger. The look returned is `stuck` if neither side leads on.
    """
    for side, back in sorted((("left", "right"), ("right", "left")), reverse=blocked.middle > 0):
        aside = yield side
        if aside.stuck:
            continue
        ahead = yield "forward"
        if not ahead.stuck or aside.area > blocked.area:
            return ahead
        yield back
    return blocked


class ObjectSearch(Trained):
    """Searches by rule (see `object_search`); the network answers at the end of the search."""

    name = "object_search"
    MOVES = ("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw")
    TILTS = ("look_up", "look_down")

    def __init__(self, network: LSDNet, graph: ViewGraph | None = None, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        self._tilts = set(self.TILTS) <= set(move_names(network))
        needed = self.MOVES + (self.TILTS if self._tilts else ())
        self._index = {name: move_of(network, name, self.name) for name in needed}
        self._blocked = Blocked()

    def begin(self, batch: int) -> None:
        """Clears the memory and every search."""
        super().begin(batch)
        self._searches: list[Search | None] = [None] * batch

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns each search's next move, or the answer if it is over or its move is not legal."""
        self.look(observation, mask, first)
        stuck = self._blocked.look(observation, first).tolist()
        looks = map(_look, observation["target"][:, -1].tolist(), stuck)
        wanted = [
            self._next(i, look, begins)
            for i, (look, begins) in enumerate(zip(looks, first.tolist(), strict=True))
        ]
        move = torch.tensor(wanted, device=mask.device)
        legal = (move >= 0) & mask.gather(1, move.clamp(min=0)[:, None]).squeeze(1)
        return torch.where(legal, move, self.name_class())

    def _next(self, i: int, look: Look, begins: bool) -> int:
        """Returns the next action of the search at an index of the batch; -1 if it is over."""
        search = self._searches[i]
        try:
            if begins:
                search = self._searches[i] = object_search(look, tilts=self._tilts)
                return self._index[next(search)]
            return -1 if search is None else self._index[search.send(look)]
        except StopIteration:
            self._searches[i] = None
            return -1


def move_names(network: LSDNet) -> list[str]:
    """Returns the names of a network's moves, of all branches, in order."""
    return [name for _, name in network.tree.names[network.tree.moves]]


def move_of(network: LSDNet, name: str, player: str) -> int:
    """Returns the action that makes a move, whatever its branch.

    Raises:
        ConfigError: this world has no move of that name.
    """
    names = move_names(network)
    if name not in names:
        raise ConfigError(
            f"{player} needs the move '{name}', and this world's are {', '.join(names)}; leave it out here."
        )
    return int(network.tree.moves.start) + names.index(name)
