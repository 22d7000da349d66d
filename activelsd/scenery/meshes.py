"""The triangle mesh, made by readers and embedded shapes and rendered by the renderer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mesh(NamedTuple):
    """Triangles in space, z up, in any unit and with any origin.

    As in ModelNet, faces may have either winding, be repeated or have no area, and vertices may be unused.
    """

    vertices: NDArray[np.float32]  # (N, 3) x, y, z
    faces: NDArray[np.int32]  # (M, 3) indices into vertices
