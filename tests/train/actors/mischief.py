"""An environment that fails as told to; it imports no more than an agent's process needs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv
from tests.graphs import ring_graph

GRAPH = ring_graph()
ID = "tests.train.actors.mischief:tests/Mischief-v0"


class Mischief(ViewGraphEnv):
    """Rings of 12 views that do as told at a step."""

    def __init__(self, *, how: str = "", at: int = 0, once: str = "", sleep: float = 0.0) -> None:
        """Set the trap.

        Args:
            how: `raise`, `hang`, `die` or `exit`, or, at once, `make` to raise and `stall` to hang.
            at: the step at which it happens.
            once: a file; the first to make it is the only one to whom it happens.
            sleep: seconds that a step takes.
        """
        super().__init__(GRAPH, PRESETS["V4"], frames=1)
        self._how, self._at, self._once, self._sleep = how, at, once, sleep
        self._steps = 0
        if how == "make":
            raise RuntimeError("no simulator here")
        if how == "stall":
            self._hang()

    def step(self, action: np.int64 | int) -> Any:
        time.sleep(self._sleep)
        self._steps += 1
        if self._how and self._steps == self._at and self._mine():
            {"raise": self._raise, "hang": self._hang, "die": self._die, "exit": self._exit}[self._how]()
        return super().step(action)

    def _mine(self) -> bool:
        if not self._once:
            return True
        try:
            Path(self._once).touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    def _raise(self) -> None:
        raise RuntimeError("the lamp fell over")

    def _hang(self) -> None:
        time.sleep(3600)

    def _die(self) -> None:
        os.kill(os.getpid(), signal.SIGSEGV)

    def _exit(self) -> None:
        os._exit(3)


gymnasium.register("tests/Mischief-v0", entry_point="tests.train.actors.mischief:Mischief")
