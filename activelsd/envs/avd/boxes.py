"""Boxes around the visible part of each instance, with the Active Vision Dataset's difficulty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

FULL_WIDTH = 1920
"""Width in pixels that the rule of difficulty is for; its sides scale with the width of other photographs."""

DIFFICULTIES = ((300, 100), (200, 75), (100, 50), (50, 30))
"""Least larger and smaller side of boxes of difficulty 1 to 4; all others are 5."""

LEAST_PIXELS = 200
"""Visible pixels, at full width, below which an instance has no box."""

Box = list[int]
"""xmin, ymin, xmax, ymax, instance id, difficulty; the maxima are one past the last visible pixel."""


def visible_boxes(instances: NDArray[np.int32]) -> list[Box]:
    """Boxes of the instances with enough visible pixels, in order of id.

    Args:
        instances: (H, W) id of the instance at every pixel, 0 for none.
    """
    width = instances.shape[1]
    least = LEAST_PIXELS * (width / FULL_WIDTH) ** 2
    boxes = []
    counts = np.bincount(instances.ravel())
    for i, found in enumerate(find_objects(instances), start=1):
        if found is not None and counts[i] >= least:
            rows, columns = found
            sides = columns.stop - columns.start, rows.stop - rows.start
            box = [columns.start, rows.start, columns.stop, rows.stop, i, difficulty(*sides, width)]
            boxes.append(box)
    return boxes


def difficulty(one: int, other: int, width: int) -> int:
    """1 (easy) to 5 of a box with those sides in a photograph of that width, all in pixels."""
    smaller, larger = sorted((one * FULL_WIDTH / width, other * FULL_WIDTH / width))
    for number, (most, least) in enumerate(DIFFICULTIES, start=1):
        if larger >= most and smaller >= least:
            return number
    return len(DIFFICULTIES) + 1
