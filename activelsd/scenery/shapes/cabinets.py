"""Cabinets: furniture with the same plain body, whose class can be seen only from the front.

Bookshelf, wardrobe, dresser, night stand and TV stand have body, feet and top from the same distributions, so
only views of the front show which one it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.solids import box, cylinder, join, shift, slab, turn

FRONT = 0.022
"""Distance by which doors and drawers stand out from the body."""

GAP = 0.03
"""Gap between neighbouring doors or drawers."""


class Case(NamedTuple):
    """The body's outer box, front towards -y, and the parts that every category has."""

    width: float
    depth: float
    bottom: float
    top: float
    parts: list[Mesh]

    @property
    def front(self) -> float:
        """The y of the body's front."""
        return -self.depth / 2

    @property
    def inner(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the front inside a margin of one board's thickness."""
        board = 0.035
        return -self.width / 2 + board, self.width / 2 - board, self.bottom + board, self.top - board


def case(rng: np.random.Generator, low: float, high: float, *, deep: float = 1.0) -> Case:
    """Draws a body whose longer side, width or height, is 1.

    Args:
        rng: random generator.
        low: smallest ratio of width to height.
        high: largest ratio of width to height.
        deep: factor on the depth.
    """
    ratio = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    width, height = (1.0, 1.0 / ratio) if ratio > 1 else (ratio, 1.0)
    depth = deep * (float(rng.uniform(0.28, 0.5)) * (width * height) ** 0.5 + 0.08)
    parts: list[Mesh] = []
    bottom = 0.0
    foot = rng.integers(3)
    if foot == 0:
        bottom = float(rng.uniform(0.03, 0.07))
        parts.append(slab(width - 0.06, depth - 0.06, bottom))
    elif foot == 1:
        bottom = float(rng.uniform(0.05, 0.12))
        side = float(rng.uniform(0.04, 0.07))
        parts += feet(width, depth, bottom, side)
    if rng.random() < 0.5:
        lip = float(rng.uniform(0.015, 0.04))
        parts.append(slab(width + 2 * lip, depth + 2 * lip, 0.03, at=(0, 0, height)))
    return Case(width, depth, bottom, height, parts)


def feet(width: float, depth: float, height: float, side: float) -> list[Mesh]:
    """Four square feet at the corners."""
    x, y = width / 2 - side / 2 - 0.01, depth / 2 - side / 2 - 0.01
    return [slab(side, side, height, at=(sx * x, sy * y, 0.0)) for sx in (-1, 1) for sy in (-1, 1)]


def closed(shell: Case) -> Mesh:
    """The body as one solid block."""
    return slab(shell.width, shell.depth, shell.top - shell.bottom, at=(0, 0, shell.bottom))


def opened(shell: Case) -> list[Mesh]:
    """The body as boards, open at the front: two sides, bottom, top and back."""
    w, d, z0, z1, t = shell.width / 2, shell.depth / 2, shell.bottom, shell.top, 0.035
    return [
        box((-w, -d, z0), (-w + t, d, z1)),
        box((w - t, -d, z0), (w, d, z1)),
        box((-w, -d, z0), (w, d, z0 + t)),
        box((-w, -d, z1 - t), (w, d, z1)),
        box((-w, d - 0.02, z0), (w, d, z1)),
    ]


def knob(x: float, y: float, z: float, radius: float) -> Mesh:
    """A round knob on the front."""
    return shift(turn(cylinder(radius, 0.0, radius * 1.8, segments=8), 90, axis="x"), (x, y, z))


def pull(x: float, y: float, z: float, length: float, *, upright: bool = False) -> Mesh:
    """A bar handle on the front."""
    half, thick = length / 2, 0.014
    dx, dz = (thick, half) if upright else (half, thick)
    return box((x - dx, y - 0.045, z - dz), (x + dx, y, z + dz))


def drawers(
    pulled_by: int, front: float, area: tuple[float, float, float, float], rows: int, columns: int
) -> list[Mesh]:
    """A grid of drawers over an area (left, right, bottom, top) of the front.

    Args:
        pulled_by: handles of each drawer: a bar (0), a knob (1) or two knobs (2).
        front: y of the body's front.
        area: part of the front that the drawers fill.
        rows: number of rows.
        columns: number of columns.
    """
    x0, x1, z0, z1 = area
    parts: list[Mesh] = []
    width, height = (x1 - x0) / columns, (z1 - z0) / rows
    for row in range(rows):
        for column in range(columns):
            left, low = x0 + column * width, z0 + row * height
            parts.append(
                box(
                    (left + GAP / 2, front - FRONT, low + GAP / 2),
                    (left + width - GAP / 2, front, low + height - GAP / 2),
                )
            )
            x, z, y = left + width / 2, low + height / 2, front - FRONT
            if pulled_by == 0:
                parts.append(pull(x, y, z, min(0.45 * width, 0.3)))
            elif pulled_by == 1:
                parts.append(knob(x, y, z, 0.022))
            else:
                parts += [knob(x + side * 0.25 * width, y, z, 0.02) for side in (-1, 1)]
    return parts


def grip(rng: np.random.Generator) -> int:
    """Draws the kind of handle for all drawers of a piece of furniture, see `drawers`."""
    return int(rng.integers(3))


def doors(
    rng: np.random.Generator, front: float, area: tuple[float, float, float, float], count: int
) -> list[Mesh]:
    """Doors side by side; handles of a pair are adjacent, and some sets have raised panels."""
    x0, x1, z0, z1 = area
    width, parts = (x1 - x0) / count, []
    panelled, long = rng.random() < 0.5, float(rng.uniform(0.15, 0.3))
    for i in range(count):
        left, right = x0 + i * width + GAP / 2, x0 + (i + 1) * width - GAP / 2
        low, high, y = z0 + GAP / 2, z1 - GAP / 2, front - FRONT
        parts.append(box((left, y, low), (right, front, high)))
        if panelled:
            inset = 0.18 * width
            parts.append(box((left + inset, y - 0.02, low + inset), (right - inset, y, high - inset)))
            y -= 0.02
        x = right - 0.09 * width if i % 2 == 0 else left + 0.09 * width
        parts.append(pull(x, y, (low + high) / 2, long * (high - low), upright=True))
    return parts


def books(rng: np.random.Generator, shell: Case, low: float, high: float, x0: float, x1: float) -> list[Mesh]:
    """A row of books on a shelf, from its left end over 20 to 90 % of its length."""
    parts: list[Mesh] = []
    x, end = x0, x0 + (x1 - x0) * float(rng.uniform(0.2, 0.9))
    back = shell.depth / 2 - 0.02
    while x < end:
        thick = float(rng.uniform(0.025, 0.06))
        tall = (high - low) * float(rng.uniform(0.55, 0.9))
        deep = (shell.depth - 0.04) * float(rng.uniform(0.55, 0.85))
        parts.append(box((x, back - deep, low), (min(x + thick, x1) - 0.006, back, low + tall)))
        x += thick
    return parts


def bookshelf(rng: np.random.Generator) -> Mesh:
    """Open shelves with books on some."""
    shell = case(rng, 0.42, 1.35, deep=0.93)
    parts = shell.parts + opened(shell)
    x0, x1, z0, z1 = shell.inner
    rows = int(rng.integers(3, 6)) if shell.top > 0.9 else int(rng.integers(2, 4))
    step = (z1 - z0) / rows
    halves = shell.width > 0.75 and rng.random() < 0.5
    if halves:
        parts.append(box((-0.015, shell.front, z0), (0.015, -shell.front, z1)))
    for row in range(rows):
        low = z0 + row * step
        if row:
            parts.append(box((x0, shell.front, low - 0.03), (x1, -shell.front, low)))
        for a, b in ((x0, -0.015), (0.015, x1)) if halves else ((x0, x1),):
            if rng.random() < 0.6:
                parts += books(rng, shell, low, low + step - 0.03, a, b)
    return join(parts)


def wardrobe(rng: np.random.Generator) -> Mesh:
    """Full-height doors, sometimes over a row of drawers."""
    shell = case(rng, 0.45, 1.2, deep=1.06)
    x0, x1, z0, z1 = shell.inner
    parts = [*shell.parts, closed(shell)]
    if rng.random() < 0.4:
        split = z0 + 0.22 * (z1 - z0)
        parts += drawers(grip(rng), shell.front, (x0, x1, z0, split), 1, int(rng.integers(1, 3)))
        z0 = split
    count = 2 if shell.width < 0.7 else int(rng.integers(2, 5))
    return join(parts + doors(rng, shell.front, (x0, x1, z0, z1), count))


def dresser(rng: np.random.Generator) -> Mesh:
    """Drawers over the whole front, in three to five rows."""
    shell = case(rng, 0.7, 1.8)
    rows = int(rng.integers(3, 6)) if shell.top > 0.75 else 3
    columns = 1 if shell.width < 0.8 else int(rng.integers(1, 4))
    return join([*shell.parts, closed(shell), *drawers(grip(rng), shell.front, shell.inner, rows, columns)])


def night_stand(rng: np.random.Generator) -> Mesh:
    """One drawer above an open compartment."""
    shell = case(rng, 0.62, 1.2, deep=1.08)
    x0, x1, z0, z1 = shell.inner
    split = z1 - (z1 - z0) * float(rng.uniform(0.28, 0.42))
    block = box((x0, shell.front, split - 0.03), (x1, -shell.front, z1))
    parts = [*shell.parts, *opened(shell), block]
    parts += drawers(grip(rng), shell.front, (x0, x1, split, z1), 1, 1)
    if rng.random() < 0.35:
        middle = (z0 + split) / 2
        parts.append(box((x0, shell.front + 0.05, middle - 0.015), (x1, -shell.front, middle + 0.015)))
    return join(parts)


def tv_stand(rng: np.random.Generator) -> Mesh:
    """A low and wide stand with doors or drawers at both ends and open shelves between them."""
    shell = case(rng, 1.3, 2.4)
    x0, x1, z0, z1 = shell.inner
    third = (x1 - x0) * float(rng.uniform(0.25, 0.34))
    parts = shell.parts + opened(shell)
    for a, b in ((x0, x0 + third), (x1 - third, x1)):
        parts.append(box((a, shell.front, z0), (b, -shell.front, z1)))
        if rng.random() < 0.7:
            parts += doors(rng, shell.front, (a, b, z0, z1), 1)
        else:
            parts += drawers(grip(rng), shell.front, (a, b, z0, z1), 2, 1)
    middle = (z0 + z1) / 2
    parts.append(box((x0, shell.front, middle - 0.015), (x1, -shell.front, middle + 0.015)))
    if rng.random() < 0.6:  # a media player on the upper shelf
        wide, deep = (x1 - x0 - 2 * third) * 0.7, shell.depth * 0.7
        parts.append(slab(wide, deep, (z1 - z0) * 0.2, at=(0, 0, middle + 0.015)))
    return join(parts)
