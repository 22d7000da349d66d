"""Controllers of the scripted player, and a look at what they leave behind."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
import threading
from pathlib import Path
from typing import NamedTuple

from activelsd.envs.thor.client import GuardedController

PLAYER = Path(__file__).with_name("player.py")


def player(*words: object) -> str:
    """The command line that starts the scripted player."""
    return shlex.join([sys.executable, str(PLAYER), *map(str, words)])


def controller(
    *words: object, start_timeout_s: float = 20.0, step_timeout_s: float = 20.0, **initialize: object
) -> GuardedController:
    """A controller of a scripted player; the words are its arguments."""
    return GuardedController(
        executable=player(*words),
        x_display=":0",
        width=96,
        height=64,
        start_timeout_s=start_timeout_s,
        step_timeout_s=step_timeout_s,
        renderInstanceSegmentation=True,
        **initialize,
    )


class Belongings(NamedTuple):
    """What this process has going on: children, threads, and entries of its folder for temporary files."""

    children: frozenset[int]
    threads: frozenset[str]
    temporary: frozenset[Path]

    @classmethod
    def now(cls) -> Belongings:
        threads = frozenset(thread.name for thread in threading.enumerate())
        return cls(children(), threads, frozenset(Path(tempfile.gettempdir()).iterdir()))


def children() -> frozenset[int]:
    """The processes this one has started and not reaped, zombies included."""
    found = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            after_name = stat.read_text().rpartition(")")[2].split()
        except OSError:  # ended meanwhile
            continue
        if int(after_name[1]) == os.getpid():
            found.add(int(stat.parent.name))
    return frozenset(found)
