"""Room layout: furniture along the walls or free-standing, small objects on furniture and on the floor."""

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
"""The value of `Placed.on` for an object that stands on the floor."""

FREE_STANDING = frozenset({"armchair", "chair", "coffee_table", "table"})
"""Kinds that may stand away from the walls."""

_GAP = 0.04  # metres between neighbours, and to the wall behind
_PASSAGE = 0.55  # metres kept free around free-standing furniture, for the agent
_COVERED = 0.42  # largest fraction of the floor that furniture may cover
_FEWEST, _MOST = 6, 12  # pieces of furniture
_ALIKE = 2  # most pieces of one kind
_NUMBERS = 10_000  # pieces per kind to draw from
_ROUNDS = 2  # passes over the kinds
_ATTEMPTS = 8  # to furnish a room
_TRIES = 60  # to find a place
_LOWEST_SILL = 0.9  # metres; higher furniture is not placed in front of a window
_ON_FLOOR = 0.08  # fraction of small objects put on the floor even if furniture has space
_SIZES = (3.4, 4.6)  # metres, shortest and longest side of a room


class Placed(NamedTuple):
    """A model at its place in a room."""

    model: Model
    x: float
    y: float
    z: float
    yaw: float  # degrees, counter-clockwise
    on: int  # index in the room's things of the furniture it stands on, or FLOOR

    @property
    def footprint(self) -> Rect:
        """Its bounding rectangle seen from above, in its own axes."""
        width, depth, _ = self.model.size
        return Rect(self.x, self.y, width / 2, depth / 2, self.yaw)

    @property
    def top(self) -> float:
        """Height of its highest point above the floor in metres."""
        return self.z + self.model.size[2]


@dataclass(frozen=True, kw_only=True)
class Room:
    """A room and its contents; `things` has the furniture first, then the small objects."""

    plan: FloorPlan
    shell: Model
    furniture: int  # number of things that are furniture
    things: tuple[Placed, ...]
    light: tuple[float, float, float]

    @cached_property
    def footprints(self) -> tuple[Rect, ...]:
        """Footprints of all objects that stand on the floor."""
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
    """A room with furniture and no small objects; the same for the same arguments.

    Args:
        library: source of the furniture.
        seed: seed of the random generator.
        pieces: number of pieces of furniture; None for 6 to 12.
        size: width and depth in metres; None for random ones.
        ceiling: whether the room has a ceiling.
        kinds: kinds of furniture; None for all of the library's. A kind that is named twice is more frequent.

    Raises:
        DataError: the pieces do not fit into a room of that size.
    """
    rng = np.random.default_rng(seed)
    wanted = int(rng.integers(_FEWEST, _MOST + 1)) if pieces is None else pieces
    width, depth = (float(side) for side in rng.uniform(*_SIZES, 2)) if size is None else size
    plan = draw_plan(rng, width, depth, ceiling=ceiling)
    shell = draw_shell(rng, plan)
    names = library.kinds if kinds is None else kinds
    for _ in range(_ATTEMPTS):
        things = _place_furniture(rng, plan, library, names, wanted)
        if len(things) >= (_FEWEST if pieces is None else pieces):
            break
    else:
        raise DataError(
            f"{wanted} pieces of furniture do not fit into a room of {width:.1f} by {depth:.1f} m;"
            " ask for fewer or for a larger room."
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
    """The room with small objects put on its furniture, or on the floor if the furniture has no space.

    Args:
        room: furnished room, which may already have small objects.
        small: objects to add, in this order.
        seed: seed of the random generator.
        on: kinds of furniture to put them on; None for all.
        turned: largest angle in degrees, either way, between an object's front and the furniture's front.
        laid: fraction of the objects put on the floor even if the furniture has space.

    Raises:
        DataError: there is no space on the floor either.
    """
    rng = np.random.default_rng(seed)
    supports = [Supports(thing.model) for thing in room.things[: room.furniture]]
    # by the square root, small furniture (a night stand beside a bed) also gets objects
    areas = np.sqrt([support.area for support in supports])
    if on is not None:
        areas *= [thing.model.kind in on for thing in room.things[: room.furniture]]
    things = list(room.things)
    for model in small:
        placed = None
        if areas.any() and rng.random() >= laid:
            placed = _put_on_furniture(rng, model, things, supports, areas / areas.sum(), turned)
        things.append(placed or _put_on_floor(rng, room.plan, model, things))
    return replace(room, things=tuple(things))


def set_down(room: Room, small: Sequence[Model], seed: int | Sequence[int]) -> Room:
    """The room with objects put on its floor, along the walls.

    Raises:
        DataError: there is no space.
    """
    rng = np.random.default_rng(seed)
    things = list(room.things)
    for model in small:
        things.append(_put_on_floor(rng, room.plan, model, things))
    return replace(room, things=tuple(things))


def _place_furniture(
    rng: np.random.Generator, plan: FloorPlan, library: Library, names: Sequence[str], wanted: int
) -> list[Placed]:
    """Up to `wanted` pieces of furniture in an empty room."""
    things: list[Placed] = []
    for i in np.concatenate([rng.permutation(len(names)) for _ in range(_ROUNDS)]):
        if len(things) == wanted:
            break
        if sum(thing.model.kind == names[i] for thing in things) < _ALIKE:
            placed = _place_piece(rng, plan, library.model(names[i], int(rng.integers(_NUMBERS))), things)
            things += [placed] if placed is not None else []
    return things


def _place_piece(
    rng: np.random.Generator, plan: FloorPlan, model: Model, things: Sequence[Placed]
) -> Placed | None:
    """A piece of furniture at a free place, or None if none was found."""
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
        if _is_free(plan, placed, things, _PASSAGE if free else _GAP):
            return placed
    return None


def _is_free(plan: FloorPlan, placed: Placed, things: Sequence[Placed], gap: float) -> bool:
    """Whether it is inside the walls, covers no door or window, and keeps a gap to other things."""
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


def _put_on_furniture(
    rng: np.random.Generator,
    model: Model,
    things: Sequence[Placed],
    supports: Sequence[Supports],
    shares: np.ndarray[tuple[int], np.dtype[np.float64]],
    most: float,
) -> Placed | None:
    """A small object on a piece of furniture, turned by up to `most` degrees; None if there is no space."""
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
        if not any(_collide(placed, thing) for thing in things[len(supports) :]):
            return placed
    return None


def _collide(a: Placed, b: Placed) -> bool:
    """Whether the bounding boxes of two objects overlap or are less than 1 cm apart."""
    return a.z < b.top and b.z < a.top and overlap(a.footprint.grown(0.01), b.footprint)


def _put_on_floor(
    rng: np.random.Generator, plan: FloorPlan, model: Model, things: Sequence[Placed]
) -> Placed:
    """A small object on the floor, close to a wall so that the agent can pass."""
    for _ in range(20 * _TRIES):
        wall = WALLS[rng.integers(4)]
        x, y = plan.along(wall, float(rng.uniform(0, plan.length(wall))), float(rng.uniform(0.1, 0.35)))
        placed = Placed(model, x, y, 0.0, float(rng.uniform(0, 360)), FLOOR)
        if _is_free(plan, placed, things, 0.01):
            return placed
    raise DataError(
        f"There is no place left for a {model.kind} in a room of {plan.width:.1f} by {plan.depth:.1f} m;"
        " use fewer things or a larger room."
    )
