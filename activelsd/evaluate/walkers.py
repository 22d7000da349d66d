"""Players for worlds that are walked through: straight on, towards the target, and along the shortest way.

They go by what is in the observation, the target's box and whether the picture changed, and by their moves'
names; the oracle alone is told where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.envs.actions import NAVIGATE
from activelsd.envs.guide import Guide
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.players import Trained
from activelsd.policy.lsdnet import LSDNet

CENTRED = 0.25
"""How far from the frame's middle a box may be, as a fraction of its width: half of what a turn moves it."""

TURNS, DETOURS = 12, 3
"""Turns that look all around, and obstacles gone around in an episode."""

BORDER = 1e-3
"""A box nearer than this to the frame's border, as a fraction of it, is cut off there."""


class Blocked:
    """Notices moves that led nowhere: the picture is the one before."""

    def __init__(self) -> None:
        self._before = torch.zeros(0)

    def look(self, observation: Mapping[str, Tensor], first: Tensor) -> Tensor:
        """(B,) bool: whether the newest picture is the one before, in the same episode."""
        frames, before = observation["frames"][:, -1], self._before
        self._before = frames
        if frames.shape != before.shape:
            return torch.zeros_like(first)
        return (frames == before).flatten(1).all(1) & ~first


class Forward(Trained):
    """Walks forward to the last view allowed, turning where the way is blocked; then the network answers."""

    def __init__(self, network: LSDNet) -> None:
        super().__init__(network, "forward")
        self._forward = move_of(network, "forward", self.name)
        self._turn, self._blocked = move_of(network, "rotate_cw", self.name), Blocked()

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Forward, or around where forward changed nothing."""
        self.look(observation, mask, first)
        move = torch.where(self._blocked.look(observation, first), self._turn, self._forward)
        return torch.where(mask.gather(1, move[:, None]).squeeze(1), move, self.name_class())


class Oracle(Trained):
    """Walks the shortest way to a view that shows the target well, then the network answers.

    Where no way leads to one, it answers at once.
    """

    def __init__(self, network: LSDNet, graph: ViewGraph) -> None:
        super().__init__(network, "oracle")
        if graph.pair_of is None:
            raise ConfigError(
                "oracle needs a world whose targets have boxes, like env=avd; leave it out here."
            )
        self._guide = Guide(graph, network.value.weight.device)
        self._first_move = network.tree.span(NAVIGATE).start

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Where it is and what is asked for, int64 (B,) each; called before `act`."""
        nearer = self._guide.nearer(views, targets)
        self._goes_on, self._move = nearer.any(1), nearer.int().argmax(1) + self._first_move

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """The first move that brings it nearer, else the answer."""
        self.look(observation, mask, first)
        legal = mask.gather(1, self._move[:, None]).squeeze(1)
        return torch.where(self._goes_on & legal, self._move, self.name_class())


class Look(NamedTuple):
    """What a searcher sees."""

    middle: float  # of the box, from -0.5 at the left to 0.5 at the right
    height: float  # the same from the top to the bottom
    area: float  # of the box as a fraction of the frame, 0 out of sight
    cut: bool  # the box is at the frame's border: some of the target may be beyond
    stuck: bool  # the last move changed nothing


Search = Generator[str, Look, Look]
"""Moves by name, each answered by what is seen then; returns what was seen last."""


def _look(target: Sequence[float], stuck: bool) -> Look:
    """From the target's box and whether the last move changed nothing."""
    cx, cy, width, height, present = target
    edges = (cx - width / 2, cy - height / 2, 1 - cx - width / 2, 1 - cy - height / 2)
    return Look(cx - 0.5, cy - 0.5, width * height * present, present > 0 and min(edges) < BORDER, stuck)


def object_search(look: Look, *, tilts: bool = False) -> Search:
    """Turn until the target is seen, centre it, and approach until it no longer grows; then it is over.

    A step that brings it so near that the frame cuts it off is taken back. Where the camera `tilts`, it is
    centred from top to bottom too.
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
            # A step too far is taken back where it lost the target.
            return look if look.area else (yield "backward")
        if look.area:
            look = yield from _centre(look, tilts)
    return look


def _look_around(look: Look) -> Search:
    """Turn once around; where nothing is seen, go somewhere else."""
    for _ in range(TURNS - 1):
        look = yield "rotate_cw"
        if look.area:
            return look
    for way in ("forward", "left", "right", "backward"):
        look = yield way
        if not look.stuck:
            return look
    return look


def _centre(look: Look, tilts: bool) -> Search:
    """Turn, and tilt, towards the target."""
    look = yield from _towards(look, attrgetter("middle"), "rotate_cw", "rotate_ccw")
    if tilts and look.area:
        look = yield from _towards(look, attrgetter("height"), "look_down", "look_up")
    return look


def _towards(look: Look, off: Callable[[Look], float], more: str, less: str) -> Search:
    """Make one of two opposite moves while it brings the target nearer to the middle; else take it back."""
    while abs(off(look)) > CENTRED:
        before = look
        move, back = (more, less) if off(look) > 0 else (less, more)
        look = yield move
        if look.stuck:
            return look
        if not look.area or abs(off(look)) >= abs(off(before)):
            return (yield back)
    return look


def _back_off(look: Look) -> Search:
    """Step back until the frame no longer cuts the target off."""
    while look.cut and not look.stuck:
        look = yield "backward"
    return look


def _around(blocked: Look) -> Search:
    """Go around an obstacle, first on the side where the target is.

    A step aside after which the way on is blocked too is taken back, unless it shows the target larger. What
    is returned is `stuck` where neither side leads on.
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
    """Searches by rule (see `object_search`); the network recognises at the end of the search."""

    MOVES = ("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw")
    TILTS = ("look_up", "look_down")

    def __init__(self, network: LSDNet) -> None:
        super().__init__(network, "object_search")
        moves = network.tree.leaves[network.tree.branches.index(NAVIGATE)]
        self._tilts = all(name in moves for name in self.TILTS)
        named = self.MOVES + (self.TILTS if self._tilts else ())
        self._number = {name: move_of(network, name, self.name) for name in named}
        self._blocked = Blocked()

    def begin(self, batch: int) -> None:
        """Clear the memory and every search."""
        super().begin(batch)
        self._searches: list[Search | None] = [None] * batch

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """What each search wants next; the answer where it is over or nothing but answers is legal."""
        self.look(observation, mask, first)
        stuck = self._blocked.look(observation, first).tolist()
        looks = map(_look, observation["target"][:, -1].tolist(), stuck)
        wanted = [
            self._next(place, look, begins)
            for place, (look, begins) in enumerate(zip(looks, first.tolist(), strict=True))
        ]
        move = torch.tensor(wanted, device=mask.device)
        legal = (move >= 0) & mask.gather(1, move.clamp(min=0)[:, None]).squeeze(1)
        return torch.where(legal, move, self.name_class())

    def _next(self, place: int, look: Look, begins: bool) -> int:
        """Number of the move that the search at a place of the batch wants, -1 where it is over."""
        search = self._searches[place]
        try:
            if begins:
                search = self._searches[place] = object_search(look, tilts=self._tilts)
                return self._number[next(search)]
            return -1 if search is None else self._number[search.send(look)]
        except StopIteration:
            self._searches[place] = None
            return -1


def move_of(network: LSDNet, name: str, player: str) -> int:
    """Number of the action that makes a move.

    Raises:
        ConfigError: this world's moves have none of that name.
    """
    moves: Sequence[str] = network.tree.leaves[network.tree.branches.index(NAVIGATE)]
    if name not in moves:
        raise ConfigError(
            f"{player} needs the move '{name}', and this world's are {', '.join(moves)}; leave it out here."
        )
    return network.tree.index(NAVIGATE, name)
