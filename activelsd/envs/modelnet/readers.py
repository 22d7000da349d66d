"""Reads meshes from files: OFF, OBJ, PLY, STL and glTF. A file that would be read in part is refused.

Each format has a parser in `mesh_formats`. Reading takes no more memory than about 200 times the size of the
file, whatever it says of itself.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import PurePosixPath

import numpy as np

from activelsd.envs.modelnet.files import Folder, Zip
from activelsd.envs.modelnet.mesh_formats import gltf, gltf_file, obj, off, ply, stl
from activelsd.envs.modelnet.mesh_formats.polygons import triangles
from activelsd.envs.modelnet.mesh_formats.surface import Surface
from activelsd.errors import DataError
from activelsd.scenery.meshes import Axis, Mesh, upright

_PARSERS: dict[str, Callable[[bytes, str], Surface]] = {
    ".off": off.read,
    ".obj": obj.read,
    ".ply": ply.read,
    ".stl": stl.read,
}
_GLTF = (".gltf", ".glb")

_FOREIGN = {
    "a zip archive": (b"pk\3\4",),
    "another archive": (b"\x1f\x8b", b"rar!", b"7z\xbc\xaf", b"bzh", b"\xfd7zxz"),
    "a web page": (b"<!doctype", b"<html"),
    "XML": (b"<?xml",),
    "the pointer of a file in Git LFS": (b"version https://git-lfs",),
    "a PDF": (b"%pdf",),
    "a picture": (b"\x89png", b"\xff\xd8\xff", b"gif8"),
    "HDF5": (b"\x89hdf",),
    "text in UTF-16": (b"\xff\xfe", b"\xfe\xff"),
    "an OFF mesh": (b"off",),
    "a PLY mesh": (b"ply",),
    "an STL mesh": (b"solid",),
    "a GLB mesh": (b"gltf\2\0",),
}
"""What is met under endings of meshes by mistake, and how it begins, in lower case."""

_FAR = 64
"""Distance from the origin, in extents of the object, from which float32 would be too coarse for it."""

_LARGEST = float(np.finfo(np.float32).max)


def check_format(ending: str, example: str) -> None:
    """Refuse a format that nothing here reads, before any file of it is met.

    Args:
        ending: with its dot, in lower case.
        example: a file that has it.

    Raises:
        DataError: there is no parser for such files.
    """
    if ending not in _PARSERS and ending not in _GLTF:
        raise DataError(
            f"{example} is in no format that can be read here (OFF, OBJ, PLY, STL and glTF are);"
            " convert it to OFF or remove it."
        )


def read_mesh(files: Folder | Zip, path: str, up: Axis | None = None) -> Mesh:
    """The mesh in a file of a dataset, turned so that z is up, in its own unit.

    Args:
        files: the dataset's.
        path: of the file, from their root.
        up: its axis that points up; None: the one its format says or, if it says nothing, z.

    Raises:
        DataError: the file, or another that it refers to, cannot be read or is not whole.
    """
    name, data = files.where(path), files.read(path)
    return decode_mesh(data, name, up, beside=lambda other: files.read(gltf_file.resolved(path, other)))


def decode_mesh(
    data: bytes, name: str, up: Axis | None = None, *, beside: gltf_file.Beside | None = None
) -> Mesh:
    """The mesh in a file's bytes; the ending of `name` tells the format.

    Args:
        data: the file.
        name: of the file in messages.
        up: see `read_mesh`.
        beside: reads the files that this one refers to; None: it must not.

    Raises:
        DataError: it is not a whole mesh.
    """
    ending = PurePosixPath(name).suffix.lower()
    check_format(ending, name)
    if not data.strip(b"\0 \t\r\n"):
        nothing = "holds nothing but zeros" if b"\0" in data else "is empty"
        raise DataError(f"{name} {nothing}, so it is no mesh; copy it again or remove it.")
    try:
        surface = gltf.read(data, name, beside or _alone) if ending in _GLTF else _PARSERS[ending](data, name)
    except DataError:
        what = _foreign(data, ending)
        if what is None:
            raise
        raise DataError(
            f"{name} is {what} under the ending {ending}; put the mesh there or remove it."
        ) from None
    mesh = _checked(surface, name)
    return mesh._replace(vertices=upright(mesh.vertices, up or says_up(name)))


def says_up(path: str) -> Axis:
    """The axis that points up by a file's format, or as in ModelNet if the format says nothing."""
    return "y" if PurePosixPath(path).suffix.lower() in _GLTF else "z"


def other_files(files: Folder | Zip, path: str) -> list[str]:
    """Paths, from the dataset's root, of the files that the mesh at a path needs besides its own."""
    if PurePosixPath(path).suffix.lower() not in _GLTF:
        return []
    with suppress(DataError):  # said when the mesh is read
        others = gltf_file.other_files(lambda size: files.head(path, size))
        return [gltf_file.resolved(path, other) for other in others]
    return []


def _alone(other: str) -> bytes:
    raise DataError(f"A mesh refers to {other[:80]}, which cannot be read from here.")


def _foreign(data: bytes, ending: str) -> str | None:
    """What a file that is no mesh of its ending is instead, if that can be told."""
    begin = data[:64].removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    kinds = (what for what, begins in _FOREIGN.items() if begin.startswith(begins))
    what = next(kinds, None)
    return None if what and ending[1:].upper() in what.split() else what


def _checked(surface: Surface, name: str) -> Mesh:
    """The mesh, if its faces are of vertices it has and their coordinates are numbers.

    An object far from the origin is centred before it is rounded to float32.
    """
    points, corners, sizes = surface
    if sizes.max(initial=0) < 3:
        raise DataError(f"{name} has no faces, so there is nothing to see; remove it.")
    with np.errstate(invalid="ignore"):
        whole = corners.astype(np.int64)
    if not (corners.min() >= 0 and corners.max() < len(points) and (whole == corners).all()):
        wrong = corners[~((corners >= 0) & (corners < len(points)) & (corners == np.floor(corners)))]
        raise DataError(
            f"{name} has a face of vertex {wrong[0]:g}, but its {len(points)} vertices are numbered from 0;"
            " repair or remove it."
        )
    is_used = np.zeros(len(points), np.bool_)
    is_used[whole] = True
    used = points[is_used]
    low, high = used.min(axis=0), used.max(axis=0)
    far, extent = max(-low.min(), high.max()), (high - low).max()
    if not far < _LARGEST:  # NaN neither
        first = np.flatnonzero(is_used)[np.argmin((np.abs(used) < _LARGEST).all(axis=1))]
        raise DataError(f"{name} has a vertex, number {first}, that is not finite; repair or remove it.")
    faces = triangles(Surface(points, whole, sizes)).astype(np.int32)
    with np.errstate(over="ignore", invalid="ignore"):  # in vertices that no face uses
        return Mesh((points - (low + high) / 2 if far > _FAR * extent else points).astype(np.float32), faces)
