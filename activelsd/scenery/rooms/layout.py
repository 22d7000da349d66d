"""What stands where: furniture along the walls and free in the room, small things on it and on the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from activelsd.errors import DataError
from activelsd.scenery.rooms.footprints import Rect, overlap
from activelsd.scenery.rooms.library import Library
from activelsd.scenery.rooms.models import Model
from activelsd.scenery.rooms.shell import DOOR_ZONE, WALLS, YAWS, FloorPlan, draw_plan, draw_shell
from activelsd.scenery.rooms.supports import Supports

FLOOR = -1
"""What a thing stands on that stands on the floor."""

FREE_STANDING = frozenset({"armchair", "chair", "coffee_table", "table"})
"""Kinds that may stand away from the walls."""

_GAP = 0.04  # metres between neighbours, and from the wall behind
_PASSAGE = 0.55  # metres around what stands free, for an agent to pass
_COVERED = 0.42  # most share of the floor under furniture
_FEWEST, _MOST = 6, 12  # pieces of furniture
_ALIKE = 2  # most pieces of one kind
_NUMBERS = 10_000  # of a kind's pieces that are drawn from
_ROUNDS = 2  # through the kinds
_ATTEMPTS = 8  # at a room
_TRIES = 60  # at a place
_LOWEST_SILL = 0.9  # metres; what is higher does not stand before a window
_ON_FLOOR = 0.08  # share of small things laid there even where there are surfaces
_SIZES = (3.4, 4.6)  # metres, sides of a room


class Placed(NamedTuple):
    """A model where it stands."""

    model: Model
    x: float
    y: float
    z: float
    yaw: float  # degrees, counter-clockwise
    on: int  # number of what it stands on among the room's things, or FLOOR

    @property
    def footprint(self) -> Rect:
        """What it covers seen from above, its bounding rectangle in its own axes."""
        width, depth, _ = self.model.size
        return Rect(self.x, self.y, width / 2, depth / 2, self.yaw)

    @property
    def top(self) -> float:
        """Metres above the floor of its highest point."""
        return self.z + self.model.size[2]


@dataclass(frozen=True, kw_only=True)
class Room:
    """A room with what stands in it; things are the furniture and then what was put on it."""

    plan: FloorPlan
    shell: Model
    furniture: int  # how many of the things are furniture
    things: tuple[Placed, ...]
    light: tuple[float, float, float]

    @cached_property
    def footprints(self) -> tuple[Rect, ...]:
        """Of all that stands on the floor."""
        return tuple(thing.footprint for thing in self.things if thing.on == FLOOR)


def furnish(
    library: Library,
    seed: int | Sequence[int],
    *,
    pieces: int | None = None,
    size: tuple[float, float] | None = None,
    ceiling: bool = True,
    kinds: Sequence[str] | None = None,
) -> Room:
    """A room with furniture and nothing on it, the same for the same arguments.

    Args:
        library: gives the furniture.
        seed: what to draw from.
        pieces: how many pieces of furniture; None for 6 to 12.
        size: width and depth in metres; None to draw them.
        ceiling: whether there is one.
        kinds: of furniture; None for all that the library has. One that is named twice comes more often.

    Raises:
        DataError: so many pieces do not fit into a room of that size.
    """
    rng = np.random.default_rng(seed)
    wanted = int(rng.integers(_FEWEST, _MOST + 1)) if pieces is None else pieces
    width, depth = (float(side) for side in rng.uniform(*_SIZES, 2)) if size is None else size
    plan = draw_plan(rng, width, depth, ceiling=ceiling)
    shell = draw_shell(rng, plan)
    names = library.kinds if kinds is None else kinds
    for _ in range(_ATTEMPTS):
        things = _filled(rng, plan, library, names, wanted)
        if len(things) >= (_FEWEST if pieces is None else pieces):
            break
    else:
        raise DataError(
            f"{wanted} pieces of furniture do not fit into a room of {width:.1f} by {depth:.1f} m;"
            " ask for fewer or a larger room."
        )
    x, y = width * rng.uniform(0.4, 0.6), depth * rng.uniform(0.4, 0.6)
    light = (float(x), float(y), plan.height - 0.15)
    return Room(plan=plan, shell=shell, furniture=len(things), things=tuple(things), light=light)


def set_out(
    room: Room,
    small: Sequence[Model],
    seed: int | Sequence[int],
    *,
    on: Sequence[str] | None = None,
    turned: float = 120.0,
    laid: float = _ON_FLOOR,
) -> Room:
    """The room with small things put on its furniture, and on the floor where there is no place.

    Args:
        room: as furnished, or with other things put out before.
        small: what to put out, in this order.
        seed: what to draw from.
        on: kinds of furniture to put them on; None for all.
        turned: most degrees that a thing's front is turned away from the furniture's, either way.
        laid: share of them put on the floor even where there are surfaces.

    Raises:
        DataError: there is no place on the floor either.
    """
    rng = np.random.default_rng(seed)
    supports = [Supports(thing.model) for thing in room.things[: room.furniture]]
    # the root gives a night stand its share beside a bed
    areas = np.sqrt([support.area for support in supports])
    if on is not None:
        areas *= [thing.model.kind in on for thing in room.things[: room.furniture]]
    things = list(room.things)
    for model in small:
        placed = None
        if areas.any() and rng.random() >= laid:
            placed = _put(rng, model, things, supports, areas / areas.sum(), turned)
        things.append(placed or _lay(rng, room.plan, model, things))
    return replace(room, things=tuple(things))


def set_down(room: Room, small: Sequence[Model], seed: int | Sequence[int]) -> Room:
    """The room with things put on its floor, along the walls.

    Raises:
        DataError: there is no place.
    """
    rng = np.random.default_rng(seed)
    things = list(room.things)
    for model in small:
        things.append(_lay(rng, room.plan, model, things))
    return replace(room, things=tuple(things))


def _filled(
    rng: np.random.Generator, plan: FloorPlan, library: Library, names: Sequence[str], wanted: int
) -> list[Placed]:
    """Up to as many pieces of furniture as wanted, from nothing."""
    things: list[Placed] = []
    for i in np.concatenate([rng.permutation(len(names)) for _ in range(_ROUNDS)]):
        if len(things) == wanted:
            break
        if sum(thing.model.kind == names[i] for thing in things) < _ALIKE:
            placed = _place(rng, plan, library.model(names[i], int(rng.integers(_NUMBERS))), things)
            things += [placed] if placed is not None else []
    return things


def _place(
    rng: np.random.Generator, plan: FloorPlan, model: Model, things: Sequence[Placed]
) -> Placed | None:
    """A piece of furniture in a place that is free, or None where none was found."""
    free = model.kind in FREE_STANDING and rng.random() < 0.6
    width, depth, _ = model.size
    covered = sum(4 * thing.footprint.half_x * thing.footprint.half_y for thing in things)
    if covered + width * depth > _COVERED * plan.width * plan.depth:
        return None
    for _ in range(_TRIES):
        if free:
            x, y = rng.uniform(0.25, 0.75) * plan.width, rng.uniform(0.25, 0.75) * plan.depth
            yaw = float(rng.choice((0.0, 90.0, 180.0, 270.0)) + rng.uniform(-15, 15))
        else:
            wall = WALLS[rng.integers(4)]
            span = plan.length(wall) - width - 2 * _GAP
            if span <= 0:
                continue
            left = _GAP + width / 2 + span * float(rng.choice((0.0, 1.0, rng.random())))
            x, y = plan.along(wall, left, depth / 2 + _GAP)
            yaw = YAWS[wall]
        placed = Placed(model, float(x), float(y), 0.0, yaw, FLOOR)
        if _has_place(plan, placed, things, _PASSAGE if free else _GAP):
            return placed
    return None


def _has_place(plan: FloorPlan, placed: Placed, things: Sequence[Placed], gap: float) -> bool:
    """Whether it stands inside the walls, off doors, windows it would cover, and other things by a gap."""
    own = placed.footprint
    if not _inside(plan, own):
        return False
    for opening in plan.openings:
        zone = plan.before(opening, DOOR_ZONE if opening.kind == "door" else 0.25)
        if (opening.kind == "door" or placed.top > _LOWEST_SILL) and overlap(own, zone):
            return False
    return not any(overlap(own.grown(gap), thing.footprint) for thing in things if thing.on == FLOOR)


def _inside(plan: FloorPlan, rect: Rect) -> bool:
    corners = rect.corners()
    return bool((corners > 0.015).all() and (corners < (plan.width - 0.015, plan.depth - 0.015)).all())


def _put(
    rng: np.random.Generator,
    model: Model,
    things: Sequence[Placed],
    supports: Sequence[Supports],
    shares: np.ndarray[tuple[int], np.dtype[np.float64]],
    most: float,
) -> Placed | None:
    """A small thing on a surface of the furniture, its front more or less the furniture's."""
    width, depth, height = model.size
    for _ in range(_TRIES):
        on = int(rng.choice(len(supports), p=shares))
        x, y, z = supports[on].draw(rng)
        turned = float(rng.uniform(-most, most))
        if not supports[on].holds(Rect(x, y, width / 2, depth / 2, turned), z, height + 0.01):
            continue
        piece = things[on]
        angle = math.radians(piece.yaw)
        placed = Placed(
            model,
            piece.x + math.cos(angle) * x - math.sin(angle) * y,
            piece.y + math.sin(angle) * x + math.cos(angle) * y,
            piece.z + z,
            piece.yaw + turned,
            on,
        )
        if not any(_meet(placed, thing) for thing in things[len(supports) :]):
            return placed
    return None


def _meet(a: Placed, b: Placed) -> bool:
    """Whether the boxes around two things meet, or nearly."""
    return a.z < b.top and b.z < a.top and overlap(a.footprint.grown(0.01), b.footprint)


def _lay(rng: np.random.Generator, plan: FloorPlan, model: Model, things: Sequence[Placed]) -> Placed:
    """A small thing on the floor, along the walls rather than in the way."""
    for _ in range(20 * _TRIES):
        wall = WALLS[rng.integers(4)]
        x, y = plan.along(wall, float(rng.uniform(0, plan.length(wall))), float(rng.uniform(0.1, 0.35)))
        placed = Placed(model, x, y, 0.0, float(rng.uniform(0, 360)), FLOOR)
        if _has_place(plan, placed, things, 0.01):
            return placed
    raise DataError(
        f"There is no place left for a {model.kind} in a room of {plan.width:.1f} by {plan.depth:.1f} m;"
        " put fewer things into it or make it larger."
    )
