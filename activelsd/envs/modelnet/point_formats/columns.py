"""Named columns of points, as PCD, PLY and texts with a header have them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

_NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
"""What columns of normals are called."""


def table(columns: Mapping[str, NDArray[Any]], name: str) -> NDArray[np.float64]:
    """Rows (N, 3) of x, y, z or, if there are normals, (N, 6).

    Args:
        columns: (N,) numbers each, by name in small letters.
        name: of the file in messages.

    Raises:
        DataError: there is no x, y or z.
    """
    if not {"x", "y", "z"} <= columns.keys():
        raise DataError(f"{name} has no columns x, y and z; save it with them or remove it.")
    normals = next((names for names in _NORMALS if columns.keys() >= set(names)), ())
    with np.errstate(invalid="ignore"):  # what is not finite is refused later
        return np.stack([columns[label].astype(np.float64) for label in ("x", "y", "z", *normals)], axis=1)
