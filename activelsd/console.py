"""Progress lines and notices of the command line."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import IO

EVERY = 5.0
"""Seconds between two progress lines if the output is not a terminal."""


def notice(text: str) -> None:
    """Writes a message to standard error, which keeps it apart from the command's result."""
    sys.stderr.write(f"{text}\n")


class Progress:
    """A callback (done, total) that shows progress, from its first call on."""

    def __init__(self, shown: Callable[[str], Callable[[int, int], None]], what: str) -> None:
        self._shown = shown
        self._show = shown(what)

    def __call__(self, done: int, total: int) -> None:
        """Shows what is done and what there is in all."""
        self._show(done, total)

    def stage(self, what: str) -> Progress:
        """Progress of a part that has a title and counts of its own."""
        return Progress(self._shown, what)


@contextmanager
def progress(what: str, stream: IO[str] | None = None) -> Iterator[Progress]:
    """Gives a callback that shows progress.

    On a terminal it draws a bar; elsewhere it writes a plain line every few seconds.
    """
    stream = stream or sys.stderr
    if stream.isatty():
        with _bars(stream) as shown:
            yield Progress(shown, what)
    else:
        yield Progress(partial(_lines, stream=stream), what)


@contextmanager
def _bars(stream: IO[str]) -> Iterator[Callable[[str], Callable[[int, int], None]]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bars(*columns, console=Console(file=stream)) as bars:

        def shown(what: str) -> Callable[[int, int], None]:
            task = bars.add_task(what, visible=False)
            return lambda done, total: bars.update(task, completed=done, total=total, visible=True)

        yield shown


def _lines(what: str, stream: IO[str]) -> Callable[[int, int], None]:
    began = time.monotonic()
    last_shown = -EVERY

    def show(done: int, total: int) -> None:
        nonlocal last_shown
        now = time.monotonic()
        if now - last_shown < EVERY and done < total:
            return
        last_shown = now
        left = (now - began) / done * (total - done) if done else 0.0
        remaining = f", about {left:.0f} s left" if done and done < total else ""
        stream.write(f"{what}: {done} of {total}{remaining}\n")
        stream.flush()

    return show
