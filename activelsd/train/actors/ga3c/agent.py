"""An agent: asks for actions, has its player take them, and gets a new player when it loses one."""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass

from activelsd.errors import ActiveLSDError, TrainingError
from activelsd.train.actors.ga3c.gauges import Gauges
from activelsd.train.actors.ga3c.player import Player
from activelsd.train.actors.ga3c.process import AgentLost
from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.ga3c.trajectory import Recorder

log = logging.getLogger("activelsd.ga3c")


@dataclass(frozen=True, kw_only=True, eq=False)
class Surroundings:
    """What the agents share.

    Attributes:
        world: the environment's name, for messages.
        make: a player from an agent's number and what is asked while it is waited for.
        asks: the prediction queue, of agents' numbers.
        starting: holds the agents that start at the same time.
        restarts: how often an agent may get a new player.
        gauges: where losses are counted.
        fail: called with what ends the training.
    """

    world: str
    make: Callable[[int, Callable[[], bool]], Player]
    asks: BatchQueue[int]
    starting: threading.Semaphore
    restarts: int
    gauges: Gauges
    fail: Callable[[Exception], None]


class Agent(threading.Thread):
    """The thread of an agent, whether its player is in this process or in one of its own.

    While it has asked, its slots and its recorder are the predictor's; at all other times they are its own.
    """

    def __init__(self, number: int, recorder: Recorder, around: Surroundings) -> None:
        super().__init__(name=f"agent-{number}", daemon=True)
        self.number, self.recorder = number, recorder
        self.player: Player | None = None
        self._around = around
        self._answered = threading.Semaphore(0)
        self._stopping = False

    def answer(self) -> None:
        """Have the actions taken that stand in the slots."""
        # Straight to the player: waking this thread first would cost a step of the machine's scheduler.
        player = self.player
        if player is not None:
            player.go()
        self._answered.release()

    def stop(self) -> None:
        """Make it end after the answer it waits for, if it waits for one."""
        self._stopping = True

    def run(self) -> None:
        """Play until stopped; whatever cannot be mended ends the training."""
        lost = 0
        try:
            while not self._stopping:
                try:
                    self._play()
                except AgentLost as loss:  # noqa: PERF203  once per player, not per step
                    if not self._stopping:
                        lost += 1
                        self._mourn(loss, lost)
        except ClosedError:
            pass
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._around.fail(error)

    def _play(self) -> None:
        around = self._around
        try:
            with around.starting:
                if self._stopping:
                    return
                self.player = around.make(self.number, lambda: not self._stopping)
                self.player.begin()
            while not self._stopping:
                around.asks.put(self.number)
                try:
                    self.player.wait()
                finally:  # a process may die before it is answered; until then the slots are the predictor's
                    self._answered.acquire()
        except (ActiveLSDError, ClosedError):
            raise
        except Exception:  # noqa: BLE001  a player in this process; its own traceback is what helps
            raise AgentLost(f"failed:\n{traceback.format_exc()}") from None
        finally:
            if self.player is not None:
                player, self.player = self.player, None
                player.close()

    def _mourn(self, loss: AgentLost, lost: int) -> None:
        """Write down what is lost; at most so many times."""
        around, who = self._around, f"Agent {self.number} ({self._around.world})"
        steps = self.recorder.drop()
        around.gauges.count(agents_lost=1, steps_lost=steps)
        if lost > around.restarts:
            raise TrainingError(
                f"{who} was lost {lost} times, more than train.ga3c.restarts={around.restarts}; mend the"
                f" environment and go on from the last checkpoint. The last time it {loss}"
            )
        log.warning(
            "%s %s\nIt is started anew (%d of %d times); %d steps of an unfinished trajectory are lost.",
            who,
            loss,
            lost,
            around.restarts,
            steps,
        )
