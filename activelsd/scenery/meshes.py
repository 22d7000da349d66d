"""The triangle mesh, made by readers and embedded shapes and rendered by the renderer."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Axis: TypeAlias = Literal["x", "y", "z"]
Float = TypeVar("Float", np.float32, np.float64)


class Mesh(NamedTuple):
    """Triangles in space, z up, in any unit and with any origin.

    As in ModelNet, faces may have either winding, be repeated or have no area, and vertices may be unused.
    """

    vertices: NDArray[np.float32]  # (N, 3) x, y, z
    faces: NDArray[np.int32]  # (M, 3) indices into vertices


def upright(points: NDArray[Float], up: Axis) -> NDArray[Float]:
    """Points (N, 3) turned by a quarter so that their axis `up` becomes z; as they are for z.

    From y, x stays: what faces z, the front of a glTF, faces -y then. From x, y stays.
    """
    x, y, z = points.T
    if up == "y":
        return np.stack([x, -z, y], axis=1)
    if up == "x":
        return np.stack([-z, y, x], axis=1)
    return points
