"""Cups and vases: their bodies are similar; only a cup has a handle, which the body may hide."""

from __future__ import annotations

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.solids import arc, join, lathe, tube


def profile(rng: np.random.Generator, waist: float) -> list[tuple[float, float]]:
    """Outer wall points (radius, height) from the foot to the rim at height 1; `waist` narrows the neck."""
    foot, rim = rng.uniform(0.27, 0.42), rng.uniform(0.34, 0.48)
    belly, at = rng.uniform(-0.04, 0.12), rng.uniform(0.35, 0.6)
    heights = np.linspace(0.0, 1.0, 11)
    radii = foot + (rim - foot) * heights
    radii += belly * np.exp(-(((heights - at) / 0.28) ** 2))
    radii -= waist * np.exp(-(((heights - 0.82) / 0.16) ** 2))
    return [(float(r), float(z)) for r, z in zip(radii, heights, strict=True)]


def vessel(rng: np.random.Generator, outer: list[tuple[float, float]]) -> Mesh:
    """A hollow body with the given outer wall."""
    wall, floor = float(rng.uniform(0.025, 0.05)), float(rng.uniform(0.05, 0.1))
    inner = [(r - wall, z) for r, z in reversed(outer) if z > floor]
    foot = outer[0][0]
    return lathe([(0.0, 0.0), *outer, *inner, (foot - wall, floor), (0.0, floor)])


def vase(rng: np.random.Generator) -> Mesh:
    """A body without a handle, usually with a neck."""
    return vessel(rng, profile(rng, float(rng.uniform(0.0, 0.2))))


def cup(rng: np.random.Generator) -> Mesh:
    """A body with a handle at the front, rarely with a neck."""
    outer = profile(rng, float(rng.choice((0.0, 0.0, 0.0, rng.uniform(0.0, 0.1)))))
    low, high = float(rng.uniform(0.15, 0.35)), float(rng.uniform(0.65, 0.85))
    reach, thick = float(rng.uniform(0.12, 0.2)), float(rng.uniform(0.035, 0.055))
    bow = arc(-90, 90, 9)
    z = (low + high) / 2 + bow[:, 1] * (high - low) / 2
    wall = np.interp(z, [p[1] for p in outer], [p[0] for p in outer])
    y = -(wall - 0.02 + bow[:, 0] * reach)
    return join([vessel(rng, outer), tube(np.column_stack([np.zeros_like(y), y, z]), thick)])
