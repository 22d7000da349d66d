"""Pictures in gray or in colour: the one place that makes gray of colour, and the order of channels.

While pictures are cut and resized their channels come last, as OpenCV has them: (H, W) in gray, (H, W, 3) in
red, green and blue. What an agent sees has them first: (S, S) or (3, S, S).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from activelsd.sections import Colour


def in_colour(picture: NDArray[np.uint8], colour: Colour) -> NDArray[np.uint8]:
    """Returns a picture (H, W) or (H, W, 3) RGB as (H, W) for `gray` or as (H, W, 3) for `rgb`.

    Gray is 0.299 red + 0.587 green + 0.114 blue (ITU-R BT.601), as OpenCV rounds it. A gray picture in `rgb`
    has three equal channels.
    """
    if (picture.ndim == 3) == (colour == "rgb"):
        return picture
    code = cv2.COLOR_GRAY2RGB if colour == "rgb" else cv2.COLOR_RGB2GRAY
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(picture), code), np.uint8)


def decoded(data: bytes, colour: Colour) -> NDArray[np.uint8] | None:
    """Returns a picture's file as (H, W) or (H, W, 3) RGB, not turned by its EXIF; None if it is damaged.

    A JPEG holds its gray, by the same weights, apart from its colours: there gray is read and not computed.
    """
    flags = cv2.IMREAD_COLOR if colour == "rgb" else cv2.IMREAD_GRAYSCALE
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:  # larger than it reads
        return None
    if picture is not None and colour == "rgb":
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    return None if picture is None else np.asarray(picture, np.uint8)


def channels_first(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns (S, S) as it is, and (S, S, 3) as (3, S, S)."""
    return picture if picture.ndim == 2 else np.ascontiguousarray(picture.transpose(2, 0, 1))


def channels_last(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns (S, S) as it is, and (3, S, S) as (S, S, 3), as figures are drawn."""
    return picture if picture.ndim == 2 else picture.transpose(1, 2, 0)
