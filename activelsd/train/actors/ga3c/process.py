"""A player in a process of its own: both ends of the pipes between it and the agent's thread.

The pipes carry a byte per step, a bell each way, which says the lane; what is seen and done stands in the
shared slots. Each process ends with its parent, whatever becomes of that: a pipe that only the parent holds
open says so.
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
"""What no bell rings; all others are a lane."""

_WHERE = signal.SIGUSR1
"""Asks a process to write down where it is."""

_GRACE = 2.0
"""Seconds that a process has to close its environments before it is killed."""

_GLANCE = 0.2
"""Seconds between two looks at whether the agent is wanted still."""

_TELLING = 1.0
"""Seconds that a silent process has to say where it is."""


class AgentLost(ActiveLSDError):
    """Raised when a player has failed, hangs or is gone; its text says how, with the traceback there is."""


@dataclass(frozen=True, kw_only=True)
class EnvSpec:
    """What a process makes its environment from, in plain values that JSON holds.

    Attributes:
        id: Gymnasium's, after the module that registers it and a colon: `my_package:my/Env-v0`.
        kwargs: the environment's keyword arguments.
        tree: the actions it must have.
    """

    id: str
    kwargs: dict[str, Any]
    tree: ActionTree


class Lifeline(NamedTuple):
    """A pipe whose reading end every process watches; its end is the parent's end."""

    read: int
    write: int

    @classmethod
    def open(cls) -> Lifeline:
        """Both ends, neither of them inherited unless it is passed on."""
        return cls(*os.pipe())

    def close(self) -> None:
        """Whoever still watches ends now."""
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
            slots: where it writes.
            agent: its number there.
            seed: of its first environment.
            lifeline: of this process.
            start_timeout: seconds it may take to show the first views.
            timeout: seconds it may take for a step.
            wanted: asked while it is waited for; False ends the waiting.
        """
        self._start_timeout, self._timeout, self._wanted = start_timeout, timeout, wanted
        self._due = 1  # things it was told to do and has not done yet
        self._since = time.monotonic()  # when it began with the first of them
        # Without it the bell's file might be closed in the midst of a ring, and its number be another file's.
        self._ringing = threading.Lock()
        self._trace: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  faulthandler's
        files = {"memory": slots.file, "lifeline": lifeline.read, "trace": self._trace.fileno()}
        job = {"files": files, "layout": asdict(slots.layout), "agent": agent, "seed": seed}
        job |= {"id": spec.id, "kwargs": spec.kwargs, "actions": spec.tree.to_dict()}
        self._process = start(__name__, tuple(files.values()))
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._bell, self._answers = self._process.stdin, self._process.stdout
        self._poll = select.poll()
        self._poll.register(self._answers, select.POLLIN)
        self._tell(json.dumps(job).encode() + b"\n")

    @property
    def pid(self) -> int:
        """Of the process, which leads a group of its own."""
        return self._process.pid

    def begin(self) -> None:
        """Wait for the first views.

        Raises:
            UserError: the environment cannot be made, and the mistake is the user's.
            AgentLost: as `wait`.
        """
        self._wait(self._start_timeout)

    def go(self, lane: int) -> None:
        """Ring."""
        with self._ringing:
            if not self._due:
                self._since = time.monotonic()
            self._due += 1
        self._tell(bytes([lane]))

    def _tell(self, message: bytes) -> None:
        with self._ringing, suppress(BrokenPipeError):  # it died, and waiting for its answer says how
            if not self._bell.closed:  # all agents are let go at once, those too that have just ended
                self._bell.write(message)

    def wait(self) -> int:
        """The next lane whose step is taken.

        Raises:
            AgentLost: the environment raised, the process died, or it was silent for too long.
        """
        return self._wait(self._timeout)

    def _wait(self, timeout: float) -> int:
        while not self._poll.poll(_GLANCE * 1000):
            if not self._wanted():
                raise AgentLost("was not wanted any more")
            if self._due and time.monotonic() > self._since + timeout:
                self._process.send_signal(_WHERE)
                time.sleep(_TELLING)
                raise AgentLost(f"was silent for {timeout:g} s{self._trace_text()}")
        answer = self._answers.read(1)
        if answer and answer != _FAILED:
            with self._ringing:
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
        """Let the process close its environments, then end it with all that it started."""
        with self._ringing:
            self._bell.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE)
        self._kill(signal.SIGKILL)
        self._process.wait()
        self._answers.close()
        self._trace.close()


def main() -> None:
    """Play what standard input describes, a step for each byte there, until it ends."""
    answers = os.dup(1)
    os.dup2(2, 1)  # whatever an environment prints must not get between the answers
    with os.fdopen(os.dup(0), "rb", buffering=0) as bell:
        job = json.loads(bell.readline())
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
        while _ring(answers, lane) and (lane := os.read(0, 1)):
            player.step(lane[0])
        player.close()
    except Exception as error:  # noqa: BLE001  the parent says which agent it was
        mistake = isinstance(error, UserError) or (not begun and isinstance(error, gymnasium.error.Error))
        text = str(error) if mistake else traceback.format_exc()[-20_000:]
        _ring(answers, _FAILED + json.dumps({"mistake": mistake, "text": text}).encode() + b"\n")


def _make(job: dict[str, Any]) -> Env:
    env: Env = gymnasium.make(job["id"], disable_env_checker=True, **job["kwargs"])
    check_actions(env, job["actions"])
    return env


def _ring(answers: int, message: bytes) -> bool:
    try:
        os.write(answers, message)
    except BrokenPipeError:  # the parent is gone, and so is anybody to tell
        return False
    return True


def _end_with_parent(lifeline: int) -> None:
    os.read(lifeline, 1)
    os.killpg(0, signal.SIGKILL)
