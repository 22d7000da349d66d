"""What the command line shows while something long is under way."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO

EVERY = 5.0
"""Seconds between two lines where there is no terminal to draw on."""


def notice(text: str) -> None:
    """Say something that is not the command's result."""
    sys.stderr.write(f"{text}\n")


@contextmanager
def progress(what: str, stream: IO[str] | None = None) -> Iterator[Callable[[int, int], None]]:
    """A callback of (done, total) that shows how far something is, from its first call on.

    On a terminal a bar is drawn, elsewhere a plain line is written every few seconds.
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
    shown = -EVERY

    def show(done: int, total: int) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < EVERY and done < total:
            return
        shown = now
        left = (now - began) / done * (total - done) if done else 0.0
        after = f", about {left:.0f} s left" if done and done < total else ""
        stream.write(f"{what}: {done} of {total}{after}\n")
        stream.flush()

    return show
