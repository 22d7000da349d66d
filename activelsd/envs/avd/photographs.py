"""Reads the photographs of a scan, in gray or in colour."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.colour import decoded
from activelsd.envs.images import examine
from activelsd.errors import DataError
from activelsd.sections import Colour


def read_photograph(path: Path, colour: Colour = "gray") -> NDArray[np.uint8]:
    """uint8 (H, W) in gray, or (H, W, 3) RGB.

    Raises:
        DataError: it is missing, cut short, or no picture that is read.
    """
    # OpenCV reports a damaged file on stderr by itself, in lines that do not help a user.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        data = path.read_bytes()
        picture = decoded(data, colour) if examine(data).whole else None
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror or error}); copy it again.") from None
    if picture is None:
        raise DataError(
            f"{path} is not a whole picture; copy it again or remove it, and its view is left out."
        )
    return picture
