"""Texts with a point in each row: `.xyz`, `.pts`, `.txt`, as many programs write them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.text import numbers, plain_nan, rows, shown
from activelsd.envs.modelnet.point_formats import columns
from activelsd.errors import DataError

_COMMENT = re.compile(rb"(?:#|//)[^\n]*")
_BETWEEN = re.compile(rb"[\s,;]+")
_WORDS = re.compile(rb"[^\s,;][ \t]+[^\s,;]")
"""Two words with nothing but space between them."""


def read(data: bytes, name: str) -> NDArray[np.float64]:
    """The numbers of all rows, between spaces, commas or semicolons, or x, y, z and normals if named.

    The first line may be the number of points, as in .pts files, or the names of the columns, also as a
    comment. Other comments begin with # or //.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: rows differ in length, or hold something else than numbers.
    """
    text = plain_nan(data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").strip())
    labels = _labels(text.partition(b"\n")[0])
    lines = [line for line in map(bytes.strip, _COMMENT.sub(b"", text).split(b"\n")) if line]
    if labels and lines and numbers(_BETWEEN.sub(b" ", lines[0])) is None:
        lines = lines[1:]
    if lines and lines[0].isdigit():
        count, lines = lines[0][:20].decode(), lines[1:]
        if int(count) != len(lines):
            raise DataError(f"{name} has {len(lines)} of {count} points; copy it again or remove it.")
    if not lines:
        raise DataError(f"{name} has no points, so there is nothing to see; remove it.")
    values, widths = rows(_with_spaces(lines, name), name)
    width = int(widths[0])
    if (widths != width).any():
        odd = shown(lines[int((widths != width).argmax())])
        raise DataError(f"{name} has {width} numbers in its first row, but not in '{odd}'; mend that row.")
    table = values.reshape(len(lines), width)
    if len(labels) != width:
        return table
    return columns.table(dict(zip(labels, table.T, strict=True)), name)


def _labels(line: bytes) -> list[str]:
    """The names of columns in a line, x, y and z among them; none if it holds something else."""
    words = _BETWEEN.split(line.lstrip(b"#/ \t").strip().lower())
    return [word.decode("latin-1") for word in words] if {b"x", b"y", b"z"} <= set(words) else []


def _with_spaces(lines: Sequence[bytes], name: str) -> Sequence[bytes]:
    """The rows with spaces in place of the commas or semicolons between numbers."""
    mark = next((mark for mark in (b";", b",") if mark in lines[0]), None)
    if mark is None:
        return lines
    for line in lines:
        if _WORDS.search(line) or (mark == b";" and b"," in line):
            raise DataError(
                f"{name} has '{shown(line)}', where commas may be decimal; save it with decimal points and"
                " spaces between numbers."
            )
        if not all(map(bytes.strip, line.split(mark))):
            raise DataError(f"{name} has '{shown(line)}', where a number is missing; mend that row.")
    return [line.replace(mark, b" ") for line in lines]
