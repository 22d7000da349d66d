"""Household objects for kitchens, bedrooms and bathrooms, by kind and number."""

from __future__ import annotations

import zlib

import numpy as np

from activelsd.errors import DataError, did_you_mean
from activelsd.scenery.rooms import casings, roundware
from activelsd.scenery.rooms.models import Model, assembled

_MAKERS = {**casings.MAKERS, **roundware.MAKERS}

KINDS: tuple[str, ...] = tuple(sorted(_MAKERS))
"""The embedded kinds of household objects."""


def household_thing(kind: str, number: int) -> Model:
    """The object with this kind and number, always the same to the byte.

    Args:
        kind: one of `KINDS`.
        number: from 0; each number gives another shape and other colours.

    Raises:
        DataError: there is no such kind.
    """
    if kind not in _MAKERS:
        raise DataError(f"There is no embedded household object '{kind}'; {did_you_mean(kind, KINDS)}")
    rng = np.random.default_rng((zlib.crc32(kind.encode()), number))
    return assembled(kind, number, _MAKERS[kind](rng))
