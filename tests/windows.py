"""Makes Python on Linux as strict as on Windows, as far as that can be done; for `sitecustomize`."""

from __future__ import annotations

import builtins
import fcntl
import os
import select
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

MODULES = ("fcntl", "grp", "pwd", "resource", "termios")
NAMES: dict[Any, tuple[str, ...]] = {
    os: ("fork", "forkpty", "geteuid", "getuid", "killpg", "memfd_create", "sched_getaffinity", "setsid"),
    select: ("poll", "epoll"),
    signal: ("SIGKILL", "SIGUSR1", "SIGUSR2", "SIGHUP", "pthread_sigmask"),
}


def install() -> None:
    """Hide what Windows lacks, and refuse what it refuses."""
    control = fcntl.fcntl
    for module, names in NAMES.items():
        for name in names:
            delattr(module, name)
    os.fsync = _fsync(os.fsync, control)
    for name in ("unlink", "remove", "rename", "replace"):
        setattr(os, name, _unless_open(getattr(os, name)))
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    warnings.filterwarnings("error", category=builtins.EncodingWarning, module="activelsd")


def _fsync(fsync: Callable[[int], None], control: Callable[[int, int], int]) -> Callable[[int], None]:
    def strict(descriptor: int) -> None:
        """Flush only a file that may be written."""
        if control(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(9, "Bad file descriptor")
        fsync(descriptor)

    return strict


def _unless_open(act: Callable[..., None]) -> Callable[..., None]:
    def strict(path: Any, *others: Any, **options: Any) -> None:
        """Refuse a file that this process has open or mapped."""
        for one in (path, *others):
            if isinstance(one, str | Path) and str(Path(one).absolute()) in _in_use():
                raise PermissionError(13, "The process cannot access the file", str(one))
        act(path, *others, **options)

    return strict


def _in_use() -> set[str]:
    found = {
        line.split(maxsplit=5)[5].strip()
        for line in Path("/proc/self/maps").read_text("utf-8").splitlines()
        if len(line.split(maxsplit=5)) == 6
    }
    for link in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the listing's own descriptor
            found.add(str(link.readlink()))
    return found
