"""Progress lines and notices of the command line."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO

EVERY = 5.0
"""Seconds between two progress lines if the output is not a terminal."""


def notice(text: str) -> None:
    """Writes a message to standard error, which keeps it apart from the command's result."""
    sys.stderr.write(f"{text}\n")


@contextmanager
def progress(what: str, stream: IO[str] | None = None) -> Iterator[Callable[[int, int], None]]:
    """Gives a callback (done, total) that shows progress, from its first call on.

    On a terminal it draws a bar; elsewhere it writes a plain line every few seconds.
    """
    stream = stream or sys.stderr
    if stream.isatty():
        with _bar(what, stream) as show:
            yield show
    else:
        yield _lines(what, stream)


@contextmanager
def _bar(what: str, stream: IO[str]) -> Iterator[Callable[[int, int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=stream)) as bar:
        task = bar.add_task(what, visible=False)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, visible=True)

        yield show


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
