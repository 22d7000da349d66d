"""A player in its own process: both ends of the pipes between it and the agent's thread.

The pipes carry one byte per step in each direction, the index of the lane; observations and actions are in
the shared slots. Each process ends with its parent, however that ends: then a pipe closes that only the
parent holds open.
"""

from __future__ import annotations

import faulthandler
import json
import os
import select
import signal
import subprocess
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import IO, Any, NamedTuple

import gymnasium

from activelsd.envs.actions import ActionTree
from activelsd.errors import ActiveLSDError, UserError
from activelsd.subprogram import NUMBER, start
from activelsd.train.actors.ga3c.slots import Layout, Slots
from activelsd.train.actors.ga3c.stepper import Env, LocalStepper, check_actions

_FAILED = b"!"
"""Announces an error; any other byte is a lane."""

_WHERE: int = getattr(signal, "SIGUSR1", 0)
"""Makes a process write its tracebacks to its trace file; Windows, where no such process runs, has none."""

_GRACE = 2.0
"""Seconds for a process to close its environments before it is killed."""

_GLANCE = 0.2
"""Seconds between two checks whether the agent is still wanted."""

_TELLING = 1.0
"""Seconds for a silent process to write its tracebacks."""


class AgentLost(ActiveLSDError):
    """Raised when a player has failed, hangs or is gone; its text says how, with any traceback."""


@dataclass(frozen=True, kw_only=True)
class EnvSpec:
    """Describes a process's environment, in plain values that JSON holds.

    Attributes:
        id: Gymnasium's, after the module that registers it and a colon: `my_package:my/Env-v0`.
        kwargs: the environment's keyword arguments.
        tree: the actions it must have.
    """

    id: str
    kwargs: dict[str, Any]
    tree: ActionTree


class Lifeline(NamedTuple):
    """A pipe that every process watches; when it closes, the parent has ended."""

    read: int
    write: int

    @classmethod
    def open(cls) -> Lifeline:
        """Both ends, which child processes inherit only if they are passed on."""
        return cls(*os.pipe())

    def close(self) -> None:
        """End all processes that still watch it."""
        os.close(self.read)
        os.close(self.write)


class ProcessStepper:
    """The parent's end of a player."""

    def __init__(
        self,
        spec: EnvSpec,
        slots: Slots,
        agent: int,
        seed: int,
        *,
        lifeline: Lifeline,
        start_timeout: float,
        timeout: float,
        wanted: Callable[[], bool],
    ) -> None:
        """Start the process.

        Args:
            spec: the environment.
            slots: where it writes observations.
            agent: its index there.
            seed: of its first environment.
            lifeline: of this process.
            start_timeout: seconds until the first views.
            timeout: seconds for a step.
            wanted: called while waiting; False ends the wait.
        """
        self._start_timeout, self._timeout, self._wanted = start_timeout, timeout, wanted
        self._due = 1  # steps requested and not yet done; the first is to begin
        self._since = time.monotonic()  # when the process began with the first of them
        # Without it, the pipe might be closed during a write, and its descriptor be another file's.
        self._writing = threading.Lock()
        self._trace: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  faulthandler's
        files = {"memory": slots.file, "lifeline": lifeline.read, "trace": self._trace.fileno()}
        job = {"files": files, "layout": asdict(slots.layout), "agent": agent, "seed": seed}
        job |= {"id": spec.id, "kwargs": spec.kwargs, "actions": spec.tree.to_dict()}
        self._process = start(__name__, tuple(files.values()))
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout
        self._poll = select.poll()
        self._poll.register(self._answers, select.POLLIN)
        self._send(json.dumps(job).encode() + b"\n")

    @property
    def pid(self) -> int:
        """Id of the process, which leads its own process group."""
        return self._process.pid

    def begin(self) -> None:
        """Wait for the first views.

        Raises:
            UserError: the environment cannot be made, and the mistake is the user's.
            AgentLost: as `wait`.
        """
        self._wait(self._start_timeout)

    def go(self, lane: int) -> None:
        """Send the lane to the process."""
        with self._writing:
            if not self._due:
                self._since = time.monotonic()
            self._due += 1
        self._send(bytes([lane]))

    def _send(self, message: bytes) -> None:
        with self._writing, suppress(BrokenPipeError):  # it died; `wait` says how
            if not self._requests.closed:  # `close` may have come first
                self._requests.write(message)

    def wait(self) -> int:
        """Wait for the next lane whose step is done.

        Raises:
            AgentLost: the environment raised, the process died, or it was silent for too long.
        """
        return self._wait(self._timeout)

    def _wait(self, timeout: float) -> int:
        while not self._poll.poll(_GLANCE * 1000):
            if not self._wanted():
                raise AgentLost("was no longer wanted")
            if self._due and time.monotonic() > self._since + timeout:
                self._process.send_signal(_WHERE)
                time.sleep(_TELLING)
                raise AgentLost(f"was silent for {timeout:g} s{self._trace_text()}")
        answer = self._answers.read(1)
        if answer and answer != _FAILED:
            with self._writing:
                self._due -= 1
                self._since = time.monotonic()
            return answer[0]
        if answer == _FAILED:
            failure = json.loads(self._answers.readline())
            if failure["mistake"]:
                raise UserError(failure["text"])
            raise AgentLost(f"failed:\n{failure['text']}")
        code = self._process.wait()
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise AgentLost(f"ended by itself ({how}){self._trace_text()}")

    def _trace_text(self) -> str:
        self._trace.seek(0)
        text = self._trace.read().decode(errors="replace").strip()
        return f":\n{text}" if text else ""

    def _kill(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def close(self) -> None:
        """Let the process close its environments, then kill its process group."""
        with self._writing:
            self._requests.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE)
        self._kill(signal.SIGKILL)
        self._process.wait()
        self._answers.close()
        self._trace.close()


def main() -> None:
    """Play the job on the first line of standard input, a step for each byte after it, until it closes."""
    answers = os.dup(1)
    os.dup2(2, 1)  # what an environment prints must not mix with the answers
    with os.fdopen(os.dup(0), "rb", buffering=0) as requests:
        job = json.loads(requests.readline())
    files = job["files"]
    os.environ[NUMBER] = str(job["agent"])
    faulthandler.enable(files["trace"])
    faulthandler.register(_WHERE, files["trace"], chain=False)
    threading.Thread(target=_end_with_parent, args=(files["lifeline"],), daemon=True).start()
    begun = False
    try:
        slots = Slots(Layout(**job["layout"]), files["memory"])
        player = LocalStepper(lambda: _make(job), slots, job["agent"], job["seed"])
        player.begin()
        begun = True
        lane = b"\0"
        while _answer(answers, lane) and (lane := os.read(0, 1)):
            player.step(lane[0])
        player.close()
    except Exception as error:  # noqa: BLE001  the parent says which agent it was
        mistake = isinstance(error, UserError) or (not begun and isinstance(error, gymnasium.error.Error))
        text = str(error) if mistake else traceback.format_exc()[-20_000:]
        _answer(answers, _FAILED + json.dumps({"mistake": mistake, "text": text}).encode() + b"\n")


def _make(job: dict[str, Any]) -> Env:
    env: Env = gymnasium.make(job["id"], disable_env_checker=True, **job["kwargs"])
    check_actions(env, job["actions"])
    return env


def _answer(answers: int, message: bytes) -> bool:
    try:
        os.write(answers, message)
    except BrokenPipeError:  # the parent is gone
        return False
    return True


def _end_with_parent(lifeline: int) -> None:
    os.read(lifeline, 1)
    os.killpg(0, signal.SIGKILL)
