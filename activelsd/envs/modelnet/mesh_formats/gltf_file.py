"""The container of glTF 2.0, text or binary: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.

Its JSON, its buffers, which may lie in files beside it, and the accessors that give arrays from them.
"""

from __future__ import annotations

import base64
import binascii
import json
import posixpath
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import DataError

Beside = Callable[[str], bytes]
"""Reads a file by its path relative to the mesh's folder. Raises DataError if it cannot be read."""

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Invalid(Exception):
    """Raised when a document is not as glTF has it; the message goes on from the file's name."""


class Document:
    """A glTF file that is read.

    Attributes:
        json: its JSON.
        size: bytes of its buffers, those in other files too.
    """

    def __init__(self, data: bytes, beside: Beside) -> None:
        self.json, self._binary = parsed(data)
        self._beside = beside
        self._buffers: dict[str | None, bytes] = {}
        self._arrays: dict[int, NDArray[Any]] = {}
        self.size = len(data)

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """The entry of a list at the top of the JSON. Raises Invalid if there is none."""
        known = self.json.get(kind, [])
        if not (isinstance(index, int) and isinstance(known, list) and 0 <= index < len(known)):
            raise Invalid(f"refers to number {str(index)[:20]} of its {kind}, which is not there")
        entry = known[index]
        if not isinstance(entry, dict):
            raise Invalid(f"has something else among its {kind}")
        return entry

    def array(self, index: Any) -> NDArray[Any]:
        """The values of an accessor: (N, width), floats if they are normalised.

        Raises:
            Invalid: it is not whole.
            DataError: the file that holds it cannot be read.
        """
        if index not in self._arrays:
            self._arrays[index] = self._array(self.item("accessors", index))
        return self._arrays[index]

    def _array(self, accessor: Mapping[str, Any]) -> NDArray[Any]:
        count, width = _natural(accessor, "count"), _WIDTHS[accessor["type"]]
        kind = np.dtype(_COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._strided(accessor, count, width, kind)
        else:
            sparse = accessor.get("sparse")
            if not sparse or count > max(self.size, 1 << 20):
                raise Invalid("has an accessor without data")
            values = np.zeros((count, width), kind)
        if "sparse" in accessor:
            values = self._with_sparse(values.copy(), accessor["sparse"])
        if accessor.get("normalized"):
            return np.maximum(values.astype(np.float64) / np.iinfo(kind).max, -1.0)
        return values

    def _strided(self, place: Mapping[str, Any], count: int, width: int, kind: np.dtype[Any]) -> NDArray[Any]:
        """Values (count, width) in the buffer view of an accessor, or of one of the parts of a sparse one."""
        view = self.item("bufferViews", place["bufferView"])
        buffer = self._buffer(view["buffer"])
        begin, length = _natural(view, "byteOffset", 0), _natural(view, "byteLength")
        first, step = _natural(place, "byteOffset", 0), _natural(view, "byteStride", width * kind.itemsize)
        if begin + length > len(buffer) or first + (count - 1) * step + width * kind.itemsize > length:
            raise Invalid("is cut short: an accessor goes on after the end of its buffer")
        if count and step < width * kind.itemsize:
            raise Invalid("has accessors whose values overlap")
        values: NDArray[Any] = np.ndarray((count, width), kind, buffer, begin + first, (step, kind.itemsize))
        return values

    def _with_sparse(self, values: NDArray[Any], sparse: Mapping[str, Any]) -> NDArray[Any]:
        count, where = _natural(sparse, "count"), sparse["indices"]
        index_type = np.dtype(_COMPONENTS[where["componentType"]])
        places = self._strided(where, count, 1, index_type)[:, 0]
        if count and not (places.min() >= 0 and places.max() < len(values)):
            raise Invalid("has a sparse accessor of values that are not there")
        values[places] = self._strided(sparse["values"], count, values.shape[1], values.dtype)
        return values

    def _buffer(self, index: Any) -> bytes:
        buffer = self.item("buffers", index)
        length, uri = _natural(buffer, "byteLength"), buffer.get("uri")
        if uri not in self._buffers:
            data = self._binary if uri is None else self._content(uri)
            if data is None or (uri is None and index != 0):
                raise Invalid("has a buffer without data, as compressed files have")
            self._buffers[uri] = data
            self.size += len(data)
        data = self._buffers[uri]
        if len(data) < length:
            what = f"{uri[:80]} beside it" if uri and not uri.startswith("data:") else "its buffer"
            raise Invalid(f"is cut short: {what} holds {len(data)} of {length} bytes")
        return data

    def _content(self, uri: str) -> bytes:
        if not uri.startswith("data:"):
            return self._beside(unquote(uri))
        head, _, text = uri.partition(",")
        if not head.endswith(";base64"):
            raise Invalid("has a buffer in its text that is not base64")
        try:
            return base64.b64decode(text, validate=True)
        except (binascii.Error, ValueError):
            raise Invalid("has a buffer in its text that is not base64") from None


def parsed(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a text or binary glTF, and the bytes that a binary one brings along.

    Raises:
        Invalid: it is neither.
    """
    text, binary = data, None
    if data[:4] == b"glTF":
        version, length = (int.from_bytes(data[i : i + 4], "little") for i in (4, 8))
        if version != 2:
            raise Invalid(f"is glTF of version {version}, and 2 is read")
        if len(data) < max(length, 20):
            raise Invalid(f"is cut short: it holds {len(data)} of {length} bytes")
        end = 20 + int.from_bytes(data[12:16], "little")
        if data[16:20] != b"JSON" or end > length:
            raise Invalid("has no JSON as its first part")
        text = data[20:end]
        if data[end + 4 : end + 8] == b"BIN\0":
            size = int.from_bytes(data[end : end + 4], "little")
            if end + 8 + size > length:
                raise Invalid("is cut short: its binary part goes on after its end")
            binary = data[end + 8 : end + 8 + size]
    return _document(text), binary


def _document(text: bytes) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        raise Invalid("has no whole JSON") from None
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise Invalid("is JSON, but not of glTF 2")
    version = str(document["asset"].get("version"))
    if version.partition(".")[0] != "2":
        raise Invalid(f"is glTF of version {version[:20]}, and 2 is read")
    return document


def other_files(head: Callable[[int], bytes]) -> list[str]:
    """Paths, relative to its folder, of the files that hold geometry of a glTF; none if it is broken.

    Args:
        head: gives so many bytes from the file's beginning, all of them for -1.
    """
    begin = head(20)
    is_binary = begin[:4] == b"glTF"
    text = head(20 + int.from_bytes(begin[12:16], "little"))[20:] if is_binary else head(-1)
    try:
        uris = [buffer.get("uri") for buffer in _document(text).get("buffers", [])]
    except (Invalid, AttributeError, TypeError):
        return []
    return [unquote(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]


def resolved(path: str, other: str) -> str:
    """The path from a dataset's root of a file that the file at `path` refers to.

    Raises:
        DataError: it leads out of the dataset.
    """
    joined = posixpath.normpath(posixpath.join(posixpath.dirname(path), other.replace("\\", "/")))
    if ":" in other or "\0" in other or joined.startswith(("/", "..")) or other.endswith((".", "/")):
        raise DataError(f"{path} refers to {other[:80]}, which is not in the dataset; put it beside it.")
    return joined


def _natural(entry: Mapping[str, Any], key: str, otherwise: int | None = None) -> int:
    value = entry.get(key, otherwise)
    if not isinstance(value, int) or not 0 <= value < 1 << 50:
        raise Invalid(f"has {str(value)[:20]} as its {key}")
    return value
