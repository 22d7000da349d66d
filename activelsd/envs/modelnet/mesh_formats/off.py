"""OFF: http://www.geomview.org/docs/html/OFF.html.

Many of ModelNet40's files glue the counts to the keyword (`OFF3514 3546 0`); re-saved copies bring comments,
CRLF, polygons and colours, and MeshLab's bring normals and colours of vertices (`NCOFF`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.surface import Surface, ranges
from activelsd.envs.modelnet.mesh_formats.text import numbers, plain_nan, rows
from activelsd.errors import DataError

_HEADER = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*(?P<kind>[A-Za-z0-9]*?)(?:OFF|off)(?![A-Za-z])\s*(?P<binary>BINARY)?"
)
_COUNTS = re.compile(rb"\s*(?P<vertices>\d{1,18})\s+(?P<faces>\d{1,18})(?:[ \t]+-?\d+)?[ \t]*(?=[\r\n]|$)")
_COMMENT = re.compile(rb"#[^\r\n]*")
_KIND = re.compile(rb"(?:ST|C|N)*")
"""What may stand before OFF: texture, colours, normals. All of it follows x, y, z on a vertex's line."""


def read(data: bytes, name: str) -> Surface:
    """Every vertex, used or not, and every face of an OFF file.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is no ASCII OFF file, or holds less or more than it says.
    """
    header = _HEADER.match(_COMMENT.sub(b"", data[:4096]))
    if header is not None and header["binary"]:
        raise DataError(f"{name} is a binary OFF; save it as plain ASCII OFF.")
    if header is not None and not _KIND.fullmatch(header["kind"]):
        raise DataError(f"{name} is an OFF of four or more dimensions; save it as plain OFF.")
    if b"#" in data:
        data = _COMMENT.sub(b"", plain_nan(data))  # there is a # in 1.#IND too
    header = _HEADER.match(data)
    body = data[header.end() :] if header else data.removeprefix(b"\xef\xbb\xbf")
    counts = _COUNTS.match(body)  # the keyword may be left out, says the format
    if counts is None and header is None:
        raise DataError(f"{name} does not begin with OFF, so it is no OFF mesh; copy it again or remove it.")
    if counts is None:
        raise DataError(f"{name} has no counts of vertices and faces after OFF; copy it again or remove it.")
    n_vertices, n_faces = int(counts["vertices"]), int(counts["faces"])
    if n_faces == 0:
        raise DataError(f"{name} has no faces, so there is nothing to see; remove it.")
    body = body[counts.end() :]
    plain = not (header and header["kind"])
    surface = _plain_triangles(body, n_vertices, n_faces) if plain else None
    if surface is not None:
        return surface
    lines = [line for line in body.splitlines() if line.strip()]
    if plain and len(lines) != n_vertices + n_faces:
        surface = _in_any_lines(body, n_vertices, n_faces)
    return surface or _by_lines(lines, n_vertices, n_faces, name)


def _plain_triangles(body: bytes, n_vertices: int, n_faces: int) -> Surface | None:
    """The surface of a file of just vertices and triangles, the common case; None for any other."""
    values = numbers(body)
    if values is None or len(values) != 3 * n_vertices + 4 * n_faces:
        return None
    faces = values[3 * n_vertices :].reshape(n_faces, 4)
    if not (faces[:, 0] == 3).all():
        return None
    return Surface(values[: 3 * n_vertices].reshape(-1, 3), faces[:, 1:].ravel(), np.full(n_faces, 3))


def _in_any_lines(body: bytes, n_vertices: int, n_faces: int) -> Surface | None:
    """The surface of numbers in lines of any length; None if there are others than vertices and faces."""
    values = numbers(body)
    if values is None:
        return None
    for first in (0, 1):  # the number of edges may stand in a line of its own
        at = first + 3 * n_vertices
        starts: list[int] = []
        while len(starts) < n_faces and at < len(values) and values[at] >= 1 and values[at].is_integer():
            starts.append(at + 1)
            at += 1 + int(values[at])
        if len(starts) == n_faces and at == len(values):
            begins = np.array(starts)
            sizes = values[begins - 1].astype(np.int64)
            return Surface(
                values[first : first + 3 * n_vertices].reshape(-1, 3), values[ranges(begins, sizes)], sizes
            )
    return None


def _by_lines(lines: Sequence[bytes], n_vertices: int, n_faces: int, name: str) -> Surface:
    """The surface by the file's lines: x y z and more, n and n indices and more."""
    values, widths = rows(lines[:n_vertices], name)
    whole = np.flatnonzero(widths < 3)
    if len(whole) or len(widths) < n_vertices:
        raise DataError(_cut(name, int(whole[0]) if len(whole) else len(widths), n_vertices, "vertices"))
    points = values[(np.cumsum(widths) - widths)[:, None] + np.arange(3)]

    values, widths = rows(lines[n_vertices : n_vertices + n_faces], name)
    starts = np.cumsum(widths) - widths
    said = values[starts]
    _check_sizes(said, name)
    short = np.flatnonzero(said > widths - 1)
    if len(short) or len(widths) < n_faces:
        raise DataError(_cut(name, int(short[0]) if len(short) else len(widths), n_faces, "faces"))
    if len(lines) > n_vertices + n_faces:
        raise DataError(
            f"{name} goes on after the {n_vertices} vertices and {n_faces} faces that its second line"
            " promises; mend the counts there or copy it again."
        )
    sizes = said.astype(np.int64)
    return Surface(points, values[ranges(starts + 1, sizes)], sizes)


def _check_sizes(sizes: NDArray[np.float64], name: str) -> None:
    wrong = sizes[~((sizes >= 1) & (sizes == np.floor(sizes)) & np.isfinite(sizes))]
    if len(wrong):
        raise DataError(f"{name} has a face of {wrong[0]:g} corners; repair or remove it.")


def _cut(name: str, read: int, wanted: int, what: str) -> str:
    return f"{name} ends after {read} of {wanted} {what}; copy it again or remove it."
