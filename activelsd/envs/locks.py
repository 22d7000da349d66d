"""Locks between processes, for every system and disk.

A lock of the operating system ends with its process. Where there is none, as on NFS without lockd, on some
mounts of Lustre, and on systems without `fcntl`, a marker replaces it: a file that only one process can
create and that its holder touches every few seconds. A marker that nobody touches any more is taken over.
"""

from __future__ import annotations

import errno
import os
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

_POLL = 0.2
"""Seconds between two attempts."""

_TOUCH, _ABANDONED = 2.0, 60.0
"""Seconds between two touches of a marker, and without any until it is taken over."""

_BUSY = {errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK}

Release = Callable[[], None]

if sys.platform == "win32":
    import msvcrt

    def _lock(file: IO[bytes]) -> None:
        os.lseek(file.fileno(), 2**20, os.SEEK_SET)  # behind the note, which others may read
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)

else:

    def _lock(file: IO[bytes]) -> None:
        import fcntl  # not on every system

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def locked(path: Path, note: str, waiting: Callable[[str], None]) -> Iterator[None]:
    """Hold a lock; wait as long as another process does.

    Args:
        path: of the lock's file, which is gone again afterwards; its folder is made if need be.
        note: says to others who holds it.
        waiting: called once with the holder's note, if another process holds it.

    Raises:
        OSError: the file cannot be written.
    """
    marker = _Marker(path.with_name(path.name + ".held"))
    asked = False
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)  # a holder that failed may have removed it
        try:
            release = _system_lock(path, note)
            holder = path
        except (ImportError, OSError) as error:
            if isinstance(error, PermissionError):
                raise
            if isinstance(error, FileNotFoundError):  # the folder has just been removed
                continue
            release = marker.take(note)
            holder = marker.path
        if release is not None:
            break
        if not asked:
            asked = True
            waiting(_note(holder))
        time.sleep(_POLL)
    try:
        yield
    finally:
        release()


def _system_lock(path: Path, note: str) -> Release | None:
    """Take the operating system's lock of a file; None if another process has it."""
    file = path.open("a+b", buffering=0)
    try:
        _lock(file)
        if not _is_at(file.fileno(), path):  # its holder has removed it
            file.close()
            return None
        file.truncate(0)
        file.write(note.encode())
    except BaseException as error:
        file.close()
        if isinstance(error, OSError) and error.errno in _BUSY:
            return None
        with suppress(OSError):  # where there are no locks, the file means nothing
            path.unlink()
        raise

    def release() -> None:
        if sys.platform == "win32":  # an open file cannot be removed there
            file.close()
        with suppress(OSError):
            path.unlink()
        file.close()

    return release


class _Marker:
    """A file that stands for a lock where the system has none.

    Attributes:
        path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._own = uuid.uuid4().hex
        self._seen: tuple[int, bytes] | None = None  # of another process: time of its last touch, content
        self._since = 0.0

    def take(self, note: str) -> Release | None:
        """Create the file; None if another process holds it and touches it."""
        try:
            with self.path.open("xb") as file:
                file.write(f"{self._own} {note}".encode())
        except FileExistsError:
            self._watch()
            return None
        ended = threading.Event()
        touching = threading.Thread(target=self._touch, args=(ended,), daemon=True)
        touching.start()

        def release() -> None:
            ended.set()
            touching.join()
            with suppress(OSError):
                if self.path.read_bytes().startswith(self._own.encode()):
                    self.path.unlink()

        return release

    def _touch(self, ended: threading.Event) -> None:
        while not ended.wait(_TOUCH):
            with suppress(OSError):
                os.utime(self.path)

    def _watch(self) -> None:
        """Remove the file if it has not changed for long; clocks of two machines are not compared."""
        with suppress(FileNotFoundError):
            with self.path.open("rb") as file:  # opening it brings its newest state from a server
                seen = os.fstat(file.fileno()).st_mtime_ns, file.read()
            if seen != self._seen:
                self._seen, self._since = seen, time.monotonic()
            elif time.monotonic() > self._since + _ABANDONED:
                aside = self.path.with_name(f"{self.path.name}.{self._own}")
                self.path.rename(aside)
                if aside.read_bytes() == seen[1]:
                    aside.unlink()
                else:  # another process was faster, and holds it
                    aside.rename(self.path)


def _note(path: Path) -> str:
    """What the holder says of itself."""
    try:
        text = path.read_bytes().decode(errors="replace")
    except OSError:
        text = ""
    return (text.partition(" ")[2] if path.suffix == ".held" else text) or "another process"


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
