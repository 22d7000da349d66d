"""Arrays as NumPy saves them: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html."""

from __future__ import annotations

import io
import math
import warnings
from tokenize import TokenError

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from activelsd.errors import DataError

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
"""Readers of headers, by version of the format."""


def read(data: bytes, name: str) -> NDArray[np.float64]:
    """The array of numbers in a .npy file, of any shape.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is something else, or not as long as its header says.
    """
    file = io.BytesIO(data)
    try:
        header = _HEADERS[npy.read_magic(file)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # files of Python 2 are read as well
            shape, by_columns, dtype = header(file)
    except (KeyError, ValueError, TypeError, SyntaxError, TokenError, RecursionError, MemoryError):
        raise DataError(f"{name} has no header of a .npy file; copy it again or remove it.") from None
    if dtype.kind not in "fiu":
        raise DataError(f"{name} holds {dtype.name[:40]}, not numbers; save rows of x, y, z.")
    wanted, found = math.prod(shape) * dtype.itemsize, len(data) - file.tell()
    if found != wanted or any(length < 0 for length in shape):
        raise DataError(
            f"{name} has {found} bytes of numbers where its header says {wanted}; copy it again or remove it."
        )
    values = np.frombuffer(data, dtype, offset=file.tell())
    with np.errstate(invalid="ignore"):
        return values.reshape(shape, order="F" if by_columns else "C").astype(np.float64)
