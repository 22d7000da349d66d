"""Monitors and laptops: a leaning panel over a flat base, which the panel hides from behind."""

from __future__ import annotations

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.solids import box, join, slab, turn


def panel(rng: np.random.Generator, bottom: float, bezel: float) -> tuple[float, Mesh]:
    """Width and mesh of a screen with bezel that leans back, its lower edge at height `bottom` and y = 0."""
    w, h = 1.0, float(rng.uniform(0.58, 0.72))
    t = float(rng.uniform(0.025, 0.05))
    parts = [
        box((-w / 2, 0.012, 0), (w / 2, t, h)),
        box((-w / 2, 0, 0), (w / 2, 0.012, bezel)),
        box((-w / 2, 0, h - bezel), (w / 2, 0.012, h)),
        box((-w / 2, 0, bezel), (-w / 2 + bezel, 0.012, h - bezel)),
        box((w / 2 - bezel, 0, bezel), (w / 2, 0.012, h - bezel)),
    ]
    if rng.random() < 0.5:  # a badge or vent on the lid
        wide = float(rng.uniform(0.1, 0.3))
        parts.append(slab(wide, 0.01, 0.1, at=(0, t + 0.004, h * float(rng.uniform(0.4, 0.6)))))
    lean = float(rng.uniform(8, 25))
    leaning = turn(join(parts), -lean, axis="x")
    return w, Mesh(leaning.vertices + np.array((0, 0, bottom), dtype=np.float32), leaning.faces)


def laptop(rng: np.random.Generator) -> Mesh:
    """A laptop: a base as wide as the panel, with rows of keys and a touch pad."""
    thick = float(rng.uniform(0.03, 0.055))
    w, screen = panel(rng, thick, float(rng.uniform(0.035, 0.06)))
    deep = float(rng.uniform(0.58, 0.7))
    parts = [screen, box((-w / 2, -deep, 0), (w / 2, 0.03, thick))]
    rows, columns = 4, int(rng.integers(8, 12))
    x0, y0, wide, long = -0.43 * w, -0.55 * deep, 0.86 * w / columns, 0.45 * deep / rows
    for i in range(rows):
        for j in range(columns):
            x, y = x0 + j * wide, y0 + i * long
            parts.append(box((x, y, thick), (x + 0.78 * wide, y + 0.72 * long, thick + 0.014)))
    parts.append(box((-0.15 * w, -0.92 * deep, thick), (0.15 * w, -0.64 * deep, thick + 0.008)))
    return join(parts)


def monitor(rng: np.random.Generator) -> Mesh:
    """A monitor: a panel with a short neck on a plate."""
    gap = float(rng.uniform(0.03, 0.06))
    w, screen = panel(rng, gap, float(rng.uniform(0.03, 0.06)))
    wide, deep = w * float(rng.uniform(0.6, 1.0)), float(rng.uniform(0.3, 0.6))
    parts = [screen, box((-wide / 2, -deep, 0), (wide / 2, 0.04, 0.025))]
    neck = w * float(rng.uniform(0.15, 0.5))
    parts.append(box((-neck / 2, 0, 0), (neck / 2, 0.04, gap + 0.05)))
    return join(parts)
