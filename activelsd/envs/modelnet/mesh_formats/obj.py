"""Polygons of Wavefront OBJ: http://paulbourke.net/dataformats/obj/. Lines and points are not seen."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.surface import Surface
from activelsd.envs.modelnet.mesh_formats.text import plain_nan, rows, shown
from activelsd.errors import DataError

_COMMENT = re.compile(rb"#[^\n]*")
_CONTINUED = re.compile(rb"\\[ \t]*\n")
_OTHER_INDICES = re.compile(rb"(?<=\d)/(?:[+-]?\d+)?(?:/(?:[+-]?\d+)?)?(?![^\s])")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_]*")
_REFUSED = {
    **dict.fromkeys((b"surf", b"bzp", b"bsp", b"cdc", b"cdp"), "free-form surfaces"),
    **dict.fromkeys((b"call", b"csh"), "parts in other files"),
}
"""Statements that add to what is seen, and are not read."""


def read(data: bytes, name: str) -> Surface:
    """All vertices and all faces of an OBJ file, whatever its groups.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is no OBJ file, or has a face or a part that cannot be read.
    """
    text = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"#" in text:
        text = _COMMENT.sub(b"", plain_nan(text))  # there is a # in 1.#IND too
    if b"\\" in text:
        text = _CONTINUED.sub(b" ", text)
    vertices: list[bytes] = []
    faces: list[bytes] = []
    before: list[int] = []  # vertices that each face may count back from
    for line in text.split(b"\n"):
        word, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
        if word == b"v":
            vertices.append(rest)
        elif word in (b"f", b"fo"):
            faces.append(rest)
            before.append(len(vertices))
        elif word:
            _check_statement(word, line, name)
    if not vertices and not faces:
        raise DataError(
            f"{name} has no vertices and no faces, so it is no OBJ mesh; copy it again or remove it."
        )
    points = _points(vertices, name)
    corners, sizes = _polygons(faces, np.array(before, np.int64), len(points), name)
    if len(sizes) and sizes[-1] < 3 and not data.endswith((b"\n", b"\r")):
        raise DataError(f"{name} ends within a face; copy it again or remove it.")
    return Surface(points, corners, sizes)


def _check_statement(word: bytes, line: bytes, name: str) -> None:
    """Refuse a line that is no statement of OBJ, or one of a part that would be lost."""
    if word in _REFUSED:
        raise DataError(
            f"{name} has {_REFUSED[word]} ({word.decode()}), which are not read; save it as polygons."
        )
    if not _WORD.fullmatch(word) or word in (b"V", b"F"):
        raise DataError(
            f"{name} has a line '{shown(line.strip())}', which is not OBJ; copy it again or remove it."
        )


def _points(lines: Sequence[bytes], name: str) -> NDArray[np.float64]:
    """The first three numbers (N, 3) of every vertex; a weight or a colour may follow."""
    values, widths = rows(lines, name)
    short = np.flatnonzero(widths < 3)
    if len(short):
        raise DataError(
            f"{name} has a vertex, number {short[0] + 1}, of {widths[short[0]]} coordinates;"
            " copy it again or remove it."
        )
    points: NDArray[np.float64] = values[(np.cumsum(widths) - widths)[:, None] + np.arange(3)]
    return points


def _polygons(
    lines: Sequence[bytes], before: NDArray[np.int64], n_points: int, name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Indices from 0 (K,) of all faces, and how many each has (M,); negative ones count back from it."""
    text = b"\n".join(lines)
    if b"/" in text:
        lines = _OTHER_INDICES.sub(b"", text).split(b"\n")
    values, sizes = rows(lines, name)
    if (values == 0).any():
        raise DataError(f"{name} has a face of vertex 0, but OBJ counts from 1; repair or remove it.")
    corners = np.where(values > 0, values - 1, values + np.repeat(before, sizes))
    wrong = np.flatnonzero(~((corners >= 0) & (corners < n_points)))
    if len(wrong):
        raise DataError(
            f"{name} has a face of vertex {values[wrong[0]]:g}, but {n_points} vertices;"
            " copy it again or remove it."
        )
    return corners, sizes
