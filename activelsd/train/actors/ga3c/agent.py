"""An agent: asks for actions, has its player take them, and gets a new player when it loses one."""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from activelsd.errors import ActiveLSDError, TrainingError
from activelsd.train.actors.ga3c.process import AgentLost
from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError
from activelsd.train.actors.ga3c.stepper import Stepper
from activelsd.train.actors.ga3c.trajectory_writer import TrajectoryWriter
from activelsd.train.actors.gauges import Gauges

log = logging.getLogger("activelsd.ga3c")


@dataclass(frozen=True, kw_only=True, eq=False)
class AgentContext:
    """What the agents share.

    Attributes:
        world: the environment's name, for messages.
        make: a player from an agent's number and what is asked while it is waited for.
        asks: the prediction queue, of agents' numbers and lanes.
        starting: holds the agents that start at the same time.
        restarts: how often an agent may get a new player.
        gauges: where losses are counted.
        fail: called with what ends the training.
    """

    world: str
    make: Callable[[int, Callable[[], bool]], Stepper]
    asks: BatchQueue[tuple[int, int]]
    starting: threading.Semaphore
    restarts: int
    gauges: Gauges
    fail: Callable[[Exception], None]


class Agent(threading.Thread):
    """The thread of an agent, whether its player is in this process or in one of its own.

    While it has asked about a lane, the slots and the recorder of that are the predictor's; at all other
    times they are its own.
    """

    def __init__(self, number: int, recorders: Sequence[TrajectoryWriter], around: AgentContext) -> None:
        super().__init__(name=f"agent-{number}", daemon=True)
        self.number, self.recorders = number, recorders  # one for each lane
        self.player: Stepper | None = None
        self._around = around
        self._answered = threading.Semaphore(0)
        self._stopping = False

    def answer(self, lane: int) -> None:
        """Have the actions taken that stand in a lane's slots."""
        # Straight to the player: waking this thread first would cost a step of the machine's scheduler.
        player = self.player
        if player is not None:
            player.go(lane)
        self._answered.release()

    def stop(self) -> None:
        """Make it end after the answers it waits for, if it waits for any."""
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
                        self._record_loss(loss, lost)
        except ClosedError:
            pass
        except Exception as error:  # noqa: BLE001  the learner raises it
            self._around.fail(error)

    def _play(self) -> None:
        try:
            with self._around.starting:
                if self._stopping:
                    return
                self.player = self._around.make(self.number, lambda: not self._stopping)
                self.player.begin()
            self._ask_on(self.player)
        except (ActiveLSDError, ClosedError):
            raise
        except Exception:  # noqa: BLE001  a player in this process; its own traceback is what helps
            raise AgentLost(f"failed:\n{traceback.format_exc()}") from None
        finally:
            if self.player is not None:
                player, self.player = self.player, None
                player.close()

    def _ask_on(self, player: Stepper) -> None:
        """Ask about every lane, and again about each whose step is taken."""
        asks, unanswered = self._around.asks, 0
        try:
            for lane in range(len(self.recorders)):
                asks.put((self.number, lane))
                unanswered += 1
            while not self._stopping:
                lane = player.wait()
                self._answered.acquire()
                unanswered -= 1
                asks.put((self.number, lane))
                unanswered += 1
        finally:  # a process may die before it is answered; until then the slots are the predictor's
            for _ in range(unanswered):
                self._answered.acquire()

    def _record_loss(self, loss: AgentLost, lost: int) -> None:
        """Write down what is lost; at most so many times."""
        around, who = self._around, f"Agent {self.number} ({self._around.world})"
        steps = sum(recorder.drop() for recorder in self.recorders)
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
