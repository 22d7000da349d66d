"""Ends the calls of AI2-THOR's client that a dead or silent player would leave hanging or spinning.

The client (5.0.0) waits for the player to open a pipe without looking whether it still lives, and, while a
timeout is set, takes the end of a pipe for bytes that are yet to come. A thread beside it looks for both: it
opens and closes the pipes' other ends, so that whoever waits for a partner goes on, and closes the client's
own, so that whoever reads meets an error.
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
"""How often the thread looks; a client with a dead player spins for no longer."""

NONSENSE = bytes(5)
"""A header of a type there is none of, so that no message cut short is ever taken for a whole one."""


class Watchdog:
    """Looks after one `Controller`, from before its constructor has run.

    Attributes:
        lost: why the player is of no use any more; None while it is.
    """

    def __init__(self, controller: Any) -> None:
        self.lost: str | None = None
        self._controller = controller
        self._limit = 0.0  # seconds, of the call that goes on
        self._deadline: float | None = None  # None while no call goes on
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="ai2thor-watchdog", daemon=True)
        self._thread.start()

    @contextlib.contextmanager
    def guard(self, seconds: float) -> Iterator[None]:
        """A call of the controller, which ends soon after so many seconds, or after the player's death."""
        self._limit, self._deadline = seconds, time.monotonic() + seconds
        try:
            yield
        finally:
            self._deadline = None

    def close(self) -> None:
        """End the thread; calls are not looked after any more."""
        self._closed.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._closed.wait(POLL_S):
            # The constructor, which may still run, sets one after the other.
            server = vars(self._controller).get("server")
            if server is None or server.unity_proc is None:
                continue
            self.lost = self.lost or self._look(server.unity_proc)
            if self.lost and self._deadline is not None:
                _release(server)

    def _look(self, process: Any) -> str | None:
        """Why the player is of no use, if so; one that lets the deadline pass is killed."""
        code, deadline = process.poll(), self._deadline
        if code is not None:
            return f"it died of {signal.Signals(-code).name}" if code < 0 else f"it exited with code {code}"
        if deadline is not None and time.monotonic() > deadline:
            process.kill()
            return f"it did not answer within {self._limit:g} s"
        return None


def _release(server: Any) -> None:
    """Let the call that waits for the player go on, and fail."""
    for path, way in ((server.server_pipe_path, os.O_WRONLY), (server.client_pipe_path, os.O_RDONLY)):
        with contextlib.suppress(OSError):  # nobody is at the other end, or it is full
            end = os.open(path, way | os.O_NONBLOCK)
            try:
                if way == os.O_WRONLY:
                    os.write(end, NONSENSE)  # wakes a reader where something else holds the pipe open
            finally:
                os.close(end)
    if server.server_pipe is not None:
        server.server_pipe.close()
