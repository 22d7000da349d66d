"""Household objects that look round from every side: fruit, candles, pots and others.

Only their tops and insides show what they are. Similar classes have bodies from the same distribution, and so
have the look-alikes that are no class in any world: a ball, an empty planter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms.casings import BODIES, DARK, LIGHT, STEEL
from activelsd.scenery.rooms.models import Part
from activelsd.scenery.rooms.textures import Colour, Material, darker
from activelsd.scenery.shapes.solids import arc, box, cylinder, join, lathe, shift, slab, tube, turn

_FRUIT: tuple[Colour, ...] = ((178, 40, 40), (120, 160, 60), (206, 170, 70), (160, 60, 70))
_LEAVES: tuple[Colour, ...] = ((58, 110, 56), (88, 140, 70), (44, 84, 60), (120, 140, 80))
_WAX: tuple[Colour, ...] = ((236, 228, 206), (190, 70, 66), (120, 150, 160), (222, 190, 110), (110, 130, 96))
_SOIL = Material((70.0, 52.0, 40.0))
_WALL = 0.008  # metres
_ON_TABLE, _ON_FLOOR = (0.065, 0.09), (0.13, 0.17)  # least and most radius of pots, roughly, in metres


def _body(rng: np.random.Generator) -> Material:
    return Material(BODIES[rng.integers(len(BODIES))])


def _vessel(outer: list[tuple[float, float]], filled: float) -> Mesh:
    """An open vessel with outer wall points (radius, height) from the foot up, hollow above `filled`."""
    inner = [(r - _WALL, z) for r, z in reversed(outer) if z > filled]
    radii, heights = zip(*outer, strict=True)
    r = float(np.interp(filled, heights, radii)) - _WALL
    return lathe([(0.0, 0.0), *outer, *inner, (r, filled), (0.0, filled)])


def apple(rng: np.random.Generator) -> list[Part]:
    """An apple with a hollow around the stem, narrower below, sometimes with a leaf."""
    r = float(rng.uniform(0.04, 0.05))
    angles = np.radians(np.linspace(-80.0, 80.0, 13))
    radii = r * np.cos(angles) ** 0.8 * (1.0 + 0.12 * np.sin(angles))
    heights = r * (0.95 * np.sin(angles) + 1.0)
    top = float(heights[-1])
    profile = [(0.0, 0.25 * r), *zip(radii.tolist(), heights.tolist(), strict=True), (0.0, top - 0.45 * r)]
    skin = Material(_FRUIT[rng.integers(len(_FRUIT))])
    stem = tube(((0.0, 0.0, top - 0.45 * r), (0.0, 0.0, top), (0.012, 0.0, top + 0.4 * r)), 0.004)
    parts = [(lathe(profile), skin), (stem, DARK), (cylinder(0.3 * r, top - 0.25 * r, top - 0.2 * r), DARK)]
    if rng.random() < 0.6:
        leaf = turn(_leaf(0.045, 0.022, 0.2), float(rng.uniform(0, 360)))
        parts.append((shift(leaf, (0.0, 0.0, top)), Material(_LEAVES[0])))
    tilt = float(rng.uniform(-15, 15))
    return [(turn(mesh, tilt, axis="x"), paint) for mesh, paint in parts]


def ball(rng: np.random.Generator) -> list[Part]:
    """A ball of one colour, or with a band around it."""
    r = float(rng.uniform(0.04, 0.05))
    x, z = r * arc(-90, 90, 13).T
    ring = list(zip(x.tolist(), (r + z).tolist(), strict=True))
    skin = Material(_FRUIT[rng.integers(len(_FRUIT))])
    parts = [(lathe(ring), skin)]
    if rng.random() < 0.5:
        parts.append((cylinder(1.01 * r, 0.85 * r, 1.15 * r, segments=24), LIGHT))
    tilt = float(rng.uniform(-60, 60))
    return [(turn(mesh, tilt, axis="x"), paint) for mesh, paint in parts]


def dish(rng: np.random.Generator) -> list[Part]:
    """A deep or shallow bowl on a narrow foot."""
    r = float(rng.uniform(0.075, 0.11))
    h = r * float(rng.uniform(0.6, 1.0))
    bulge = float(rng.uniform(0.4, 0.8))
    shares = np.linspace(0.0, 1.0, 8)
    radii = r * (0.45 + 0.55 * shares**bulge)
    outer = [
        (0.42 * r, 0.0),
        *((float(x), float(0.08 * h + 0.92 * h * s)) for x, s in zip(radii, shares, strict=True)),
    ]
    body = _body(rng)
    inside = LIGHT if rng.random() < 0.3 else body
    wall, within = lathe([(0.0, 0.0), *outer]), [(x - _WALL, z + 0.003) for x, z in reversed(outer[1:])]
    return [(wall, body), (lathe([(outer[-1][0], h), *within, (0.0, within[-1][1])], 24), inside)]


def candle(rng: np.random.Generator) -> list[Part]:
    """A candle: a pillar alone, on a dish, or wax in a glass."""
    r, h = float(rng.uniform(0.034, 0.046)), float(rng.uniform(0.1, 0.2))
    wax = Material(_WAX[rng.integers(len(_WAX))])
    style = rng.integers(3)
    parts: list[Part] = []
    if style == 2:
        top = 0.7 * h
        outer = [(r, 0.0), (r, h)]
        parts += [(_vessel(outer, top), _body(rng)), (cylinder(r - _WALL, top - 0.01, top), wax)]
    else:
        foot, top = (0.012, h) if style == 1 else (0.0, h)
        pillar = ((0.0, foot), (r, foot), (r, top), (0.8 * r, top - 0.004), (0.0, top - 0.012))
        parts.append((lathe(pillar), wax))
        if style == 1:
            low = [
                (0.0, 0.0),
                (1.4 * r, 0.0),
                (1.9 * r, 0.022),
                (1.8 * r, 0.024),
                (1.3 * r, foot),
                (0.0, foot),
            ]
            parts.append((lathe(low), STEEL))
    wick = tube(((0.0, 0.0, top - 0.012), (0.0, 0.0, top + 0.015), (0.006, 0.0, top + 0.03)), 0.004)
    return [*parts, (wick, DARK)]


def soap_bottle(rng: np.random.Generator) -> list[Part]:
    """A round or square bottle with a pump whose spout points forward."""
    r, h = float(rng.uniform(0.034, 0.046)), float(rng.uniform(0.1, 0.16))
    body = _body(rng)
    parts: list[Part] = []
    if rng.random() < 0.6:
        wall = ((0.0, 0.0), (r, 0.0), (r, 0.85 * h), (0.8 * r, 0.95 * h), (0.4 * r, h), (0.0, h))
        parts.append((lathe(wall), body))
        if rng.random() < 0.6:
            parts.append((lathe(((r + 0.001, 0.25 * h), (r + 0.001, 0.65 * h))), LIGHT))
    else:
        parts.append((join([slab(2 * r, 1.5 * r, 0.92 * h), cylinder(0.45 * r, 0.92 * h, h)]), body))
    pump = LIGHT if rng.random() < 0.5 else DARK
    parts += [
        (cylinder(0.45 * r, h, h + 0.015), pump),
        (cylinder(0.006, h, h + 0.045), STEEL),
        (cylinder(0.014, h + 0.04, h + 0.055), pump),
        (box((-0.007, -0.06, h + 0.042), (0.007, 0.0, h + 0.053)), pump),
        (box((-0.006, -0.06, h + 0.03), (0.006, -0.05, h + 0.045)), pump),
    ]
    return parts


def _pot(rng: np.random.Generator, scale: float) -> tuple[list[tuple[float, float]], Material]:
    """The outer wall and material of a pot or garbage can."""
    r = scale * float(rng.uniform(0.85, 1.1))
    h = scale * float(rng.uniform(1.3, 2.2))
    foot, belly = float(rng.uniform(0.65, 0.95)), float(rng.uniform(-0.03, 0.12))
    heights = np.linspace(0.0, 1.0, 6)
    radii = r * (foot + (1 - foot) * heights + belly * np.sin(np.pi * heights))
    outer = [(float(x), float(z) * h) for x, z in zip(radii, heights, strict=True)]
    if rng.random() < 0.4:
        outer = [*outer[:-1], (outer[-1][0], 0.86 * h), (1.08 * r, 0.86 * h), (1.08 * r, h)]
    return outer, _body(rng)


def _leaf(length: float, width: float, rise: float) -> Mesh:
    """A leaf from the origin along x, folded along its middle; it rises by `rise` x length, then droops."""
    shares = np.array([0.0, 0.35, 0.7, 1.0])
    x, z = length * shares, length * rise * np.sin(shares * 2.4)
    half = width / 2 * np.array([0.15, 1.0, 0.8, 0.0])
    middle = np.column_stack([x, np.zeros(4), z])
    edges = [np.column_stack([x, s * half, z + 0.25 * half]) for s in (-1, 1)]
    vertices = np.concatenate([middle, *edges]).astype(np.float32)
    faces = [f for e in (4, 8) for i in range(3) for f in ((i, i + 1, e + i + 1), (i, e + i + 1, e + i))]
    return Mesh(vertices, np.array(faces, np.int32))


def _foliage(rng: np.random.Generator, reach: float, tall: float) -> list[Part]:
    """A plant that grows from the origin, with radius about `reach` and height about `tall`, in metres."""
    green = _LEAVES[rng.integers(len(_LEAVES))]
    shades = [Material(green), Material(darker(green, 0.25)), Material(darker(green, -0.2))]
    grow = (_rosette, _cactus, _bush)[rng.integers(3)]
    parts: list[Part] = [(mesh, shades[i % 3]) for i, mesh in enumerate(grow(rng, reach, tall))]
    if grow is _bush:
        stem = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.4 * tall), (0.0, 0.0, 0.8 * tall))
        parts.append((tube(stem, 0.05 * reach), Material((96, 74, 50))))
    return parts


def _rosette(rng: np.random.Generator, reach: float, tall: float) -> list[Mesh]:
    """Leaves that grow from the centre, as in an aloe or a lily."""
    leaves = []
    for i in range(int(rng.integers(9, 15))):
        steep = float(rng.uniform(15, 80))
        length = float(rng.uniform(0.75, 1.0)) * min(tall, reach / float(np.cos(np.radians(steep))))
        leaf = turn(_leaf(length, 0.3 * length, 0.12), -steep, axis="y")
        leaves.append(turn(leaf, 137.5 * i))
    return leaves


def _cactus(rng: np.random.Generator, reach: float, tall: float) -> list[Mesh]:
    """One to three ribbed columns."""
    columns = []
    for i in range(int(rng.integers(1, 4))):
        r, h = 0.3 * reach, tall * float(rng.uniform(0.6, 1.0))
        column = lathe([(r * 0.8, 0.0), (r, 0.3 * h), (r, 0.75 * h), (0.75 * r, 0.92 * h), (0.0, h)], 16)
        ribs = column.vertices.copy()
        ribs[::2, :2] *= 0.75
        away = 0.45 * reach * (i > 0)
        columns.append(turn(shift(Mesh(ribs, column.faces), (away, 0.0, 0.0)), 120.0 * i))
    return columns


def _bush(rng: np.random.Generator, reach: float, tall: float) -> list[Mesh]:
    """Leaves on the surface of an ellipsoid above a stem."""
    leaves = []
    for _ in range(int(rng.integers(26, 40))):
        at = rng.normal(size=3)
        at *= np.array([0.5 * reach, 0.5 * reach, 0.3 * tall]) / np.linalg.norm(at)
        out = float(np.degrees(np.arctan2(at[1], at[0])) + rng.uniform(-40, 40))
        leaf = turn(_leaf(0.5 * reach, 0.28 * reach, 0.2), float(rng.uniform(-60, 30)), axis="y")
        leaves.append(shift(turn(leaf, out), np.add(at, (0.0, 0.0, 0.66 * tall))))
    return leaves


def _potted(rng: np.random.Generator, scale: float, *, planted: bool) -> list[Part]:
    """A pot filled with soil, with a plant if `planted`."""
    outer, body = _pot(rng, scale)
    r, h = outer[-1]
    soil = h - 0.2 * scale
    parts: list[Part] = [(_vessel(outer, soil), body), (cylinder(r - _WALL, soil - 0.004, soil), _SOIL)]
    if planted:
        tall = scale * float(rng.choice((0.7, 1.4, 2.4)))
        grown = _foliage(rng, float(rng.uniform(1.0, 1.35)) * r, tall)
        parts += [(shift(mesh, (0.0, 0.0, soil)), paint) for mesh, paint in grown]
    return parts


def house_plant(rng: np.random.Generator) -> list[Part]:
    """A pot for a table with leaves, a cactus or a bush in it."""
    return _potted(rng, float(rng.uniform(*_ON_TABLE)), planted=True)


def tall_plant(rng: np.random.Generator) -> list[Part]:
    """A pot for the floor with leaves, a cactus or a bush in it."""
    return _potted(rng, float(rng.uniform(*_ON_FLOOR)), planted=True)


def planter(rng: np.random.Generator) -> list[Part]:
    """A pot for a table with only soil in it."""
    return _potted(rng, float(rng.uniform(*_ON_TABLE)), planted=False)


def tall_planter(rng: np.random.Generator) -> list[Part]:
    """A pot for the floor with only soil in it."""
    return _potted(rng, float(rng.uniform(*_ON_FLOOR)), planted=False)


def garbage_can(rng: np.random.Generator) -> list[Part]:
    """An open can, often with a bag over the rim, or a can with a lid, a flap and a pedal."""
    outer, body = _pot(rng, float(rng.uniform(*_ON_FLOOR)))
    r, h = outer[-1]
    if rng.random() < 0.65:
        parts: list[Part] = [(_vessel(outer, 0.3 * h), body)]
        if rng.random() < 0.7:
            bag = lathe(((r + 0.004, 0.82 * h), (r + 0.006, h), (r - 0.01, h + 0.004), (r - 0.012, 0.6 * h)))
            parts.append((bag, LIGHT if rng.random() < 0.6 else DARK))
        for _ in range(int(rng.integers(0, 4))):  # crumpled paper
            crumple = lathe(((0.0, 0.0), (0.04, 0.03), (0.03, 0.06), (0.0, 0.07)), 7)
            crumple = shift(crumple, (*rng.uniform(-0.3, 0.3, 2) * r, 0.3 * h))
            parts.append((crumple, LIGHT))
        return parts
    lid = lathe(((1.04 * r, h), (1.04 * r, h + 0.02), (0.8 * r, h + 0.05), (0.0, h + 0.06)))
    flap = slab(0.9 * r, 0.6 * r, 0.006, at=(0.0, -0.1 * r, h + 0.055))
    pedal = box((-0.05, -outer[0][0] - 0.05, 0.01), (0.05, 0.0, 0.025))
    return [(_vessel(outer, 0.03), body), (lid, DARK), (flap, STEEL), (pedal, STEEL)]


MAKERS: Mapping[str, Callable[[np.random.Generator], list[Part]]] = {
    "apple": apple,
    "ball": ball,
    "candle": candle,
    "dish": dish,
    "garbage_can": garbage_can,
    "house_plant": house_plant,
    "planter": planter,
    "soap_bottle": soap_bottle,
    "tall_plant": tall_plant,
    "tall_planter": tall_planter,
}
"""The function that makes the parts of each kind, with the front towards -y."""
