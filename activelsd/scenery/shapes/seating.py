"""Sofas and benches: back and ends are the same; only the seat differs, and the back hides it from behind."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.solids import box, join, prism, slab


class Seat(NamedTuple):
    """Back and ends, with the front towards -y, and the space between them."""

    left: float
    right: float
    front: float
    back: float
    height: float  # of the seat
    parts: list[Mesh]


def frame(rng: np.random.Generator) -> Seat:
    """Draws the back and the two ends."""
    w = 1.0
    d = float(rng.uniform(0.36, 0.48))
    height = float(rng.uniform(0.19, 0.24))
    back = height + float(rng.uniform(0.24, 0.36))
    arm = height + float(rng.uniform(0.08, 0.18))
    thick = float(rng.uniform(0.04, 0.11))
    behind = float(rng.uniform(0.04, 0.1))
    foot = float(rng.choice((0.0, 0.04)))
    lean = float(rng.uniform(0.0, 0.05))
    spine = ((d / 2 - behind, foot), (d / 2, foot), (d / 2 + lean, back), (d / 2 + lean - behind, back))
    parts = [prism(spine, -w / 2, w / 2)]
    for sign in (-1, 1):
        x = sign * (w / 2 - thick / 2)
        parts.append(slab(thick, d - behind / 2, arm - foot, at=(x, -behind / 4, foot)))
        if foot:
            parts += [
                slab(0.05, 0.05, foot, at=(sign * (w / 2 - 0.04), s * (d / 2 - 0.04), 0)) for s in (-1, 1)
            ]
    return Seat(-w / 2 + thick, w / 2 - thick, -d / 2, d / 2 - behind, height, parts)


def sofa(rng: np.random.Generator) -> Mesh:
    """A sofa with a base down to the floor, seat cushions and back cushions."""
    seat = frame(rng)
    x0, x1, front, back, height, parts = seat
    base = height * float(rng.uniform(0.5, 0.65))
    parts.append(box((x0, front + 0.01, 0.03), (x1, back, base)))
    count = int(rng.integers(2, 4))
    wide = (x1 - x0) / count
    soft = float(rng.uniform(0.07, 0.11))
    for i in range(count):
        a, b = x0 + i * wide + 0.008, x0 + (i + 1) * wide - 0.008
        z = height
        cushion = (
            (front - 0.02, base), (back, base), (back, z),
            (front + 0.02, z), (front - 0.01, z - 0.02), (front - 0.02, z - 0.04),
        )  # fmt: skip
        parts.append(prism(cushion, a, b))
        top = z + 0.19
        pillow = (
            (back - soft, z),
            (back, z),
            (back, top),
            (back - 0.5 * soft, top),
            (back - soft, top - 0.04),
        )
        parts.append(prism(pillow, a, b))
    return join(parts)


def bench(rng: np.random.Generator) -> Mesh:
    """A bench with a thin seat of planks and open space below."""
    seat = frame(rng)
    x0, x1, front, back, height, parts = seat
    planks = int(rng.integers(1, 5))
    step = (back - front) / planks
    for i in range(planks):
        y = front + i * step
        parts.append(box((x0, y, height - 0.035), (x1, y + step - 0.018 * (planks > 1), height)))
    if rng.random() < 0.5:
        parts.append(box((x0, -0.02, 0.05), (x1, 0.01, 0.1)))
    if rng.random() < 0.5:  # ribs on the backrest
        ribs = int(rng.integers(4, 8))
        for i in range(ribs):
            x = x0 + (i + 0.5) * (x1 - x0) / ribs
            parts.append(slab(0.03, 0.02, 0.17, at=(x, back - 0.005, height + 0.03)))
    return join(parts)
