"""Pictures of a world to what an agent sees of them: square frames, and boxes cut out at full resolution."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

CONTEXT = 1.2
"""Side of a crop as a multiple of its box's larger side."""


def squashed(picture: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """uint8 (size, size): all of a picture, averaged over areas, so that fractions of it stay fractions.

    A 16:9 picture becomes narrower by that; nothing at its sides is cut off.
    """
    return np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


def cut_out(picture: NDArray[np.uint8], box: NDArray[np.int32], size: int) -> NDArray[np.uint8]:
    """uint8 (size, size): the square around a box with some context, its shape kept.

    The square's side is `CONTEXT` times the box's larger side; beyond the picture its edge goes on.

    Args:
        picture: (H, W) at full resolution.
        box: (4,) xmin, ymin, xmax, ymax in pixels, half-open.
        size: side of the crop.
    """
    x0, y0, x1, y1 = (int(edge) for edge in box)
    side = max(1, round(max(x1 - x0, y1 - y0) * CONTEXT))
    left, top = (x0 + x1 - side) // 2, (y0 + y1 - side) // 2
    height, width = picture.shape
    columns = np.arange(left, left + side).clip(0, width - 1)
    rows = np.arange(top, top + side).clip(0, height - 1)
    square = picture[rows[:, None], columns]
    way = cv2.INTER_AREA if side >= size else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(square, (size, size), interpolation=way), np.uint8)
