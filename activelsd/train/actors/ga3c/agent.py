"""An agent: requests actions, has its player take them, and replaces a player that is lost."""

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
    """State that the agents share.

    Attributes:
        world: the environment's name, for messages.
        make: makes a player from an agent's index and a function that says whether it is still wanted.
        requests: the prediction queue, of agents' indices and lanes.
        starting: limits how many agents start at the same time.
        restarts: how often an agent may get a new player.
        gauges: counts losses.
        fail: called with the error that ends the training.
    """

    world: str
    make: Callable[[int, Callable[[], bool]], Stepper]
    requests: BatchQueue[tuple[int, int]]
    starting: threading.Semaphore
    restarts: int
    gauges: Gauges
    fail: Callable[[Exception], None]


class Agent(threading.Thread):
    """The thread of an agent, whether its player is in this process or in one of its own.

    Between a request for a lane and its answer, the lane's slots and writer belong to the predictor; at all
    other times they belong to the agent.
    """

    def __init__(self, number: int, writers: Sequence[TrajectoryWriter], context: AgentContext) -> None:
        super().__init__(name=f"agent-{number}", daemon=True)
        self.number, self.writers = number, writers  # one for each lane
        self.player: Stepper | None = None
        self._context = context
        self._answered = threading.Semaphore(0)
        self._stopping = False

    def answer(self, lane: int) -> None:
        """Have the player take the actions in a lane's slots."""
        # The player is called directly: waking this thread first would cost a context switch.
        player = self.player
        if player is not None:
            player.go(lane)
        self._answered.release()

    def stop(self) -> None:
        """End after the answers to pending requests."""
        self._stopping = True

    def run(self) -> None:
        """Play until stopped; an error other than a lost player ends the training."""
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
            self._context.fail(error)

    def _play(self) -> None:
        try:
            with self._context.starting:
                if self._stopping:
                    return
                self.player = self._context.make(self.number, lambda: not self._stopping)
                self.player.begin()
            self._request(self.player)
        except (ActiveLSDError, ClosedError):
            raise
        except Exception:  # noqa: BLE001  a player in this process; its own traceback helps most
            raise AgentLost(f"failed:\n{traceback.format_exc()}") from None
        finally:
            if self.player is not None:
                player, self.player = self.player, None
                player.close()

    def _request(self, player: Stepper) -> None:
        """Request actions for every lane, and again for each lane whose step is done."""
        requests, unanswered = self._context.requests, 0
        try:
            for lane in range(len(self.writers)):
                requests.put((self.number, lane))
                unanswered += 1
            while not self._stopping:
                lane = player.wait()
                self._answered.acquire()
                unanswered -= 1
                requests.put((self.number, lane))
                unanswered += 1
        finally:  # a process may die before its answer; until then the slots belong to the predictor
            for _ in range(unanswered):
                self._answered.acquire()

    def _record_loss(self, loss: AgentLost, lost: int) -> None:
        """Count and log a lost player. Raises TrainingError if there were too many."""
        context, who = self._context, f"Agent {self.number} ({self._context.world})"
        steps = sum(writer.drop() for writer in self.writers)
        context.gauges.count(agents_lost=1, steps_lost=steps)
        if lost > context.restarts:
            raise TrainingError(
                f"{who} was lost {lost} times, more than train.ga3c.restarts={context.restarts}; fix the"
                f" environment and resume from the last checkpoint. The last time it {loss}"
            )
        log.warning(
            "%s %s\nIt is started again (%d of %d times); %d steps of unfinished trajectories are lost.",
            who,
            loss,
            lost,
            context.restarts,
            steps,
        )
