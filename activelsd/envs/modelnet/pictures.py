"""Reads objects that others rendered as twelve pictures each, as MVCNN does.

MVCNN (Su et al. 2015) first named them `NAME_000000001_001.jpg` to `_012.jpg`, later
`NAME_0001.obj.shaded_v001.png`; elsewhere they count from `_v0000`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

ENDINGS = frozenset({".png", ".jpg", ".jpeg"})
VIEWS = 12
_NAME = re.compile(r"(?P<object>.+?)(?:\.(?:obj|off))?(?:[._]shaded)?_v?(?P<view>\d+)")
_MARKS = ((b"\x89PNG", b"IEND"), (b"\xff\xd8", b"\xff\xd9"))
"""How PNG and JPEG begin and end; OpenCV fills the missing part of a file with gray and reports nothing."""


def grouped(paths: Sequence[str], where: str) -> dict[str, list[str]]:
    """The pictures of every object in the order of their numbers, objects in order of names.

    Args:
        paths: of the pictures of one class and split.
        where: name of their folder in messages.

    Raises:
        DataError: a name has no number, or an object's views are not twelve numbered from 0 or from 1.
    """
    objects: dict[str, dict[int, str]] = {}
    for path in sorted(paths):
        name = PurePosixPath(path)
        match = _NAME.fullmatch(name.stem)
        if match is None:
            raise DataError(
                f"{where}/{name.name} should end in a view's number, like cup_0001_001; rename it."
            )
        views = objects.setdefault(match["object"], {})
        number = int(match["view"])
        if number in views:
            raise DataError(f"{where} has view {number} of '{match['object']}' twice; remove one of the two.")
        views[number] = path
    first = 0 if any(0 in views for views in objects.values()) else 1
    for name_of, views in objects.items():
        _check_whole(f"'{name_of}' in {where}", views, range(first, first + VIEWS))
    return {name_of: [views[n] for n in sorted(views)] for name_of, views in sorted(objects.items())}


def _check_whole(what: str, views: Mapping[int, str], wanted: range) -> None:
    asked = f"{VIEWS} views, {wanted[0]} to {wanted[-1]}, are wanted of every object"
    for number in wanted:
        if number not in views:
            raise DataError(f"{what} lacks view {number}; {asked}, so render it or remove the object.")
    extra = sorted(set(views) - set(wanted))
    if extra:
        raise DataError(f"{what} has a view {extra[0]}; {asked}, 30 degrees apart.")


def decode(data: bytes, name: str, size: int) -> NDArray[np.uint8]:
    """uint8 (size, size): a picture in gray, averaged over areas; what is transparent becomes white.

    Raises:
        DataError: OpenCV cannot read it, it is cut short, or not square.
    """
    import cv2  # not needed for meshes

    # OpenCV reports a damaged file on stderr by itself, in lines that do not help a user.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    whole = any(data.startswith(start) and end in data[-512:] for start, end in _MARKS)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if whole else None
    if picture is None:
        raise DataError(f"{name} is not a whole picture; copy it again or remove its object.")
    height, width = picture.shape[:2]
    if height != width:
        raise DataError(f"{name} is {width} x {height} pixels, but views are square; render it so.")
    if picture.dtype == np.uint16:
        picture = (picture // 256).astype(np.uint8)
    if picture.ndim == 3 and picture.shape[2] == 4:
        opaque = picture[:, :, 3:].astype(np.float32) / 255
        picture = np.rint(picture[:, :, :3] * opaque + 255 * (1 - opaque)).astype(np.uint8)
    if picture.ndim == 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA), np.uint8)
