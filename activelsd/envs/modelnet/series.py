"""Orders the pictures of one object by their names: by a number, degrees, or elevation and azimuth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

from activelsd.envs.modelnet.cameras import Camera, Ring
from activelsd.errors import DataError


class Series(NamedTuple):
    """The pictures of an object, in the order of its cameras."""

    paths: list[str]
    rings: tuple[Ring, ...] = ()  # where they were taken; empty: their names do not tell
    fault: str = ""  # why they cannot be put in order


def numbered(views: Mapping[int, str], what: str) -> Series:
    """The pictures in the order of their numbers.

    Numbers run from 0 or from 1, or from anywhere as a camera counts, without a gap; or they are degrees,
    evenly spaced around the object.

    Args:
        views: paths by number.
        what: name of the object in messages.

    Raises:
        DataError: there is a gap.
    """
    numbers = sorted(views)
    counts_on = numbers[0] in (0, 1) or numbers[0] > len(numbers)
    if not (counts_on and numbers[-1] - numbers[0] == len(numbers) - 1) and not _evenly_around(numbers):
        raise DataError(_gap(numbers, what))
    return Series([views[number] for number in numbers])


def placed(views: Mapping[Camera, str], what: str) -> Series:
    """The pictures ring after ring, the lowest first.

    Args:
        views: paths by where they were taken.
        what: name of the object in messages.

    Raises:
        DataError: a ring has a gap.
    """
    rings, paths = [], []
    for elevation, cameras in groupby(sorted(views, key=lambda c: c[::-1]), key=lambda c: c.elevation):
        ring = list(cameras)
        azimuths = tuple(camera.azimuth for camera in ring)
        if len(ring) > 1 and not _evenly_around(azimuths):
            raise DataError(_gap(azimuths, f"{what}, at an elevation of {elevation:g} degrees,"))
        rings.append(Ring(elevation, azimuths))
        paths += [views[camera] for camera in ring]
    return Series(paths, tuple(rings))


def rings_of(pairs: Sequence[tuple[int, int]]) -> list[Camera] | None:
    """The cameras of pictures that are numbered by ring and place on it; None if these are no whole rings.

    Places are degrees, evenly around, or numbers from 0 or 1. Rings are elevations in degrees, or angles from
    the upright axis, as in ETH-80 (Leibe and Schiele 2003), if several cameras stand at 90 or more.
    """
    rings: dict[int, list[int]] = {}
    for ring, place in sorted(pairs):
        rings.setdefault(ring, []).append(place)
    if max(rings) > 180:
        return None
    azimuths: dict[tuple[int, int], float] = {}
    for ring, places in rings.items():
        counted = places[0] in (0, 1) and places[-1] - places[0] == len(places) - 1
        if len(set(places)) < len(places) or not (counted or _evenly_around(places)):
            return None
        for i, place in enumerate(places):
            azimuths[ring, place] = i * 360 / len(places) if counted else place
    from_axis = any(ring >= 90 and len(places) > 1 for ring, places in rings.items())
    return [Camera(azimuths[pair], 90.0 - pair[0] if from_axis else pair[0]) for pair in pairs]


def _evenly_around(degrees: Sequence[float]) -> bool:
    """Whether rising angles are a full circle in about equal steps, each off by an eighth at most."""
    step = 360 / len(degrees)
    off = [angle - i * step for i, angle in enumerate(degrees)]
    return len(degrees) > 1 and degrees[0] >= 0 and degrees[-1] <= 360 and max(off) - min(off) <= step / 4


def _gap(numbers: Sequence[float], what: str) -> str:
    """What is wrong with rising numbers that have a gap."""
    steps = Counter(later - sooner for sooner, later in pairwise(numbers))
    (step, _), *_ = steps.most_common(1) or [(1, 1)]
    first, last = numbers[0], numbers[-1]
    if step == 1 and 1 < first <= len(numbers):
        first = 1
    around = step > 1 and 360 % step == 0 and last < 360 <= 2 * (last - first)
    for i in range(round((360 if around else last - first) / step)):
        if (wanted := first + i * step) not in numbers and (not around or wanted < 360):
            return (
                f"{what} has views {numbers[0]:g} to {last:g} but lacks view {wanted:g}; add it or remove the"
                " object, since a ring has no gaps."
            )
    return (
        f"{what} has views {first:g} to {last:g} in steps of {step:g}; number them from 1, or by degrees all"
        " around."
    )
