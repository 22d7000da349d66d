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

from activelsd.envs.images import decode_pixels
from activelsd.errors import DataError

VIEWS = 12
_NUMBERED = re.compile(r"(?P<object>.*?)(?P<view>\d+)")
_NAME = re.compile(r"(?P<object>.+?)(?:\.(?:obj|off))?(?:[._]shaded)?_v?(?P<view>\d+)")


def grouped(pictures: Sequence[tuple[str, Sequence[str]]], where: str) -> dict[str, list[str]]:
    """The pictures of every object in the order of their numbers, objects in order of names.

    Args:
        pictures: path of every picture of one class and split, and the folders below theirs that it is in.
            The first folder is the object's; without one the object's name stands before the number.
        where: name of the class's folder in messages.

    Raises:
        DataError: a name has no number, a folder holds pictures of several objects, or an object's views are
            not twelve numbered from 0 or from 1.
    """
    objects: dict[str, dict[int, str]] = {}
    held: dict[str, tuple[tuple[str, ...], str]] = {}  # the series of pictures in an object's folder
    for path, folders in sorted(pictures):
        name = PurePosixPath(path)
        match = (_NUMBERED if folders else _NAME).fullmatch(name.stem)
        shown = "/".join((where, *folders, name.name))
        if match is None:
            raise DataError(f"{shown} should end in a view's number, like cup_0001_001; rename it.")
        owner, series = folders[0] if folders else match["object"], (tuple(folders), match["object"])
        if folders and held.setdefault(owner, series) != series:
            raise DataError(
                f"{shown} is not of the same series as others in the folder of '{owner}'; keep one series of"
                " views there."
            )
        views = objects.setdefault(owner, {})
        number = int(match["view"])
        if number in views:
            raise DataError(f"{where} has view {number} of '{owner}' twice; remove one of the two.")
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
        DataError: it is no whole picture in a format that is read (see `images`), or not square.
    """
    import cv2  # not needed for meshes

    try:
        picture = decode_pixels(data)
    except ValueError as error:
        raise DataError(f"{name} {error}, or remove its object.") from None
    height, width = picture.shape[:2]
    if height != width:
        raise DataError(f"{name} is {width} x {height} pixels, but views are square; render it so.")
    if picture.ndim == 3 and picture.shape[2] == 4:
        opaque = picture[:, :, 3:].astype(np.float32) / 255
        picture = np.rint(picture[:, :, :3] * opaque + 255 * (1 - opaque)).astype(np.uint8)
    gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(gray, (size, size), interpolation=cv2.INTER_AREA), np.uint8)
