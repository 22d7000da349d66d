"""Reads point clouds: points on the surface of an object, in any order, with or without normals.

Each format has a parser in `point_formats`. A file that would be read in part is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats import ply
from activelsd.envs.modelnet.point_formats import columns, npy, pcd, text
from activelsd.errors import DataError
from activelsd.scenery.meshes import Axis, upright

ENDINGS = frozenset({".npy", ".pcd", ".pts", ".xyz"})
"""Endings of files that hold points, whatever is beside them. A `.ply` may be a mesh, and a `.txt` notes."""

UNIT = 0.01
"""How far from 1 the length of a normal may be."""


class Points(NamedTuple):
    """A point cloud, in any unit and about any origin."""

    positions: NDArray[np.float64]  # (N, 3) x, y, z
    normals: NDArray[np.float64] | None  # (N, 3) of unit length and either sign, where the file has them

    def turned(self, up: Axis) -> Points:
        """The same turned so that its axis `up` becomes z."""
        normals = None if self.normals is None else upright(self.normals, up)
        return Points(upright(self.positions, up), normals)


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
        raise DataError(f"{name} has a point, number {first}, that is not finite; remove such points.")
    return Points(positions, _normals(table[:, 3:6]))


def has_faces(data: bytes) -> bool:
    """Whether the header of a PLY file, which may be cut short behind it, says that it holds faces."""
    header = data.partition(b"end_header")[0]
    return re.search(rb"^\s*element\s+(?:face|tristrips)\s+0*[1-9]", header, re.MULTILINE) is not None


def _normals(columns: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The columns (N, 3) if they are normals; None if they are something else, such as colours."""
    if columns.shape[1] < 3:
        return None
    with np.errstate(all="ignore"):
        lengths = np.sqrt(np.square(columns).sum(axis=1, keepdims=True))
        return columns / lengths if (np.abs(lengths - 1) <= UNIT).all() else None


def _from_ply(data: bytes, name: str) -> NDArray[np.float64]:
    if has_faces(data):
        raise DataError(f"{name} has faces, but other files here only have points; keep the one kind.")
    vertices = ply.elements(data, name).get("vertex", {})
    single = {label: own for label, own in vertices.items() if isinstance(own, np.ndarray)}
    return columns.table(single, name)


_READERS: Mapping[str, Callable[[bytes, str], NDArray[np.float64]]] = {
    ".npy": npy.read,
    ".pcd": pcd.read,
    ".ply": _from_ply,
    ".pts": text.read,
    ".txt": text.read,
    ".xyz": text.read,
}
