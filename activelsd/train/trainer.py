"""The training loop: play, learn, log, look at the validation split, save, until the steps are done."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import FrameType

import numpy as np
import torch

from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError, RunError, TrainingError
from activelsd.policy.checkpoint import load_network
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.interface import MakeActors
from activelsd.train.actors.resident import ResidentActors
from activelsd.train.cudagraph import GraphedUpdate
from activelsd.train.learner import Learner
from activelsd.train.logging import Logger, open_loggers
from activelsd.train.parallel import ALONE, Group
from activelsd.train.run import Run
from activelsd.train.settings import Annealed, TrainSettings
from activelsd.train.statistics import Counts, Statistics, counts

Evaluate = Callable[[LSDNet], dict[str, float]]
"""Looks at the validation split; its figures are logged as `val/…`."""


def new_network(tree: ActionTree, shape: NetworkShape, seed: int) -> LSDNet:
    """A network whose first weights follow from the seed alone."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return LSDNet(tree, shape)


class Trainer:
    """Trains one network by what actors play, and leaves everything in a run's folder.

    One seed is fanned out: to the first weights, and to the episodes and actions drawn. Of a group of
    processes each plays episodes of its own; the first writes, and what it logs is of its own episodes.
    """

    def __init__(
        self,
        run: Run,
        tree: ActionTree,
        shape: NetworkShape,
        settings: TrainSettings,
        make_actors: MakeActors,
        *,
        seed: int,
        device: str = "cpu",
        evaluate: Evaluate | None = None,
        resume: bool = False,
        group: Group = ALONE,
    ) -> None:
        """Build everything, or, to resume, take it back from the run's newest checkpoint.

        Raises:
            ConfigError: of several processes each is to be one CUDA graph.
            RunError: the checkpoint is of another world or other settings.
        """
        if settings.cuda_graphs and group.size > 1:
            raise ConfigError("train.cuda_graphs=true is for one process that learns; leave it out.")
        self.run, self.settings, self._evaluate = run, settings, evaluate
        self._group, self._device = group, torch.device(device)
        weights_seed, *play_seeds = np.random.SeedSequence(seed).generate_state(1 + group.size).tolist()
        self.step, self._seconds = 0, 0.0
        if resume:
            self.network = load_network(run.checkpoint, device)
            if self.network.tree != tree:
                raise RunError(
                    f"{run.folder} was trained with other classes or moves than its world has now."
                )
        else:
            self.network = new_network(tree, shape, weights_seed).to(device)
        if settings.compile:
            self.network.compile()
        self.learner = Learner(self.network, settings, group)
        self.actors = make_actors(self.network, play_seeds[group.rank])
        if resume:
            self._restore()
        self._once: Callable[[Annealed], Counts] = self._play_and_learn
        graph = self._device.type == "cuda" and group.size == 1 and settings.cuda_graphs is not False
        if graph and isinstance(self.actors, ResidentActors):  # others wait for the device
            self._once = GraphedUpdate(self._play_and_learn, self.actors, self._device)

    def train(self) -> None:
        """Run until the steps are done.

        Raises:
            TrainingError: the loss is not finite any more; the last checkpoint is from before.
            KeyboardInterrupt: the user asked to stop; a checkpoint was written first.
        """
        settings, writes = self.settings, self._group.rank == 0
        loggers = (
            open_loggers(settings.loggers, self.run.folder, up_to=self.step, total=settings.steps)
            if writes
            else []
        )
        statistics, since, window = Statistics(self.actors.places), self.step, time.monotonic()
        try:
            with _stop_requested() as stop:
                while self.step < settings.steps and not self._group.any(stop()):
                    before = self.step
                    self._update(statistics)
                    if self._passed(before, settings.log_every):
                        now = time.monotonic()
                        self._seconds += now - window
                        self._log(loggers, statistics, (self.step - since) / (now - window))
                        since, window = self.step, now
                    if self._passed(before, settings.checkpoint_every):
                        self.save()
                    if writes and self._evaluate and self._passed(before, settings.evaluate_every):
                        paused = time.monotonic()
                        self._write(loggers, {f"val/{k}": v for k, v in self._evaluate(self.network).items()})
                        window += time.monotonic() - paused
                self.save()
                if self.step < settings.steps:
                    raise KeyboardInterrupt
        finally:
            self.actors.close()
            for logger in loggers:
                logger.close()

    def _update(self, statistics: Statistics) -> None:
        update = self._once(self.settings.at(self.step / self.settings.steps))
        statistics.add(update)
        self.step += update.steps * self._group.size

    def _play_and_learn(self, now: Annealed) -> Counts:
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.settings.amp):
            rollout = self.actors.collect(Epsilon(now.epsilon_branch, now.epsilon_leaf))
            if rollout.output is None:
                rollout = replace(rollout, output=self.learner.output(rollout))
        losses = self.learner.update(rollout, now)
        return counts(rollout, self.network, losses, self.actors.places)

    def _passed(self, before: int, every: int) -> bool:
        return before // every != self.step // every or self.step >= self.settings.steps

    def _log(self, loggers: list[Logger], statistics: Statistics, rate: float) -> None:
        metrics = statistics.read() | self.actors.measures()
        if not math.isfinite(metrics["loss/total"]):
            raise TrainingError(
                f"The loss is no longer finite at step {self.step}; lower train.learning_rate or set "
                f"train.clip_norm, then train again."
            )
        self._write(loggers, metrics | {"steps_per_second": rate, "seconds": self._seconds})

    def _write(self, loggers: list[Logger], metrics: dict[str, float]) -> None:
        for logger in loggers:
            logger.write(self.step, metrics)

    def save(self) -> None:
        """Write a checkpoint that resumes to the bit."""
        tensors = {f"learner/{k}": v for k, v in self.learner.state().items()}
        tensors |= {f"actors/{k}": v for k, v in self._group.gathered(self.actors.state()).items()}
        if self._group.rank == 0:
            self.run.save(self.step, self.network, tensors, {"seconds": self._seconds})

    def _restore(self) -> None:
        tensors, progress = self.run.load_training()

        def part(name: str) -> dict[str, torch.Tensor]:
            return {k.removeprefix(name): v for k, v in tensors.items() if k.startswith(name)}

        self.step, self._seconds = int(progress["step"]), float(progress["seconds"])
        try:
            self.learner.load_state(part("learner/"))
            self.actors.load_state(self._group.own(part("actors/")))
        except (KeyError, ValueError, RuntimeError) as error:
            raise RunError(
                f"{self.run.checkpoint} does not fit its own settings ({error}); train afresh."
            ) from None


@contextmanager
def _stop_requested() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C or SIGTERM into a question the loop asks; a second Ctrl-C interrupts at once."""
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked and number == signal.SIGINT:
            raise KeyboardInterrupt
        asked = True

    try:
        before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # not the main thread: whoever runs it there stops it there
        before = {}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
