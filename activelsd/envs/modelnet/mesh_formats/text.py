"""Numbers in text files, parsed by NumPy a file at a time."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

_NOT_A_NUMBER = re.compile(rb"[+-]?(?:\d+\.#(?:IND|QNAN|SNAN|INF)\d*|nan\([a-z]*\))", re.IGNORECASE)
"""How Microsoft's C library writes what is no number or infinite."""


def plain_nan(text: bytes) -> bytes:
    """The text with `1.#IND` and the like as `nan`."""
    return _NOT_A_NUMBER.sub(b"nan", text)


def numbers(text: bytes) -> NDArray[np.float64] | None:
    """The numbers in a text, or None if there is something else in it."""
    if not text.strip():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy before 2.3 so says that it stopped halfway
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            plain = plain_nan(text)
            return None if plain == text else numbers(plain)


def rows(lines: Sequence[bytes], name: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The numbers (K,) of all lines and how many there are in each (N,).

    Raises:
        DataError: a line holds something else, with `name` of the file.
    """
    widths = np.fromiter((len(line.split()) for line in lines), np.int64, len(lines))
    values = numbers(b" ".join(lines))
    if values is None or len(values) != widths.sum():
        for line, width in zip(lines, widths, strict=True):
            own = numbers(line)
            if own is None or len(own) != width:
                raise DataError(
                    f"{name} has '{shown(line)}' where numbers belong; copy it again or remove it."
                )
    assert values is not None
    return values, widths


def shown(text: bytes) -> str:
    """The beginning of a text as it can be put into a message."""
    return "".join(c if c.isprintable() else "?" for c in text[:40].decode("ascii", "replace"))
