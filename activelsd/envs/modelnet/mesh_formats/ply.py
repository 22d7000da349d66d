"""PLY, ASCII and binary: http://paulbourke.net/dataformats/ply/. Elements in any order, of any properties."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.surface import Surface, ranges
from activelsd.envs.modelnet.mesh_formats.text import numbers, shown
from activelsd.errors import DataError

_HEADER = re.compile(
    rb"ply[ \t]*(\r\n|\r|\n)(.*?)(?:(?<=\n)|(?<=\r))[ \t]*end_header[ \t]*(?=[\r\n]|$)", re.DOTALL
)
_FORMATS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_TYPES = {
    **{b"char": "i1", b"uchar": "u1", b"short": "i2", b"ushort": "u2", b"int": "i4", b"uint": "u4"},
    **{b"int8": "i1", b"uint8": "u1", b"int16": "i2", b"uint16": "u2", b"int32": "i4", b"uint32": "u4"},
    **{b"float": "f4", b"double": "f8", b"float32": "f4", b"float64": "f8", b"int64": "i8", b"uint64": "u8"},
}
_INDICES = ("vertex_indices", "vertex_index")


class Property(NamedTuple):
    """A property of an element: one value each, or a list of any length."""

    name: str
    type: np.dtype[Any]
    length: np.dtype[Any] | None  # of what stands before a list; None for one value


class Lists(NamedTuple):
    """A list for each row of an element."""

    values: NDArray[Any]  # (K,) list after list
    sizes: NDArray[np.int64]  # (N,)


Columns: TypeAlias = Mapping[str, "NDArray[Any] | Lists"]
"""The properties of an element by name, each of all rows."""


def read(data: bytes, name: str) -> Surface:
    """All vertices and all faces of a PLY file, those in triangle strips too.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is no PLY file of faces, or holds less than its header says.
    """
    found = elements(data, name)
    points = _points(found.get("vertex", {}), name)
    faces = _lists(found.get("face", {}), name, "faces")
    strips = _strips(_lists(found.get("tristrips", {}), name, "strips"))
    corners = np.concatenate([faces.values.astype(np.float64), strips.astype(np.float64).ravel()])
    return Surface(points, corners, np.append(faces.sizes, np.full(len(strips), 3)))


def elements(data: bytes, name: str) -> dict[str, Columns]:
    """The columns of every element of a PLY file, by the element's name.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is no PLY file, or its body is not what its header says.
    """
    header = _HEADER.match(data.removeprefix(b"\xef\xbb\xbf"))
    if header is None:
        raise DataError(f"{name} has no whole header of PLY; copy it again or remove it.")
    order, declared = _declared(header[2].splitlines(), name)
    body = data.removeprefix(b"\xef\xbb\xbf")[header.end() :]
    if order:
        body = body[len(header[1]) :]
    else:  # the numbers of a text, as if it were a binary file of doubles
        values = numbers(body)
        if values is None:
            raise DataError(f"{name} has something else where numbers belong; copy it again or remove it.")
        body = values.astype("<f8").tobytes()
    found: dict[str, Columns] = {}
    at = 0
    for element, (count, properties) in declared.items():
        if properties:
            found[element], at = _columns(body, at, element, count, properties, name)
    if not order and at < len(body):
        raise DataError(
            f"{name} holds more numbers than its header promises; mend the header or copy it again."
        )
    return found


def _declared(lines: Sequence[bytes], name: str) -> tuple[str, dict[str, tuple[int, list[Property]]]]:
    """The byte order, empty for a text, and of each element how many rows there are and of what."""
    order: str | None = None
    declared: dict[str, tuple[int, list[Property]]] = {}
    properties: list[Property] = []
    for line in lines:
        match line.split():
            case [b"format", form, _] if form in _FORMATS and order is None:
                order = _FORMATS[form]
            case [b"element", element, count] if (
                count.isdigit()
                and len(count) < 19
                and order is not None
                and shown(element).lower() not in declared
            ):
                properties = []
                declared[shown(element).lower()] = (int(count), properties)
            case [b"property", b"list", length, kind, label] if {length, kind} <= _TYPES.keys() and declared:
                types = [np.dtype(f"{order}{_TYPES[t]}" if order else "<f8") for t in (kind, length)]
                properties.append(Property(label.decode("ascii", "replace").lower(), *types))
            case [b"property", kind, label] if kind in _TYPES and declared:
                one = np.dtype(f"{order}{_TYPES[kind]}" if order else "<f8")
                properties.append(Property(label.decode("ascii", "replace").lower(), one, None))
            case [] | [b"comment" | b"obj_info", *_]:
                pass
            case _:
                raise DataError(
                    f"{name} has '{shown(line.strip())}' in its header, which is not PLY;"
                    " copy it again or save it anew."
                )
    if order is None:
        raise DataError(f"{name} has a header without its format; copy it again or remove it.")
    return order, declared


def _columns(
    body: bytes, at: int, element: str, count: int, properties: Sequence[Property], name: str
) -> tuple[Columns, int]:
    """The columns of an element whose rows begin at a byte of the body, and the byte where they end."""
    held = (len(body) - at) // sum((p.length or p.type).itemsize for p in properties)
    if held < count:
        raise DataError(
            f"{name} ends after {held} of {count} rows of '{element}', if not before;"
            " copy it again or remove it."
        )
    if count == 0:
        none = np.zeros(0, np.int64)
        return {p.name: none if p.length is None else Lists(none, none) for p in properties}, at
    columns = _rows_of_one_size(body, at, count, properties)
    if columns is not None:
        return columns
    starts, sizes, end = _walk(body, at, element, count, properties, name)
    return _gathered(body, starts, sizes, properties), end


def _rows_of_one_size(
    body: bytes, at: int, count: int, properties: Sequence[Property]
) -> tuple[Columns, int] | None:
    """See `_columns`: views of the body, if every list is as long in all rows as in the first."""
    lengths: list[int] = []
    places: list[int] = []
    end = at
    for p in properties:
        n = 1
        if p.length is not None:
            if end + p.length.itemsize > len(body):
                return None
            n = _whole(float(np.frombuffer(body, p.length, 1, end)[0]))
            end += p.length.itemsize
        places.append(end)
        lengths.append(n)
        end += n * p.type.itemsize
        if n < 0 or end > len(body):
            return None
    stride = end - at
    if at + count * stride > len(body):
        return None
    columns: dict[str, NDArray[Any] | Lists] = {}
    for p, n, place in zip(properties, lengths, places, strict=True):
        shape, strides = (count, n), (stride, p.type.itemsize)
        values: NDArray[Any] = np.ndarray(shape, p.type, body, place, strides)
        if p.length is None:
            columns[p.name] = values[:, 0]
            continue
        said: NDArray[Any] = np.ndarray((count,), p.length, body, place - p.length.itemsize, (stride,))
        if (said != n).any():
            return None
        columns[p.name] = Lists(values.reshape(-1), np.full(count, n))
    return columns, at + count * stride


def _walk(
    body: bytes, at: int, element: str, count: int, properties: Sequence[Property], name: str
) -> tuple[NDArray[np.int64], list[NDArray[np.int64]], int]:
    """Where each row begins (N,), the length of each of its lists (N,) list by list, and where all end."""
    steps: list[tuple[int, struct.Struct, int]] = []  # bytes before a list, reader of its length, of an item
    skip = 0
    for p in properties:
        if p.length is None:
            skip += p.type.itemsize
        else:
            order = ">" if p.length.byteorder == ">" else "<"
            steps.append((skip, struct.Struct(order + p.length.char), p.type.itemsize))
            skip = 0
    starts = np.zeros(count, np.int64)
    lengths: list[list[int]] = [[] for _ in steps]
    for row in range(count):
        starts[row] = at
        for (before, length, itemsize), own in zip(steps, lengths, strict=True):
            at += before
            if at + length.size > len(body):
                raise _cut(name, row, count, element)
            (said,) = length.unpack_from(body, at)
            n = _whole(said)
            if n < 0:
                raise DataError(f"{name} has a list of {said:g} in '{element}'; copy it again or remove it.")
            own.append(n)
            at += length.size + n * itemsize
        at += skip
        if at > len(body):
            raise _cut(name, row, count, element)
    return starts, [np.array(own, np.int64) for own in lengths], at


def _whole(number: float) -> int:
    """The number as an integer, or -1 if it is none."""
    return int(number) if math.isfinite(number) and number == math.floor(number) else -1


def _gathered(
    body: bytes,
    starts: NDArray[np.int64],
    sizes: Sequence[NDArray[np.int64]],
    properties: Sequence[Property],
) -> Columns:
    """The columns of rows that begin at bytes (N,), with lists of the sizes (N,) given list by list."""
    columns: dict[str, NDArray[Any] | Lists] = {}
    at, lists, ones = starts, iter(sizes), np.ones(len(starts), np.int64)
    for p in properties:
        own = ones if p.length is None else next(lists)
        at = at if p.length is None else at + p.length.itemsize
        values = _items(body, at, own, p.type)
        columns[p.name] = values if p.length is None else Lists(values, own)
        at = at + own * p.type.itemsize
    return columns


def _items(
    body: bytes, starts: NDArray[np.int64], sizes: NDArray[np.int64], kind: np.dtype[Any]
) -> NDArray[Any]:
    """The items (K,) of lists that begin at bytes (N,); one view for each place within a word."""
    values = np.empty(int(sizes.sum()), kind)
    places = np.cumsum(sizes) - sizes
    for phase in range(kind.itemsize):
        own = starts % kind.itemsize == phase
        if own.any():
            view = np.frombuffer(body, kind, (len(body) - phase) // kind.itemsize, phase)
            values[ranges(places[own], sizes[own])] = view[ranges(starts[own] // kind.itemsize, sizes[own])]
    return values


def _cut(name: str, read: int, wanted: int, element: str) -> DataError:
    return DataError(f"{name} ends after {read} of {wanted} rows of '{element}'; copy it again or remove it.")


def _points(vertex: Columns, name: str) -> NDArray[np.float64]:
    """The coordinates (N, 3) of the element `vertex`."""
    columns = [vertex.get(axis) for axis in "xyz"]
    found = [column for column in columns if isinstance(column, np.ndarray)]
    if len(found) < 3:
        raise DataError(f"{name} has no vertices with x, y and z; copy it again or remove it.")
    return np.stack(found, axis=1).astype(np.float64)


def _lists(columns: Columns, name: str, what: str) -> Lists:
    """The indices of faces or strips: the list that is called so, none if there is no such element."""
    if not columns:
        return Lists(np.zeros(0), np.zeros(0, np.int64))
    for column in map(columns.get, _INDICES):
        if isinstance(column, Lists):
            return column
    raise DataError(f"{name} has {what} without a list vertex_indices, so they cannot be read; save it anew.")


def _strips(strips: Lists) -> NDArray[np.float64]:
    """The triangles (T, 3) of strips of indices; -1 ends a strip within a list."""
    values = strips.values.astype(np.float64)
    owner = np.repeat(np.arange(len(strips.sizes)), strips.sizes)
    if len(values) < 3:
        return np.zeros((0, 3))
    windows = np.stack([values[:-2], values[1:-1], values[2:]], axis=1)
    found: NDArray[np.float64] = windows[(owner[2:] == owner[:-2]) & (windows != -1).all(axis=1)]
    return found
