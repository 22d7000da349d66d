"""STL, binary and ASCII: https://en.wikipedia.org/wiki/STL_(file_format)."""

from __future__ import annotations

import re

import numpy as np

from activelsd.envs.modelnet.mesh_formats.surface import Surface
from activelsd.envs.modelnet.mesh_formats.text import numbers
from activelsd.errors import DataError

_HEAD = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_NAMES = re.compile(rb"^[ \t]*(?:end[ \t]*)?solid\b[^\r\n]*", re.MULTILINE | re.IGNORECASE)
_VERTEX = (b"vertex", None, None, None)
_FACET = (b"facet", b"normal", None, None, None, b"outer", b"loop", *3 * _VERTEX, b"endloop", b"endfacet")
"""The words of one triangle; numbers stand where None does."""


def read(data: bytes, name: str) -> Surface:
    """All triangles of an STL file.

    Args:
        data: the file.
        name: of the file in messages.

    Raises:
        DataError: it is no STL file, or holds less or more than it says.
    """
    said = int.from_bytes(data[80:_HEAD], "little")
    fits = len(data) >= _HEAD and len(data) == _HEAD + said * _TRIANGLE.itemsize
    begin = data[:1024].removeprefix(b"\xef\xbb\xbf").lstrip()
    if not fits and begin[:5].lower() == b"solid" and b"\0" not in data[:4096]:
        return _ascii(data.removeprefix(b"\xef\xbb\xbf"), name)
    if len(data) < _HEAD:
        raise DataError(f"{name} ends within its header, so it is no whole STL; copy it again or remove it.")
    return _binary(data, said, name)


def _binary(data: bytes, said: int, name: str) -> Surface:
    held, rest = divmod(len(data) - _HEAD, _TRIANGLE.itemsize)
    if said in (0, 0xFFFFFFFF) and held and not rest:
        said = held  # written by a program that did not come back to fill in the count
    if held < said:
        raise DataError(f"{name} ends after {held} of {said} triangles; copy it again or remove it.")
    if held > said and data[_HEAD + said * _TRIANGLE.itemsize :].strip(b"\0"):
        raise DataError(
            f"{name} says that it has {said} triangles and holds bytes of {held};"
            " mend the count in its header or copy it again."
        )
    corners = np.frombuffer(data, _TRIANGLE, said, _HEAD)["corners"].astype(np.float64).reshape(-1, 3)
    return Surface.of_triangles(corners, np.arange(3 * said).reshape(-1, 3))


def _ascii(data: bytes, name: str) -> Surface:
    text = data.replace(b"\r", b"\n")
    titles = [title.strip().lower() for title in _NAMES.findall(text)]
    words = _NAMES.sub(b"", text).lower().split()
    n, rest = divmod(len(words), len(_FACET))
    if sum(title.startswith(b"end") for title in titles) * 2 != len(titles):
        raise DataError(
            f"{name} ends after {n} triangles, before the endsolid of its last part;"
            " copy it again or remove it."
        )
    for i, word in enumerate(_FACET):
        if word is not None and words[i :: len(_FACET)].count(word) != n + (i < rest):
            rest = 1
    if rest:
        raise DataError(
            f"{name} has a facet that is not one of three vertices with a normal; repair it or save it again."
        )
    places = [i for i, word in enumerate(_FACET) if word is None][3:]
    columns = [numbers(b" ".join(words[i :: len(_FACET)])) for i in places]
    if any(column is None or len(column) != n for column in columns):
        raise DataError(f"{name} has a vertex that is not three numbers; copy it again or remove it.")
    corners = np.stack([column for column in columns if column is not None], axis=1).reshape(-1, 3)
    return Surface.of_triangles(corners, np.arange(3 * n).reshape(-1, 3))
