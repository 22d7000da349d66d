"""Colours and patterns of surfaces, computed from points in the object's own coordinates.

So a pattern moves with its object, and needs no image and no texture coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Colour = tuple[float, float, float]
"""Red, green, blue in 0..255."""

PATTERNS = ("plain", "stripes", "checks", "grain")
_OFFSET = 0.137  # of a period, so that a face at a multiple of the period does not flicker between checks


class Material(NamedTuple):
    """The appearance of a surface under white light."""

    colour: Colour
    second: Colour = (0.0, 0.0, 0.0)  # colour of every other stripe, check or grain
    pattern: str = "plain"
    period: float = 1.0  # metres
    axis: int = 0  # axis along which stripes and grain change: 0 x, 1 y, 2 z


class Palette:
    """Materials as arrays, to look up many points at once."""

    def __init__(self, materials: Sequence[Material]) -> None:
        """Stores the materials in order; their indices are the keys."""
        self.colours = np.array([m.colour for m in materials], np.float32)  # (N, 3)
        self.patterns = np.array([PATTERNS.index(m.pattern) for m in materials], np.uint8)  # (N,)
        self._seconds = np.array([m.second for m in materials], np.float32)
        self._per_metre = np.array([1 / m.period for m in materials], np.float32)
        self._axes = np.array([m.axis for m in materials], np.int64)

    def patterned(self, materials: NDArray[np.int32], points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Colours (P, 3) of points (P, 3), in metres in the object, with patterned materials (P,)."""
        scaled = points * self._per_metre[materials, None] + np.float32(_OFFSET)
        axes = self._axes[materials]
        rows = np.arange(len(axes))
        along = scaled[rows, axes]
        across = scaled[rows, (axes + 1) % 3] + scaled[rows, (axes + 2) % 3]
        pattern = self.patterns[materials]
        waves = 0.5 + 0.5 * np.sin(2 * math.pi * (along + 0.4 * np.sin(0.25 * across)))
        stripes = np.floor(2 * along) % 2
        checks = np.floor(2 * scaled).sum(axis=1) % 2
        share = np.where(pattern == 1, stripes, np.where(pattern == 2, checks, waves)).astype(np.float32)
        first = self.colours[materials]
        mixed: NDArray[np.float32] = first + (self._seconds[materials] - first) * share[:, None]
        return mixed


def darker(colour: Colour, by: float) -> Colour:
    """The colour times 1 - `by`; a negative `by` makes it lighter."""
    red, green, blue = (min(255.0, channel * (1 - by)) for channel in colour)
    return red, green, blue
