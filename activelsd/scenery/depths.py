"""Depths of an object from cameras around it, in bytes: as pictures, and as what recordings keep."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.scenery.orbit_renderer import DEEPEST

NOTHING = 255
"""Level where a ray hits nothing."""

STEP = 2 / (NOTHING - 1)
"""Depth between two levels; the object's sphere has radius 1, and level 0 is where it begins."""


class Depths(NamedTuple):
    """Depths of V views along the axes of their cameras."""

    levels: NDArray[np.uint8]  # (V, S, S), NOTHING where nothing is hit
    cameras: NDArray[np.float64]  # (V, 2) azimuth and elevation in degrees, as `render_depths` takes them


def as_levels(depths: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """What `orbit_renderer.render_depths` returns, rounded to levels; same shape."""
    fractions = depths / np.float32(DEEPEST - 1)
    return np.where(depths == DEEPEST, NOTHING, np.rint(fractions * (NOTHING - 1))).astype(np.uint8)
