"""Point clouds from files: points on the surface of an object, with or without normals, in no order."""

from __future__ import annotations

import io
import math
from pathlib import PurePosixPath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

ENDINGS = frozenset({".npy"})
"""Endings of files that hold points."""

UNIT = 0.01
"""How far from 1 the length of a normal may be."""


class Points(NamedTuple):
    """A point cloud, in any unit and about any origin."""

    positions: NDArray[np.float64]  # (N, 3) x, y, z
    normals: NDArray[np.float64] | None  # (N, 3) of unit length and either sign, where the file has them


def decode_points(data: bytes, name: str) -> Points:
    """The point cloud in a file's bytes; the ending of `name` tells the format.

    Raises:
        DataError: it is not a whole point cloud, or has coordinates that are not finite.
    """
    return from_table(_READERS[PurePosixPath(name).suffix.lower()](data, name), name)


def from_table(table: NDArray[np.float64], name: str) -> Points:
    """Points from rows of x, y, z and more: the next three are normals if all are of unit length.

    Args:
        table: (N, C) numbers.
        name: of the file in messages.

    Raises:
        DataError: there are no points, or some are not finite.
    """
    if table.ndim != 2 or table.shape[1] < 3:
        shape = " x ".join(map(str, table.shape)) or "one number"
        raise DataError(f"{name} is {shape}, but points are rows of x, y, z and more; save it so.")
    if len(table) == 0:
        raise DataError(f"{name} has no points, so there is nothing to see; remove it.")
    positions = table[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(positions.astype(np.float32)).all(axis=1)  # what is too large is as bad
    if not finite.all():
        first = int(np.argmin(finite))
        raise DataError(f"{name} has a point, number {first}, that is not finite; repair or remove it.")
    return Points(positions, _normals(table[:, 3:6]))


def _normals(columns: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The columns (N, 3) if they are normals; None if they are something else, such as colours."""
    if columns.shape[1] < 3:
        return None
    with np.errstate(all="ignore"):
        lengths = np.sqrt(np.square(columns).sum(axis=1, keepdims=True))
    return columns / lengths if (np.abs(lengths - 1) <= UNIT).all() else None


def _from_npy(data: bytes, name: str) -> NDArray[np.float64]:
    """Any array of numbers, by the header that NumPy's format gives its shape in."""
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        header = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, by_columns, dtype = header(file)
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError, UnicodeDecodeError):
        raise DataError(f"{name} has no header of a .npy file; copy it again or remove it.") from None
    if dtype.kind not in "fiu":
        raise DataError(f"{name} holds values of type {dtype}, not numbers; save rows of x, y, z.")
    wanted, found = math.prod(shape) * dtype.itemsize, len(data) - file.tell()
    if found != wanted:
        raise DataError(
            f"{name} has {found} bytes of numbers where its header says {wanted}; copy it again or remove it."
        )
    table = np.frombuffer(data, dtype, offset=file.tell())
    return table.reshape(shape, order="F" if by_columns else "C").astype(np.float64)


_READERS = {".npy": _from_npy}
