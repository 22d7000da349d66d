"""Photographs of a scan: read from JPEG, squashed to square frames, and boxes cut out of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

CONTEXT = 1.2
"""Side of a crop as a multiple of its box's larger side."""

_START, _END = b"\xff\xd8", b"\xff\xd9"


def read_photograph(path: Path) -> NDArray[np.uint8]:
    """uint8 (H, W): a photograph in gray.

    Raises:
        DataError: it is missing, cut short, or no JPEG.
    """
    # OpenCV reports a damaged file on stderr by itself, in lines that mean nothing to a user.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        data = path.read_bytes()
        # What a short file lacks OpenCV would fill with gray and say nothing.
        whole = data.startswith(_START) and _END in data[-512:]
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if whole else None
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror or error}); copy it again.") from None
    except cv2.error:  # larger than it reads
        picture = None
    if picture is None:
        raise DataError(f"{path} is not a whole JPEG; copy it again or remove it, and its view is left out.")
    return np.asarray(picture, np.uint8)


def squashed(photograph: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """uint8 (size, size): all of a photograph, averaged over areas, so that fractions of it stay fractions.

    A 16:9 photograph becomes narrower by that; nothing at its sides is cut off.
    """
    return np.asarray(cv2.resize(photograph, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


def cut_out(photograph: NDArray[np.uint8], box: NDArray[np.int32], size: int) -> NDArray[np.uint8]:
    """uint8 (size, size): the square around a box with some context, its shape kept.

    The square's side is `CONTEXT` times the box's larger side; beyond the photograph its edge goes on.

    Args:
        photograph: (H, W) at full resolution.
        box: (4,) xmin, ymin, xmax, ymax in pixels, half-open.
        size: side of the crop.
    """
    x0, y0, x1, y1 = (int(edge) for edge in box)
    side = max(1, round(max(x1 - x0, y1 - y0) * CONTEXT))
    left, top = (x0 + x1 - side) // 2, (y0 + y1 - side) // 2
    height, width = photograph.shape
    columns = np.arange(left, left + side).clip(0, width - 1)
    rows = np.arange(top, top + side).clip(0, height - 1)
    square = photograph[rows[:, None], columns]
    way = cv2.INTER_AREA if side >= size else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(square, (size, size), interpolation=way), np.uint8)
