"""Tables and desks: top, legs and boards are the same; only a desk has drawers, at the front."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.cabinets import drawers, grip
from activelsd.scenery.shapes.solids import box, cylinder, join, shift, slab


class Stand(NamedTuple):
    """Top, supports and back board, with the front towards -y."""

    width: float
    depth: float
    under: float  # height of the underside of the top
    parts: list[Mesh]


def table(rng: np.random.Generator) -> Mesh:
    """A table: only the stand."""
    return join(stand(rng).parts)


def desk(rng: np.random.Generator) -> Mesh:
    """A desk: the stand with a column of drawers at one or both ends, or a row of drawers under the top."""
    whole = stand(rng)
    w, d, under, parts = whole
    front, style = -d / 2 + 0.02, rng.integers(3)
    if style == 0:
        low = under * float(rng.uniform(0.72, 0.8))
        area = (-w / 2 + 0.06, w / 2 - 0.06, low, under)
        parts.append(box((area[0], front, low), (area[1], d / 2 - 0.03, under)))
        parts += drawers(grip(rng), front, area, 1, int(rng.integers(2, 4)))
    else:
        wide = w * float(rng.uniform(0.24, 0.32))
        low = under * float(rng.uniform(0.08, 0.4))
        sides = (-1, 1) if style == 1 else ((-1,) if rng.random() < 0.5 else (1,))
        rows, pulled_by = int(rng.integers(2, 4)), grip(rng)
        for sign in sides:
            x0, x1 = sorted((sign * (w / 2 - 0.06), sign * (w / 2 - 0.06 - wide)))
            parts.append(box((x0, front, low), (x1, d / 2 - 0.03, under)))
            parts += drawers(pulled_by, front, (x0, x1, low, under), rows, 1)
    return join(parts)


def stand(rng: np.random.Generator) -> Stand:
    """Draws a top on legs or end boards, with a board along the back."""
    w = 1.0
    d = float(rng.uniform(0.45, 0.7))
    under = float(rng.uniform(0.45, 0.65))
    parts = [slab(w, d, float(rng.uniform(0.03, 0.06)), at=(0, 0, under))]
    inset = float(rng.uniform(0.02, 0.05))
    x, y = w / 2 - inset, d / 2 - inset
    style = rng.integers(3)
    if style == 0:  # end boards
        parts += [slab(0.035, 2 * y, under, at=(sign * (x - 0.018), 0, 0)) for sign in (-1, 1)]
    elif style == 1:
        side = float(rng.uniform(0.04, 0.07))
        parts += [slab(side, side, under, at=(a * x, b * y, 0)) for a in (-1, 1) for b in (-1, 1)]
    else:
        radius = float(rng.uniform(0.025, 0.035))
        leg = cylinder(radius, 0.0, under, segments=8, top=radius * 1.3)
        parts += [shift(leg, (a * x, b * y, 0)) for a in (-1, 1) for b in (-1, 1)]
    low = under * float(rng.uniform(0.05, 0.35))
    parts.append(box((-x, y - 0.02, low), (x, y, under)))
    if style != 0 and rng.random() < 0.7:  # boards between the legs at the ends
        for sign in (-1, 1):
            parts.append(box((sign * x - 0.01, -y, low), (sign * x + 0.01, y, under)))
    return Stand(w, d, under, parts)
