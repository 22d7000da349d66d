"""Turns images into what an agent sees: square frames, and boxes cropped at full resolution."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.colour import channels_first

CONTEXT = 1.2
"""Side of a crop as a multiple of its box's larger side."""


def squashed(picture: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """The whole image, (H, W) or (H, W, 3), resized to uint8 ([3,] size, size) by area averaging.

    The aspect ratio is not kept and nothing is cut off, so positions as fractions of the image stay the same.
    """
    small = cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)
    return channels_first(np.asarray(small, np.uint8))


def cut_out(picture: NDArray[np.uint8], box: NDArray[np.int32], size: int) -> NDArray[np.uint8]:
    """A square crop around a box, resized to uint8 ([3,] size, size); the aspect ratio is kept.

    The square's side is `CONTEXT` times the box's larger side. Outside the image, edge pixels are repeated.

    Args:
        picture: (H, W) or (H, W, 3) at full resolution.
        box: (4,) xmin, ymin, xmax, ymax in pixels, half-open.
        size: side of the crop.
    """
    x0, y0, x1, y1 = (int(edge) for edge in box)
    side = max(1, round(max(x1 - x0, y1 - y0) * CONTEXT))
    left, top = (x0 + x1 - side) // 2, (y0 + y1 - side) // 2
    height, width = picture.shape[:2]
    columns = np.arange(left, left + side).clip(0, width - 1)
    rows = np.arange(top, top + side).clip(0, height - 1)
    square = picture[rows[:, None], columns]
    interpolation = cv2.INTER_AREA if side >= size else cv2.INTER_LINEAR
    small = cv2.resize(square, (size, size), interpolation=interpolation)
    return channels_first(np.asarray(small, np.uint8))
