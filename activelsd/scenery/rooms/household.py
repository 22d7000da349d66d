"""The things of a household that stand in kitchens, bedrooms and bathrooms, by kind and number."""

from __future__ import annotations

import zlib

import numpy as np

from activelsd.errors import DataError, did_you_mean
from activelsd.scenery.rooms import casings, roundware
from activelsd.scenery.rooms.models import Model, assembled

_MAKERS = {**casings.MAKERS, **roundware.MAKERS}

KINDS: tuple[str, ...] = tuple(sorted(_MAKERS))
"""Kinds of household things that are embedded."""


def household_thing(kind: str, number: int) -> Model:
    """The thing of that kind and number: the same to the byte whenever it is asked for.

    Args:
        kind: one of `KINDS`.
        number: from 0; each is another in shape and paint.

    Raises:
        DataError: there is no such kind.
    """
    if kind not in _MAKERS:
        raise DataError(
            f"There is no household thing '{kind}' among the embedded ones; {did_you_mean(kind, KINDS)}"
        )
    rng = np.random.default_rng((zlib.crc32(kind.encode()), number))
    return assembled(kind, number, _MAKERS[kind](rng))
