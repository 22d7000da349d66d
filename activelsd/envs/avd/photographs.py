"""Reads the photographs of a scan: JPEG, in gray."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

_START, _END = b"\xff\xd8", b"\xff\xd9"


def read_photograph(path: Path) -> NDArray[np.uint8]:
    """uint8 (H, W): a photograph in gray.

    Raises:
        DataError: it is missing, cut short, or no JPEG.
    """
    # OpenCV reports a damaged file on stderr by itself, in lines that do not help a user.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        data = path.read_bytes()
        # OpenCV would fill the missing part of a short file with gray and report nothing.
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
