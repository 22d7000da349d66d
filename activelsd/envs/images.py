"""Pictures from bytes: the format is the one the data are in, whatever the file's name ends in.

OpenCV fills the missing part of a file that was cut short and reports nothing, and leaves a picture with
transparency as a camera stored it, perhaps on its side. So the parts of every file are counted here, and its
EXIF orientation is read: JPEG (ITU T.81, annex B), PNG (chunks), WebP (RIFF) and TIFF 6.0, as EXIF is too.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ENDINGS = frozenset({".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".webp", ".bmp", ".tif", ".tiff"})
"""Of pictures that are read, in small letters."""

FOREIGN_ENDINGS = frozenset(
    {".gif", ".heic", ".heif", ".avif", ".jp2", ".jxl", ".ppm", ".pgm", ".pnm", ".tga", ".dds", ".psd"}
    | {".exr", ".hdr", ".ktx", ".ktx2", ".svg", ".raw", ".dng", ".cr2", ".nef", ".arw"}
)
"""Of pictures that are not read."""

_FOREIGN = {
    b"GIF8": "GIF",
    b"ftypavif": "AVIF",
    b"ftyp": "HEIC",
    b"jP  ": "JPEG 2000",
    b"\xff\x4f\xff\x51": "JPEG 2000",
}
"""What pictures in other formats begin with, or nearly so."""

_MARKER = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]")  # of JPEG, but for those inside its compressed data
_ORIENTATION, _STRIPS, _TILES = 274, (273, 279), (324, 325)  # tags of TIFF


class Still(NamedTuple):
    """What is known of a picture before it is decoded."""

    format: str  # such as JPEG; empty if it is none that is known
    whole: bool  # no part of it is missing; bytes after its end do not count
    orientation: int  # EXIF's: 1 is upright, 2 to 8 say how it is stored


def examine(data: bytes) -> Still:
    """The format of a picture, whether all of it is there, and how it is turned."""
    if data.startswith(b"\xff\xd8"):
        whole, exif = _jpeg(data)
        return Still("JPEG", whole, _orientation(exif))
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        whole, exif = _png(data)
        return Still("PNG", whole, _orientation(exif))
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        whole, exif = _webp(data)
        return Still("WebP", whole, _orientation(exif))
    if data[:4] in (b"II*\0", b"MM\0*"):
        return Still("TIFF", _tiff_is_whole(data), 1)  # OpenCV turns it
    if data.startswith(b"BM"):
        return Still("BMP", True, 1)  # OpenCV refuses a part of one
    start = data[:16]
    return Still(next((name for mark, name in _FOREIGN.items() if mark in start), ""), False, 1)


def decode_pixels(data: bytes) -> NDArray[np.uint8]:
    """uint8 (H, W), (H, W, 3) or (H, W, 4): a picture's pixels, upright; colours in OpenCV's order, BGR.

    Raises:
        ValueError: it is cut short, damaged, or in a format that is not read; the message says which, as the
            rest of a sentence that begins with the picture's name.
    """
    import cv2  # not needed for meshes

    # OpenCV reports a damaged file on stderr by itself, in lines that do not help a user.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    still = examine(data)
    if still.format in _FOREIGN.values():
        raise ValueError(f"is in {still.format}'s format, which is not read; convert it to PNG or JPEG")
    pixels: Any = None
    if still.whole:
        try:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:  # larger than it reads
            pixels = None
    if pixels is None:
        raise ValueError("is not a whole picture; copy it again")
    if pixels.dtype == np.uint16:
        pixels = (pixels // 256).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise ValueError(f"has values of type {pixels.dtype} for pixels; save it with 8 bits a channel")
    return np.ascontiguousarray(_upright(pixels, still.orientation))


def _upright(pixels: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Undoes how a camera stored a picture, see EXIF 2.32, tag Orientation."""
    if orientation >= 5:  # rows and columns are exchanged
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def _jpeg(data: bytes) -> tuple[bool, bytes]:
    """Whether a JPEG's end is reached from marker to marker, and its EXIF data."""
    at, exif = 2, b""
    while found := _MARKER.search(data, at):
        at = found.end()
        marker = data[at - 1]
        if marker == 0xD9:  # end of image
            return True, exif
        if marker in (0x01, 0xD8):  # have no length
            continue
        length = int.from_bytes(data[at : at + 2], "big")
        if marker == 0xE1 and data[at + 2 : at + 8] == b"Exif\0\0":
            exif = exif or data[at + 8 : at + length]
        at += max(length, 2)
    return False, exif


def _png(data: bytes) -> tuple[bool, bytes]:
    """Whether a PNG's last chunk is reached, and its EXIF data."""
    at, exif = 8, b""
    while at + 12 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        if kind == b"eXIf":
            exif = data[at + 8 : at + 8 + length]
        at += 12 + length
        if kind == b"IEND":
            return at <= len(data), exif
    return False, exif


def _webp(data: bytes) -> tuple[bool, bytes]:
    """Whether a WebP is as long as it says, and its EXIF data."""
    end, at, exif = 8 + int.from_bytes(data[4:8], "little"), 12, b""
    while at + 8 <= min(end, len(data)):
        length = int.from_bytes(data[at + 4 : at + 8], "little")
        if data[at : at + 4] == b"EXIF":
            exif = data[at + 8 : at + 8 + length].removeprefix(b"Exif\0\0")
        at += 8 + length + length % 2
    return len(data) >= end, exif


def _orientation(exif: bytes) -> int:
    """The orientation in EXIF data; 1, upright, if there is none or it is damaged."""
    turned = next((values[0] for tag, values in _tags(exif) if tag == _ORIENTATION and values), 1)
    return turned if 1 <= turned <= 8 else 1


def _tiff_is_whole(data: bytes) -> bool:
    """Whether all strips or tiles of a TIFF's first picture lie inside the file."""
    tags = dict(_tags(data))
    for offsets, counts in (_STRIPS, _TILES):
        if offsets in tags:
            ends = map(sum, zip(tags[offsets], tags.get(counts, ()), strict=False))
            return all(end <= len(data) for end in ends)
    return False


def _tags(data: bytes) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Number and values of every tag of whole numbers in the first directory of a TIFF."""
    order = "<" if data[:2] == b"II" else ">"
    try:
        (at,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, at)
        for place in range(at + 2, at + 2 + 12 * count, 12):
            tag, kind, n = struct.unpack_from(f"{order}HHI", data, place)
            letter = {3: "H", 4: "I"}.get(kind)
            if letter and n <= len(data):
                values = struct.Struct(f"{order}{n}{letter}")
                inline = values.size <= 4
                first = place + 8 if inline else struct.unpack_from(f"{order}I", data, place + 8)[0]
                yield tag, values.unpack_from(data, first)
    except struct.error:  # it ends here
        return
