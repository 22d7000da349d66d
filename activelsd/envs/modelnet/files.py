"""Reads a dataset's files from a folder or a zip, and sorts them by class and split.

A zip is read in place: nothing is extracted, so a name inside it leads nowhere.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from activelsd.errors import DataError

FOLDERS = ("train", "test")
"""The folders of every class."""

_DEPTH = 6
"""Levels of a folder that are listed: a top folder, class, `train`, a file, and two to complain about."""


class Member(NamedTuple):
    """A file, or a folder, of a dataset."""

    path: str  # from the dataset's root, with slashes; ends in one for a folder
    stamp: str  # changes when the file does: its size and time, or its CRC inside a zip


class Entry(NamedTuple):
    """A file in the folder of a class."""

    category: str
    folder: str  # below the class folder: train, test, or where it would be overlooked
    path: str
    stamp: str


@dataclass(frozen=True)
class Folder:
    """Files under a folder."""

    root: Path

    def members(self) -> Iterator[Member]:
        """Files and folders down to a fixed depth, links followed.

        Raises:
            DataError: part of it cannot be read.
        """
        try:
            yield from self._below("", _DEPTH)
        except OSError as error:
            reason = f"{error.filename} cannot be read ({error.strerror})"
            raise DataError(f"{reason}; mend or remove it.") from None

    def _below(self, prefix: str, depth: int) -> Iterator[Member]:
        with os.scandir(self.root / prefix) as entries:
            for entry in entries:
                if entry.is_dir():
                    yield Member(f"{prefix}{entry.name}/", "")
                    if depth > 1 and not _hidden(entry.name):
                        yield from self._below(f"{prefix}{entry.name}/", depth - 1)
                elif not _hidden(entry.name):
                    stat = entry.stat()
                    yield Member(prefix + entry.name, f"{stat.st_size}:{stat.st_mtime_ns}")

    def where(self, path: str) -> str:
        """The name of a file in messages."""
        return str(self.root / path)

    def read(self, path: str) -> bytes:
        """A file's bytes. Raises DataError if it cannot be read."""
        try:
            return (self.root / path).read_bytes()
        except OSError as error:
            raise DataError(f"{self.where(path)} cannot be read ({error.strerror}); copy it again.") from None


@dataclass(frozen=True)
class Zip:
    """Files inside a zip."""

    root: Path

    def members(self) -> Iterator[Member]:
        """Files and folders as the zip's directory lists them.

        Raises:
            DataError: it is no zip, or cut short.
        """
        for info in {info.filename: info for info in _opened(self.root).infolist()}.values():
            yield Member(info.filename, "" if info.is_dir() else f"{info.file_size}:{info.CRC}")

    def where(self, path: str) -> str:
        """The name of a file in messages."""
        return f"{self.root}/{path}"

    def read(self, path: str) -> bytes:
        """A file's bytes. Raises DataError if the zip is damaged there or locked by a password."""
        try:
            return _opened(self.root).read(path)
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError):
            raise DataError(f"{self.where(path)} is damaged inside the zip; download it again.") from None
        except (RuntimeError, NotImplementedError) as error:  # a password, or a compression Python lacks
            raise DataError(f"{self.where(path)} cannot be unpacked ({error}); extract the zip.") from None


@lru_cache(maxsize=1)
def _opened(path: Path) -> zipfile.ZipFile:
    """A zip kept open, as its directory is long to read and every object asks for it."""
    try:
        return zipfile.ZipFile(path)
    except (zipfile.BadZipFile, OSError):
        raise DataError(f"{path} is not a whole zip; download it again.") from None


def open_files(path: Path) -> Folder | Zip:
    """The files of a dataset in a folder or a zip.

    Raises:
        DataError: there is nothing at the path, or it is neither a folder nor a zip.
    """
    if path.is_dir():
        return Folder(path)
    if not path.exists():
        raise DataError(f"There is no dataset at {path}; check env.dataset.path.")
    if path.suffix.lower() == ".zip" or zipfile.is_zipfile(path):
        _opened.cache_clear()  # the zip at this path may be another by now
        return Zip(path)
    raise DataError(f"{path} is neither a folder nor a zip; give the folder that holds the class folders.")


def class_folders(files: Folder | Zip) -> dict[str, list[Entry]]:
    """Every class with the files below its folder, in order of names.

    The class folders stand at the root or, as in ModelNet's own zips, in one folder there. Hidden files and
    what macOS adds to zips are passed over.

    Raises:
        DataError: the files are not laid out like that.
    """
    members = [m for m in files.members() if not any(map(_hidden, m.path.split("/")))]
    paths = [tuple(m.path.split("/")) for m in members]
    folders = {path[:i] for path in paths for i in range(1, len(path))}
    if not members:
        raise DataError(f"{files.root} is empty; {_layout(files)}")
    tops = {folder[:-2] for folder in folders if folder[-1] in FOLDERS and len(folder) > 1}
    if not tops:
        raise DataError(f"{files.root} has no class folders; {_layout(files)}")
    if len(tops) > 1:
        first, second = ("/".join((str(files.root), *top)) for top in sorted(tops)[:2])
        raise DataError(f"Class folders stand both in {first} and in {second}; give one of the two.")
    (top,) = tops
    depth = len(top)
    found: dict[str, list[Entry]] = {
        folder[-1]: [] for folder in sorted(folders) if len(folder) == depth + 1 and folder[:-1] == top
    }
    for member in sorted(members):
        *parents, name = member.path.split("/")
        if tuple(parents[:depth]) != top or len(parents) <= depth or not name:
            continue
        found[parents[depth]].append(
            Entry(parents[depth], "/".join(parents[depth + 1 :]), member.path, member.stamp)
        )
    return found


def _layout(files: Folder | Zip) -> str:
    return f"meshes are looked for in {files.root}/CLASS/train and {files.root}/CLASS/test."


def _hidden(name: str) -> bool:
    return name.startswith(".") or name in {"__MACOSX", "Thumbs.db", "desktop.ini"}
