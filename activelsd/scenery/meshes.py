"""The triangle mesh: what readers and embedded shapes make and the renderer takes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mesh(NamedTuple):
    """Triangles in space, z up, in any unit and about any origin.

    Faces may be wound either way, repeat, or have no area, and vertices may go unused: ModelNet's do.
    """

    vertices: NDArray[np.float32]  # (N, 3) x, y, z
    faces: NDArray[np.int32]  # (M, 3) indices into vertices
