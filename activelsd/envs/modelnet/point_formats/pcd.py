"""PCD, in text or binary: https://pointclouds.org/documentation/tutorials/pcd_file_format.html."""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.text import numbers, plain_nan, shown
from activelsd.envs.modelnet.point_formats import columns
from activelsd.errors import DataError

_DATA = re.compile(rb"^[ \t]*DATA[ \t]+(\w+)[ \t]*(?:\r\n|\n|\r|$)", re.MULTILINE)
_COMMENT = re.compile(rb"#[^\r\n]*")
_TYPES = {b"F": "248", b"I": "1248", b"U": "1248"}
"""Sizes in bytes that a type may have."""


def read(data: bytes, name: str) -> NDArray[np.float64]:
    """The points of a PCD file and their normals, if it has any.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is no such file, is compressed, or does not hold as many points as its header says.
    """
    data_line = _DATA.search(data)
    if data_line is None:
        raise DataError(f"{name} has no whole header of PCD; copy it again or remove it.")
    form, body = data_line[1], data[data_line.end() :]
    if form not in (b"ascii", b"binary"):
        raise DataError(f"{name} is PCD with {shown(form)} data, which is not read; save it as binary PCD.")
    lines = [line.split() for line in _COMMENT.sub(b"", data[: data_line.start()]).splitlines()]
    header = {words[0]: words[1:] for words in lines if words}
    try:
        labels = [label.decode("ascii").lower() for label in header[b"FIELDS"]]
        record = _record(header, len(labels), text=form == b"ascii")
        count = int(header[b"POINTS"][0])
        sides = [int(header[key][0]) for key in (b"WIDTH", b"HEIGHT") if key in header]
    except (KeyError, IndexError, TypeError, ValueError):
        raise DataError(f"{name} has a broken header of PCD; copy it again or save it anew.") from None
    if sides and math.prod(sides) != count:
        raise DataError(
            f"{name} has {count} points by its header, and {' x '.join(map(str, sides))} by its width and"
            " height; mend the header or save it anew."
        )
    if form == b"ascii":
        values = numbers(plain_nan(body))
        if values is None:
            raise DataError(f"{name} has something else where numbers belong; copy it again or remove it.")
        body = values.tobytes()
    if len(body) != count * record.itemsize:
        held = len(body) / record.itemsize
        raise DataError(f"{name} holds {held:g} of {count} points; copy it again or remove it.")
    table = np.frombuffer(body, record)
    found = {label: table[str(i)][:, 0] for i, label in enumerate(labels) if record[i].shape == (1,)}
    return columns.table(found, name)


def _record(header: dict[bytes, list[bytes]], fields: int, *, text: bool) -> np.dtype[np.void]:
    """What a point is in a binary file, or of float64 in a text; fields are called by their number.

    Raises:
        ValueError: the header has another number of sizes, types or counts, or impossible ones.
        KeyError: it has none.
    """
    counts = header.get(b"COUNT", [b"1"] * fields)
    parts: list[tuple[str, str, tuple[int]]] = []
    for kind, size, count in zip(header[b"TYPE"], header[b"SIZE"], counts, strict=True):
        if size.decode() not in _TYPES[kind] or not 1 <= int(count) <= 4096:
            raise ValueError
        form = "<f8" if text else f"<{kind.decode().lower()}{size.decode()}"
        parts.append((str(len(parts)), form, (int(count),)))
    if len(parts) != fields or not fields:
        raise ValueError
    return np.dtype(parts)
