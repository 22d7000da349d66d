"""Reads objects that others rendered or photographed from all around, each in any number of pictures.

MVCNN (Su et al. 2015) first named them `NAME_000000001_001.jpg` to `_012.jpg`, later
`NAME_0001.obj.shaded_v001.png`; RotationNet (Kanezaki et al. 2018) `NAME_0001_001.png` to `_020.png`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.images import decode_pixels
from activelsd.envs.modelnet.cameras import Camera
from activelsd.envs.modelnet.series import Series, numbered, placed, rings_of
from activelsd.errors import DataError
from activelsd.sections import Colour

_PLACED = re.compile(r"(?:(?P<object>.+)[/._-])?e(?P<elevation>-?\d+(?:\.\d+)?)_a(?P<azimuth>\d+(?:\.\d+)?)")
_NAME = re.compile(
    r"(?P<object>.+?)(?:\.(?:obj|off|ply|stl|glb))?(?:[._](?:shaded|depth))?[._-]+(?:view|v|r)?(?P<view>\d+)"
)

T = TypeVar("T")
_Views = dict[int | Camera, str]
"""Paths of an object's pictures by their number or camera."""


def grouped(pictures: Sequence[tuple[str, Sequence[str]]], where: str) -> dict[str, Series]:
    """The pictures of every object in the order of their cameras, objects in order of names.

    What is wrong with the pictures of one object, such as a view that is missing, is their `fault`.

    Args:
        pictures: path of every picture of one class and split, and the folders below theirs that it is in.
            The first folder is the object's; without one the object's name stands before the number.
        where: name of the class's folder in messages.

    Raises:
        DataError: a name does not tell the object and the view.
    """
    own: dict[str, list[tuple[str, str]]] = {}  # path of each picture, and its name without the ending
    alone: dict[str, list[tuple[str, int | Camera]]] = {}  # path of each picture, and its number or place
    for path, folders in sorted(pictures):
        name = PurePosixPath(path)
        if folders:
            own.setdefault(folders[0], []).append((path, "/".join((*folders[1:], name.stem))))
            continue
        match = _PLACED.fullmatch(name.stem) or _NAME.fullmatch(name.stem)
        if match is None or not match["object"]:
            raise DataError(
                f"{where}/{name.name} should end in a view's number, like cup_0001_001; rename it."
            )
        alone.setdefault(match["object"], []).append((path, _place(match)))
    for folder in own:
        if folder in alone:
            raise DataError(
                f"{where} has a folder '{folder}' and pictures of that name beside it; keep one of the two."
            )
    views = {name: _or_error(_by_place, some, f"'{name}' in {where}") for name, some in alone.items()}
    views |= {name: _or_error(_in_folder, some, f"{where}/{name}") for name, some in own.items()}
    late = _late_beginnings({k: some for k, some in views.items() if not isinstance(some, DataError)}, where)
    paths = {name: [path for path, _ in some] for name, some in alone.items()}
    paths |= {name: [path for path, _ in some] for name, some in own.items()}
    return {
        name: _series(late.get(name, some), f"'{name}' in {where}", paths[name])
        for name, some in sorted(views.items())
    }


def _or_error(read: Callable[[T, str], _Views], pictures: T, what: str) -> _Views | DataError:
    try:
        return read(pictures, what)
    except DataError as error:
        return error


def _series(views: _Views | DataError, what: str, paths: list[str]) -> Series:
    """An object's pictures in order, or, if they cannot be put in order, a series that says why."""
    try:
        if isinstance(views, DataError):
            raise views
        return _in_order(views, what)
    except DataError as error:
        return Series(paths, fault=str(error))


def _place(match: re.Match[str]) -> int | Camera:
    """The number or the camera in a picture's name."""
    if "azimuth" in match.groupdict():
        return Camera(float(match["azimuth"]), float(match["elevation"]))
    return int(match["view"])


def _by_place(pictures: Sequence[tuple[str, int | Camera]], what: str) -> _Views:
    """Paths by number or camera. Raises DataError if one is there twice."""
    views: _Views = {}
    for path, place in pictures:
        if place in views:
            shown = place.name if isinstance(place, Camera) else place
            raise DataError(f"{what} has view {shown} twice; remove one of the two.")
        views[place] = path
    return views


def _in_folder(named: Sequence[tuple[str, str]], where: str) -> _Views:
    """Paths by number or camera of the pictures in an object's folder, whatever they are called.

    Args:
        named: path of each picture, and its name without the ending.
        where: name of the folder in messages.

    Raises:
        DataError: the names have no number, or differ in several that are no elevation and azimuth.
    """
    matches = [_PLACED.fullmatch(name) for _, name in named]
    if all(matches):
        pairs = [(path, _place(match)) for (path, _), match in zip(named, matches, strict=True) if match]
        return _by_place(pairs, where)
    fields = [re.split(r"(\d+)", name) for _, name in named]
    for (path, _), one in zip(named, fields, strict=True):
        if len(one) == 1:
            raise DataError(f"{where}/{PurePosixPath(path).name} should have a view's number; rename it.")
        if one[::2] != fields[0][::2]:
            raise DataError(
                f"{where} holds pictures of two series, {PurePosixPath(named[0][0]).name} and"
                f" {PurePosixPath(path).name}; keep one series of views there."
            )
    numbers = np.array([[int(number) for number in one[1::2]] for one in fields], object)
    (varying,) = np.nonzero((numbers != numbers[0]).any(axis=0))
    if len(varying) == 2 and (found := rings_of([(int(a), int(b)) for a, b in numbers[:, varying]])):
        return _by_place([(path, camera) for (path, _), camera in zip(named, found, strict=True)], where)
    if len(varying) > 1:
        raise DataError(
            f"The pictures in {where} differ in {len(varying)} numbers, as in"
            f" {PurePosixPath(named[-1][0]).name}; number them from 1, or say where they were taken, as in"
            " e30_a090.png."
        )
    column = varying[0] if len(varying) else -1
    counted = zip(named, numbers[:, column], strict=True)
    return _by_place([(path, int(number)) for (path, _), number in counted], where)


def _late_beginnings(objects: Mapping[str, _Views], where: str) -> dict[str, DataError]:
    """An error for every object that begins at 1 and ends where others end that begin at 0."""
    numbers = {name: [n for n in views if isinstance(n, int)] for name, views in objects.items()}
    spans = {name: (min(some), max(some)) for name, some in numbers.items() if some}
    ends = {last for first, last in spans.values() if first == 0}
    lacks = "lacks view 0, which others there have; add it or remove the object."
    return {
        name: DataError(f"'{name}' in {where} {lacks}")
        for name, (first, last) in spans.items()
        if first == 1 and last in ends
    }


def _in_order(views: _Views, what: str) -> Series:
    numbers = {place: path for place, path in views.items() if not isinstance(place, Camera)}
    cameras = {place: path for place, path in views.items() if isinstance(place, Camera)}
    if numbers and cameras:
        raise DataError(
            f"{what} has pictures whose names tell elevation and azimuth, and others; name all in one way."
        )
    return placed(cameras, what) if cameras else numbered(numbers, what)


def decode(data: bytes, name: str, size: int, colour: Colour = "gray") -> NDArray[np.uint8]:
    """uint8 ([3,] size, size): a picture, averaged over areas; what is transparent becomes white.

    Raises:
        DataError: it is no whole picture in a format that is read (see `images`), or not square.
    """
    from activelsd.envs.colour import in_colour  # OpenCV is not needed for meshes
    from activelsd.envs.crops import squashed

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
    if picture.ndim == 3:
        picture = picture[:, :, ::-1]
    return squashed(in_colour(picture, colour), size)
