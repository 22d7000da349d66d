"""The empty room: floor, walls with a door and windows, and optionally a ceiling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms.footprints import Rect
from activelsd.scenery.rooms.models import Model, Part
from activelsd.scenery.rooms.textures import Colour, Material, darker
from activelsd.scenery.shapes.solids import box, join, shift, turn

THICK = 0.12
"""Thickness of a wall in metres."""

WALLS = ("south", "east", "north", "west")
"""South is y = 0 and north y = depth; west is x = 0 and east x = width."""

YAWS = {"south": 180.0, "east": 270.0, "north": 0.0, "west": 90.0}
"""Yaw in degrees of a model whose back is to the wall."""

DOOR_ZONE = 0.8
"""Depth in metres of the floor in front of a door that is kept free."""

_WALL_PAINTS: tuple[Colour, ...] = (
    (222, 218, 206), (196, 206, 212), (214, 198, 170), (184, 198, 176), (206, 182, 176), (232, 230, 226),
)  # fmt: skip
_FLOORS: tuple[Material, ...] = (
    Material((176, 134, 88), (150, 110, 68), "stripes", 0.24, 0),
    Material((120, 84, 58), (104, 70, 46), "stripes", 0.3, 1),
    Material((206, 202, 194), (168, 166, 160), "checks", 0.8),
    Material((132, 126, 118)),
    Material((190, 160, 124), (172, 142, 106), "stripes", 0.2, 1),
)


class Opening(NamedTuple):
    """A door or window in a wall."""

    kind: str  # door or window
    wall: str  # of WALLS
    left: float  # metres from the wall's left end to the opening, seen from inside
    width: float
    low: float
    high: float


class FloorPlan(NamedTuple):
    """The walls of a room, without its contents; the floor is at z = 0, a corner at the origin."""

    width: float  # along x, metres
    depth: float  # along y
    height: float
    ceiling: bool
    openings: tuple[Opening, ...]

    def length(self, wall: str) -> float:
        """Length of a wall in metres."""
        return self.width if wall in ("south", "north") else self.depth

    def along(self, wall: str, left: float, out: float) -> tuple[float, float]:
        """The floor point `left` metres along a wall from its left end and `out` metres in front of it."""
        return {
            "south": (self.width - left, out),
            "east": (self.width - out, self.depth - left),
            "north": (left, self.depth - out),
            "west": (out, left),
        }[wall]

    def before(self, opening: Opening, out: float) -> Rect:
        """The floor area in front of an opening, `out` metres deep."""
        x, y = self.along(opening.wall, opening.left + opening.width / 2, out / 2)
        return Rect(x, y, opening.width / 2, out / 2, YAWS[opening.wall])


def draw_plan(rng: np.random.Generator, width: float, depth: float, *, ceiling: bool) -> FloorPlan:
    """A random floor plan of that size, with a door in one wall and windows in one or two others."""
    plan = FloorPlan(width, depth, float(rng.uniform(2.4, 2.7)), ceiling, ())
    walls = [WALLS[i] for i in rng.permutation(4)[: int(rng.integers(2, 4))]]
    openings = []
    for i, wall in enumerate(walls):
        length = plan.length(wall)
        if i == 0:
            wide, low, high = 0.85, 0.0, 2.05
        else:
            wide, low, high = float(rng.uniform(0.9, 1.5)), 0.95, 2.05
        left = float(rng.uniform(0.2, length - wide - 0.2))
        openings.append(Opening("window" if i else "door", wall, left, wide, low, high))
    return plan._replace(openings=tuple(openings))


def draw_shell(rng: np.random.Generator, plan: FloorPlan) -> Model:
    """Floor, walls and ceiling as one model in room coordinates, with random materials."""
    paint = _WALL_PAINTS[rng.integers(len(_WALL_PAINTS))]
    style = ("plain", "plain", "stripes")[rng.integers(3)]
    wall_paint = Material(paint, darker(paint, 0.07), style, float(rng.uniform(0.2, 0.5)), 0)
    other = wall_paint._replace(axis=1)
    trim = Material(((240, 240, 236), (96, 66, 46), (70, 72, 78))[rng.integers(3)])
    leaf = Material(((150, 104, 62), (232, 228, 218), (90, 110, 104))[rng.integers(3)])
    floor = _FLOORS[rng.integers(len(_FLOORS))]
    w, d, h = plan.width, plan.depth, plan.height
    parts: list[Part] = [(box((-THICK, -THICK, -0.1), (w + THICK, d + THICK, 0.0)), floor)]
    for wall in WALLS:
        striped = wall_paint if wall in ("south", "north") else other
        opening = next((o for o in plan.openings if o.wall == wall), None)
        parts += [
            (_to_room(plan, wall, mesh), m) for mesh, m in _wall(plan, wall, opening, striped, trim, leaf)
        ]
    if plan.ceiling:
        parts.append((box((-THICK, -THICK, h), (w + THICK, d + THICK, h + 0.1)), Material((238, 236, 230))))
    materials = tuple(dict.fromkeys(material for _, material in parts))
    numbers = [np.full(len(mesh.faces), materials.index(material), np.int32) for mesh, material in parts]
    return Model("room", 0, join(mesh for mesh, _ in parts), np.concatenate(numbers), materials)


def _wall(
    plan: FloorPlan, wall: str, opening: Opening | None, paint: Material, trim: Material, leaf: Material
) -> list[Part]:
    """A wall along +x from x = 0, with its inner side at y = 0 facing -y."""
    length, high, skirting = plan.length(wall), plan.height, 0.08
    if opening is None:
        return [
            (box((-THICK, 0, 0), (length + THICK, THICK, high)), paint),
            (box((0, -0.012, 0), (length, 0, skirting)), trim),
        ]
    a, b = opening.left, opening.left + opening.width
    low, top, frame, lap = opening.low, opening.high, 0.05, 0.006
    parts: list[Part] = [
        (box((-THICK, 0, 0), (a, THICK, high)), paint),
        (box((b, 0, 0), (length + THICK, THICK, high)), paint),
        (box((a, 0, top), (b, THICK, high)), paint),
        (box((a - frame, -0.015, top - lap), (b + frame, 0.02, top + frame)), trim),
        (box((a - frame, -0.015, low), (a + lap, 0.02, top)), trim),
        (box((b - lap, -0.015, low), (b + frame, 0.02, top)), trim),
        (box((0, -0.012, 0), (a - frame, 0, skirting)), trim),
        (box((b + frame, -0.012, 0), (length, 0, skirting)), trim),
    ]
    if opening.kind == "door":
        parts.append((box((a, 0.05, 0), (b, 0.09, top)), leaf))
        inset = [(a + 0.12, 0.15, b - 0.12, 0.9), (a + 0.12, 1.05, b - 0.12, top - 0.15)]
        parts += [(box((x0, 0.04, z0), (x1, 0.06, z1)), leaf) for x0, z0, x1, z1 in inset]
        parts.append((box((b - 0.1, 0.0, 1.0), (b - 0.04, 0.05, 1.03)), Material((190, 180, 150))))
        return parts
    middle = (a + b) / 2
    return [
        *parts,
        (box((a, 0, 0), (b, THICK, low)), paint),
        (box((a, -0.012, 0), (b, 0, skirting)), trim),
        (box((a - frame, -0.08, low - 0.03), (b + frame, 0.02, low + lap)), trim),
        (box((middle - 0.02, 0.04, low), (middle + 0.02, 0.08, top)), trim),
    ]


def _to_room(plan: FloorPlan, wall: str, mesh: Mesh) -> Mesh:
    """Moves a part of a wall to the wall's place in the room."""
    x, y = plan.along(wall, 0.0, 0.0)
    return shift(turn(mesh, YAWS[wall]), (x, y, 0.0))
