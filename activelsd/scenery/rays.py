"""What ray casting with embree needs of a mesh's faces, for objects and rooms alike."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

Float = TypeVar("Float", np.float32, np.float64)


def scene_of(corners: NDArray[Float]) -> EmbreeScene:
    """An embree scene of faces, given by their corners (M, 3, 3)."""
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.ascontiguousarray(corners, dtype=np.float32))
    return scene


def face_normals(corners: NDArray[Float]) -> NDArray[np.float64]:
    """Unit normals (M, 3) of faces, given by their corners (M, 3, 3); zero for a face without area."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.sqrt(np.square(across).sum(axis=1, keepdims=True))
    found: NDArray[np.float64] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    return found


def dot(a: NDArray[Float], b: NDArray[Float]) -> NDArray[Float]:
    """Dot products along the last axis, written out: a BLAS may round differently by machine and threads."""
    products: NDArray[Float] = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return products
