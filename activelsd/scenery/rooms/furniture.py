"""Furniture that is not among the embedded shapes: beds, chairs, armchairs, coffee tables, floor lamps.

Units are metres; as for the embedded shapes, the centre is at the origin and the front faces -y.
"""

from __future__ import annotations

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.solids import box, cylinder, join, lathe, slab, turn


def bed(rng: np.random.Generator) -> Mesh:
    """A mattress on a frame, with the head end at the back."""
    w, d, low = (float(rng.uniform(*x)) for x in ((0.95, 1.5), (1.9, 2.05), (0.22, 0.3)))
    high = low + float(rng.uniform(0.16, 0.22))
    parts = [
        box((-w / 2, -d / 2, 0.08), (w / 2, d / 2, low)),
        box((-w / 2 + 0.02, -d / 2 + 0.02, low), (w / 2 - 0.02, d / 2 - 0.06, high)),
        box((-w / 2, d / 2 - 0.04, 0.0), (w / 2, d / 2 + 0.01, high + float(rng.uniform(0.25, 0.45)))),
        box((-w / 2, -d / 2 - 0.01, 0.0), (w / 2, -d / 2 + 0.03, low + 0.05)),
    ]
    pillows = 1 if w < 1.2 else 2
    wide = (w - 0.1) / pillows
    for i in range(pillows):
        x = -w / 2 + 0.05 + (i + 0.5) * wide
        parts.append(slab(0.85 * wide, 0.36, 0.09, at=(x, d / 2 - 0.28, high)))
    return join(parts)


def chair(rng: np.random.Generator) -> Mesh:
    """A chair with four legs, a seat and an open back."""
    w, seat = float(rng.uniform(0.4, 0.46)), float(rng.uniform(0.43, 0.47))
    top, leg = float(rng.uniform(0.8, 0.98)), 0.035
    x = w / 2 - leg / 2
    parts = [slab(w, w, 0.035, at=(0.0, 0.0, seat - 0.035))]
    parts += [slab(leg, leg, seat - 0.035, at=(s * x, -x, 0.0)) for s in (-1, 1)]
    parts += [slab(leg, leg, top, at=(s * x, x, 0.0)) for s in (-1, 1)]
    if rng.random() < 0.5:
        parts.append(box((-w / 2, x - 0.012, seat + 0.15), (w / 2, x + 0.012, top)))
    else:
        parts.append(box((-w / 2, x - 0.012, top - 0.08), (w / 2, x + 0.012, top)))
        parts += [slab(0.02, 0.02, top - seat - 0.08, at=(i * w / 5, x, seat)) for i in (-1, 0, 1)]
    return join(parts)


def armchair(rng: np.random.Generator) -> Mesh:
    """A seat between two thick arms, with a leaning back."""
    w, d, seat = (float(rng.uniform(*x)) for x in ((0.75, 0.9), (0.75, 0.85), (0.38, 0.44)))
    arm, top = float(rng.uniform(0.12, 0.17)), float(rng.uniform(0.8, 0.95))
    back = box((-w / 2 + arm, d / 2 - 0.2, seat - 0.1), (w / 2 - arm, d / 2 - 0.05, top))
    parts = [
        box((-w / 2 + arm, -d / 2 + 0.02, 0.08), (w / 2 - arm, d / 2 - 0.1, seat)),
        turn(back, -6.0, axis="x", about=(0.0, d / 2 - 0.1, seat)),
    ]
    high = seat + float(rng.uniform(0.16, 0.22))
    parts += [box((x, -d / 2, 0.05), (x + arm, d / 2, high)) for x in (-w / 2, w / 2 - arm)]
    parts += [
        slab(0.05, 0.05, 0.08, at=(a * (w / 2 - 0.05), b * (d / 2 - 0.05), 0.0))
        for a in (-1, 1)
        for b in (-1, 1)
    ]
    return join(parts)


def coffee_table(rng: np.random.Generator) -> Mesh:
    """A low table, round or rectangular, sometimes with a shelf below."""
    w, high = float(rng.uniform(0.7, 1.0)), float(rng.uniform(0.38, 0.46))
    d = w if rng.random() < 0.4 else 0.6 * w
    if d == w:
        foot = [cylinder(0.28 * w, 0.0, 0.03, segments=24), cylinder(0.05, 0.03, high - 0.03)]
        return join([cylinder(w / 2, high - 0.03, high, segments=32), *foot])
    parts = [slab(w, d, 0.035, at=(0.0, 0.0, high - 0.035))]
    legs = [(a * (w / 2 - 0.03), b * (d / 2 - 0.03), 0.0) for a in (-1, 1) for b in (-1, 1)]
    parts += [slab(0.05, 0.05, high - 0.035, at=at) for at in legs]
    if rng.random() < 0.6:
        parts.append(slab(w - 0.06, d - 0.06, 0.02, at=(0.0, 0.0, 0.1)))
    return join(parts)


def floor_lamp(rng: np.random.Generator) -> Mesh:
    """A lamp shade on a pole."""
    high, wide = float(rng.uniform(1.4, 1.7)), float(rng.uniform(0.17, 0.24))
    shade = lathe(((wide, high - 0.28), (0.65 * wide, high), (0.0, high)))
    return join([cylinder(0.16, 0.0, 0.025, segments=24), cylinder(0.014, 0.025, high - 0.02), shade])
