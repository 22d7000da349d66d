"""Meshes from files: OFF as ModelNet has it, by a parser of its own, and what else trimesh reads.

OFF: http://www.geomview.org/docs/html/OFF.html. Many of ModelNet40's files glue the counts to the keyword
(`OFF3514 3546 0`); re-saved copies bring comments, CRLF, polygons and colours.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError
from activelsd.scenery.meshes import Mesh

_HEADER = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?P<kind>[A-Za-z0-9]*?)OFF(?![A-Za-z])\s*(?P<binary>BINARY)?")
_COUNTS = re.compile(rb"\s*(?P<vertices>\d+)\s+(?P<faces>\d+)(?:[ \t]+-?\d+)?[ \t]*(?=[\r\n]|$)")
_COMMENT = re.compile(rb"#[^\r\n]*")
_KINDS = {b"", b"C", b"N", b"CN", b"ST", b"STC", b"STN", b"STCN"}
"""What may stand before OFF: colours, normals, texture. All of it follows x, y, z on a vertex's line."""


def read_mesh(path: Path) -> Mesh:
    """The mesh of a file, in its own axes (ModelNet's z is up) and units.

    Raises:
        DataError: the file is missing, or not a whole mesh.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror}); copy it again or remove it.") from None
    return decode_mesh(data, str(path), beside=path)


def decode_mesh(data: bytes, name: str, *, beside: Path | None = None) -> Mesh:
    """The mesh in a file's bytes; the ending of `name` tells the format.

    Args:
        data: the file.
        name: of the file in messages.
        beside: path of the file if it has one, for formats that refer to files next to it.

    Raises:
        DataError: it is not a whole mesh.
    """
    if PurePosixPath(name).suffix.lower() == ".off":
        return read_off(data, name)
    return _by_trimesh(data, name, beside)


def read_off(data: bytes, name: str) -> Mesh:
    """The mesh of an OFF file: every vertex, used or not, and every face, polygons cut into fans.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: not an ASCII OFF file, cut short, without faces, or with numbers that cannot be.
    """
    header = _HEADER.match(_COMMENT.sub(b"", data[:4096]))
    if header is None:
        what = "is empty" if not data.strip() else "does not begin with OFF"
        raise DataError(f"{name} {what}, so it is no OFF mesh; copy it again or remove it.")
    if header["binary"] or header["kind"] not in _KINDS:
        raise DataError(f"{name} is a binary or four-dimensional OFF; save it as plain ASCII OFF.")
    if b"#" in data:
        data = _COMMENT.sub(b"", data)
        header = _HEADER.match(data)
        assert header is not None
    counts = _COUNTS.match(data, header.end())
    if counts is None:
        raise DataError(f"{name} has no counts of vertices and faces after OFF; copy it again or remove it.")
    n_vertices, n_faces = int(counts["vertices"]), int(counts["faces"])
    if n_faces == 0:
        raise DataError(f"{name} has no faces, so there is nothing to see; remove it.")

    body = data[counts.end() :]
    parsed = None if header["kind"] else _plain_triangles(body, n_vertices, n_faces)
    vertices, faces = parsed or _by_lines(body, n_vertices, n_faces, name)
    return _checked(vertices, faces, name)


def _plain_triangles(
    body: bytes, n_vertices: int, n_faces: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Vertices (N, 3) and faces (M, 3) of a file of just those, the common case; None for any other."""
    values = _numbers(body)
    if values is None or len(values) != 3 * n_vertices + 4 * n_faces:
        return None
    rows = values[3 * n_vertices :].reshape(n_faces, 4)
    if not (rows[:, 0] == 3).all():
        return None
    return values[: 3 * n_vertices].reshape(n_vertices, 3), rows[:, 1:]


def _by_lines(
    body: bytes, n_vertices: int, n_faces: int, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Vertices (N, 3) and faces (M, 3) by the file's lines: x y z and more, n and n indices and more."""
    lines = [line for line in map(bytes.strip, body.splitlines()) if line]
    vertex_rows = _table(lines[:n_vertices], name)
    points = [row[:3] for row in vertex_rows if len(row) >= 3]
    if len(points) < n_vertices:
        raise DataError(_cut(name, len(points), n_vertices, "vertices"))
    fans, read = [], 0
    for block in _blocks(_table(lines[n_vertices : n_vertices + n_faces], name)):
        n = block[0, 0]
        if not (n >= 1 and n == np.floor(n) and np.isfinite(n)):
            raise DataError(f"{name} has a face of {n:g} corners; repair or remove it.")
        if block.shape[1] <= n:
            break
        fans.append(_fan(block[:, 1 : int(n) + 1]))
        read += len(block)
    if read < n_faces:
        raise DataError(_cut(name, read, n_faces, "faces"))
    return np.array(points), np.concatenate(fans)


def _cut(name: str, read: int, wanted: int, what: str) -> str:
    return f"{name} ends after {read} of {wanted} {what}; copy it again or remove it."


def _table(lines: Sequence[bytes], name: str) -> list[NDArray[np.float64]]:
    """The numbers of every line; parsed at once if all lines are alike, which is a hundred times faster."""
    widths = {len(line.split()) for line in lines}
    if len(widths) == 1:
        values = _numbers(b"\n".join(lines))
        if values is not None:
            return list(values.reshape(len(lines), -1))
    rows = []
    for line in lines:
        row = _numbers(line)
        if row is None:
            text = line.decode("ascii", "replace")
            raise DataError(f"{name} has '{text[:40]}' where numbers belong; copy it again or remove it.")
        rows.append(row)
    return rows


def _numbers(text: bytes) -> NDArray[np.float64] | None:
    """The numbers in a text, or None if there is something else in it."""
    if not text.strip():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy before 2.3 so says that it stopped halfway
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def _blocks(rows: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Faces in arrays (m, columns) of one number of corners each: one if all are alike, else one a face."""
    if len({len(row) for row in rows}) == 1:
        table = np.stack(rows)
        if (table[:, 0] == table[0, 0]).all():
            return [table]
    return [row[None] for row in rows]


def _fan(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Triangles (m * (n - 2), 3) of polygons (m, n): a b c d gives a b c and a c d; points and lines none."""
    if polygons.shape[1] < 3:
        return np.zeros((0, 3))
    first = np.broadcast_to(polygons[:, :1], (len(polygons), polygons.shape[1] - 2))
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2).reshape(-1, 3)


def _checked(vertices: NDArray[np.float64], faces: NDArray[np.float64], name: str) -> Mesh:
    """The mesh, if its faces are of vertices it has and its coordinates are numbers."""
    if len(faces) == 0:
        raise DataError(f"{name} has no faces, so there is nothing to see; remove it.")
    wrong = faces[(faces < 0) | (faces >= len(vertices)) | (faces != np.floor(faces))]
    if len(wrong):
        raise DataError(
            f"{name} has a face of vertex {wrong[0]:g}, but its {len(vertices)} vertices are numbered from 0;"
            " repair or remove it."
        )
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused as that
        points = vertices.astype(np.float32)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise DataError(f"{name} has a vertex, number {first}, that is not finite; repair or remove it.")
    return Mesh(points, faces.astype(np.int32))


def check_format(ending: str, example: str) -> None:
    """Refuse a format that nothing here reads, before any file of it is met.

    Args:
        ending: with its dot, in lower case.
        example: a file that has it.

    Raises:
        DataError: neither this module nor trimesh reads such files.
    """
    if ending == ".off":
        return
    import trimesh  # ModelNet's own files do without it, and it is slow to import

    if ending.removeprefix(".") not in trimesh.available_formats():
        raise DataError(f"{example} is in no format that can be read here; convert it to OFF or remove it.")


def _by_trimesh(data: bytes, name: str, beside: Path | None) -> Mesh:
    """A mesh in any other format; the parts of a scene are put together."""
    import trimesh  # as above

    ending = PurePosixPath(name).suffix.lower().removeprefix(".")
    try:
        resolver = trimesh.resolvers.FilePathResolver(str(beside)) if beside else None
        loaded: Any = trimesh.load(
            io.BytesIO(data), file_type=ending, resolver=resolver, force="mesh", process=False
        )
        vertices, faces = np.array(loaded.vertices, np.float64), np.array(loaded.faces, np.float64)
    except Exception as error:  # noqa: BLE001  its many readers raise what they like on a broken file
        raise DataError(f"{name} cannot be read as .{ending} ({_brief(error)}); convert it to OFF.") from None
    return _checked(vertices.reshape(-1, 3), faces.reshape(-1, 3), name)


def _brief(error: Exception) -> str:
    """The first line of what another library has to say, short enough for one sentence."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:80].rstrip(".")
