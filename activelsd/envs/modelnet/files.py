"""Reads a data set's files from a folder or a zip.

A zip is read in place: nothing is extracted, so a name inside it leads nowhere.
"""

from __future__ import annotations

import os
import re
import stat
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from activelsd.errors import DataError

ARCHIVES = frozenset(
    {".zip", ".tar", ".gz", ".tgz", ".bz2", ".tbz2", ".xz", ".txz", ".zst", ".lz4", ".7z", ".rar"}
)
"""Endings of files that hold others, or another in less room."""

_DEPTH = 8
"""Levels of a folder that are listed: a top folder, class, `train`, an object's folders, and some to name."""

_SYSTEM = frozenset(
    {"thumbs.db", "ehthumbs.db", "desktop.ini", "icon\r", "icon\uf00d", "__macosx", "@eadir", "#recycle"}
    | {"lost+found", "$recycle.bin", "recycler", "system volume information"}
)
"""Files and folders that systems leave everywhere, in small letters."""

_STREAM = re.compile(
    r"[:\uf03a](zone\.identifier|smartscreen|com\.dropbox\..+|afp_.+)(:\$data)?", re.IGNORECASE
)
"""What Windows notes beside a file, as other systems show it: `cup.off:Zone.Identifier`."""

_UTF8_NAMES = 0x800  # flag of a zip's entry
_LETTERS = {
    "cp437": re.compile("[\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u00ff]"),
    "gb2312": re.compile("[\u3000-\u303f\u3400-\u9fff\uff00-\uffef]"),
}
"""Letters beyond ASCII that names have in a code page."""
_BEYOND_ASCII = re.compile(r"[^\x00-\x7f]")


class Member(NamedTuple):
    """A file, or a folder, of a data set."""

    path: str  # from the data set's root, with slashes; ends in one for a folder
    stamp: str  # changes when the file does: its size and time, or its CRC inside a zip


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
            reason = f"{readable(str(error.filename))} cannot be read ({error.strerror})"
            raise DataError(f"{reason}; mend or remove it.") from None

    def _below(self, prefix: str, depth: int) -> Iterator[Member]:
        with os.scandir(self.root / prefix) as entries:
            for entry in entries:
                if _is_hidden(entry.name):
                    continue
                if entry.is_dir():
                    if entry.is_symlink() and Path(entry.path).resolve() in self._above(prefix):
                        continue  # it leads back to where it stands
                    yield Member(f"{prefix}{entry.name}/", "")
                    if depth > 1:
                        yield from self._below(f"{prefix}{entry.name}/", depth - 1)
                else:
                    about = entry.stat()
                    if not stat.S_ISREG(about.st_mode):
                        what = f"{self.where(prefix + entry.name)} is no file that can be read"
                        raise DataError(f"{what}; remove it.")
                    yield Member(prefix + entry.name, _stamp(about))

    def _above(self, prefix: str) -> list[Path]:
        here = (self.root / prefix).resolve()
        return [here, *here.parents]

    def where(self, path: str) -> str:
        """The name of a file in messages."""
        return readable(str(self.root / path))

    def read(self, path: str) -> bytes:
        """A file's bytes. Raises DataError if it cannot be read."""
        try:
            return (self.root / path).read_bytes()
        except OSError as error:
            raise DataError(f"{self.where(path)} cannot be read ({error.strerror}); copy it again.") from None

    def head(self, path: str, size: int) -> bytes:
        """The first bytes of a file, all for -1. Raises DataError as `read` does."""
        try:
            with (self.root / path).open("rb") as file:
                return file.read(size)
        except OSError as error:
            raise DataError(f"{self.where(path)} cannot be read ({error.strerror}); copy it again.") from None

    def stamp(self, path: str) -> str:
        """The stamp of a file, whether it is among the members or not; empty if there is none."""
        try:
            return _stamp((self.root / path).stat())
        except (OSError, ValueError):
            return ""


def _stamp(about: os.stat_result) -> str:
    return f"{about.st_size}:{about.st_mtime_ns}"


@dataclass(frozen=True)
class Zip:
    """Files inside a zip; backslashes between folders count as slashes."""

    root: Path

    def members(self) -> Iterator[Member]:
        """Files and folders as the zip's directory lists them.

        Raises:
            DataError: it is no zip, cut short, or has names in a code page that cannot be told.
        """
        for path, info in _opened(self.root).entries.items():
            if path and not any(map(_is_hidden, path.split("/"))):
                yield Member(path, "" if path.endswith("/") else f"{info.file_size}:{info.CRC}")

    def stamp(self, path: str) -> str:
        """The stamp of a file, whether it is among the members or not; empty if there is none."""
        info = _opened(self.root).entries.get(path)
        return "" if info is None else f"{info.file_size}:{info.CRC}"

    def where(self, path: str) -> str:
        """The name of a file in messages."""
        return f"{readable(str(self.root))}/{path}"

    def read(self, path: str) -> bytes:
        """A file's bytes. Raises DataError if the zip is damaged there or locked by a password."""
        return self.head(path, -1)

    def head(self, path: str, size: int) -> bytes:
        """The first bytes of a file, all for -1. Raises DataError as `read` does."""
        archive = _opened(self.root)
        try:
            with archive.file.open(archive.entries[path]) as file:
                return file.read(size)
        except KeyError:
            raise DataError(f"{self.where(path)} is not in the zip; pack it again with that file.") from None
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError):
            raise DataError(f"{self.where(path)} is damaged inside the zip; download it again.") from None
        except (RuntimeError, NotImplementedError) as error:  # a password, or a compression Python lacks
            raise DataError(f"{self.where(path)} cannot be unpacked ({error}); extract the zip.") from None


class _Archive(NamedTuple):
    file: zipfile.ZipFile
    entries: dict[str, zipfile.ZipInfo]  # by path with slashes


@lru_cache(maxsize=1)
def _opened(path: Path) -> _Archive:
    """A zip kept open, as its directory is long to read and every object asks for it."""
    try:
        file = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, OSError):
        raise DataError(f"{readable(str(path))} is not a whole zip; download it again.") from None
    return _Archive(file, {_entry_path(info, path): info for info in file.infolist()})


def _entry_path(info: zipfile.ZipInfo, archive: Path) -> str:
    """An entry's path; a name without the mark of UTF-8 may nevertheless be in it, or in a code page.

    Western letters of code page 437, which is the format's own, and Chinese of GB 2312 can be told apart from
    the others: those are drawn as lines, blocks and signs in 437.
    """
    name = info.filename
    if not info.flag_bits & _UTF8_NAMES and not name.isascii():
        data = name.encode("cp437")
        for page in ("utf-8", "cp437", "gb2312"):
            try:
                name = data.decode(page)
            except UnicodeDecodeError:
                continue
            if page == "utf-8" or all(map(_LETTERS[page].match, filter(_BEYOND_ASCII.match, name))):
                break
        else:
            raise DataError(
                f"{readable(str(archive))} has names in a code page that cannot be told, such as"
                f" {info.filename!r}; extract it, or pack it again with names in UTF-8."
            )
    parts = name.replace("\\", "/").split("/")
    return "/".join(part for i, part in enumerate(parts) if part != "." and (part or i == len(parts) - 1))


def open_files(path: Path) -> Folder | Zip:
    """The files of a data set in a folder or a zip.

    Raises:
        DataError: there is nothing at the path, or it is neither a folder nor a zip.
    """
    if path.is_dir():
        return Folder(path)
    name = readable(str(path))
    if not path.exists():
        raise DataError(f"There is no dataset at {name}; check env.dataset.path.")
    if path.suffix.lower() == ".zip" or zipfile.is_zipfile(path):
        _opened.cache_clear()  # the zip at this path may be another by now
        return Zip(path)
    if path.suffix.lower() in ARCHIVES:
        raise DataError(f"{name} is not read packed like that; unpack it and give the folder, or give a zip.")
    raise DataError(f"{name} is neither a folder nor a zip; give the folder that holds the class folders.")


def readable(path: str) -> str:
    """A path in letters that can be written anywhere: names that are not in UTF-8 count as Latin-1."""
    if _is_text(path):
        return path
    return "/".join(p if _is_text(p) else os.fsencode(p).decode("latin-1") for p in path.split("/"))


def _is_text(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _is_hidden(name: str) -> bool:
    """Whether a file or folder is hidden, a system's own, or an editor's copy of another."""
    return (
        name.startswith((".", "~$"))
        or name.endswith("~")
        or name.lower() in _SYSTEM
        or _STREAM.search(name) is not None
    )
