"""Ends calls of AI2-THOR's client that would otherwise hang or busy-wait for a dead or silent player.

The client (5.0.0) waits for the player to open a pipe without checking that it is alive, and, if a timeout is
set, treats the end of a pipe as data still to come. A thread handles both: it opens and closes the other ends
of the pipes, so that a waiting `open` returns, and closes the client's own end, so that a read fails.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

POLL_S = 0.03
"""Seconds between two checks, and the longest busy-wait of a client whose player is dead."""

INVALID_HEADER = bytes(5)
"""A header of a type that does not exist, so that a truncated message is never read as a complete one."""


class Watchdog:
    """Watches one `Controller`, from before its constructor runs.

    Attributes:
        lost: why the player is no longer usable; None while it is.
    """

    def __init__(self, controller: Any) -> None:
        self.lost: str | None = None
        self._controller = controller
        self._limit = 0.0  # seconds that the current call may take
        self._deadline: float | None = None  # None if there is no current call
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="ai2thor-watchdog", daemon=True)
        self._thread.start()

    @contextlib.contextmanager
    def guard(self, seconds: float) -> Iterator[None]:
        """Makes sure that a call of the controller ends soon after the time limit or the player's death."""
        self._limit, self._deadline = seconds, time.monotonic() + seconds
        try:
            yield
        finally:
            self._deadline = None

    def close(self) -> None:
        """Ends the thread; calls are no longer watched."""
        self._closed.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._closed.wait(POLL_S):
            # The constructor may still be running; it sets these one after the other.
            server = vars(self._controller).get("server")
            if server is None or server.unity_proc is None:
                continue
            self.lost = self.lost or self._check(server.unity_proc)
            if self.lost and self._deadline is not None:
                _release(server)

    def _check(self, process: Any) -> str | None:
        """Why the player is not usable, or None; a player that misses the deadline is killed."""
        code, deadline = process.poll(), self._deadline
        if code is not None:
            return f"it died of {signal.Signals(-code).name}" if code < 0 else f"it exited with code {code}"
        if deadline is not None and time.monotonic() > deadline:
            process.kill()
            return f"it did not answer within {self._limit:g} s"
        return None


def _release(server: Any) -> None:
    """Lets a call that waits for the player continue and fail."""
    for path, mode in ((server.server_pipe_path, os.O_WRONLY), (server.client_pipe_path, os.O_RDONLY)):
        with contextlib.suppress(OSError):  # the other end is not open, or the pipe is full
            end = os.open(path, mode | os.O_NONBLOCK)
            try:
                if mode == os.O_WRONLY:
                    os.write(end, INVALID_HEADER)  # wakes a reader if another process keeps the pipe open
            finally:
                os.close(end)
    if server.server_pipe is not None:
        server.server_pipe.close()
