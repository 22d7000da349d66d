"""The training loop: play, learn, log, validate, save, until the steps are done."""

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
from torch import Tensor

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
from activelsd.train.rollout import Rollout
from activelsd.train.run import Run
from activelsd.train.settings import Annealed, TrainSettings
from activelsd.train.statistics import Counts, Statistics, counts

Evaluate = Callable[[LSDNet], dict[str, float]]
"""Measures a network on the validation split; its figures are logged as `val/…`."""


def new_network(tree: ActionTree, shape: NetworkShape, seed: int) -> LSDNet:
    """A network whose first weights depend on the seed alone."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = LSDNet(tree, shape)
        network.check_parts()
        return network


class Trainer:
    """Trains one network on what actors play, and writes everything into a run's folder.

    All seeds are derived from one: of the first weights, and of the episodes and actions drawn. In a group of
    processes each plays its own episodes; the first process writes, and logs metrics of its own episodes.
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
        """Build everything, or, to resume, load it from the run's newest checkpoint.

        Raises:
            ConfigError: CUDA graphs are asked for in a group of processes, or a part does not fit.
            RunError: the checkpoint does not fit the world or the settings.
        """
        if settings.cuda_graphs and group.size > 1:
            raise ConfigError("train.cuda_graphs=true works in one process only; leave it out.")
        self.run, self.settings, self._evaluate = run, settings, evaluate
        self._group, self._device = group, torch.device(device)
        terms_seed = int(np.random.SeedSequence(seed, spawn_key=(0,)).generate_state(1)[0])
        weights_seed, *play_seeds = np.random.SeedSequence(seed).generate_state(1 + group.size).tolist()
        self.step, self._seconds = 0, 0.0
        if resume:
            self.network = load_network(run.checkpoint, device)
            if self.network.tree != tree:
                raise RunError(
                    f"{run.folder} was trained with other classes or moves than its world has now:"
                    f" {self.network.tree.differences(tree)}."
                )
        else:
            self.network = new_network(tree, shape, weights_seed).to(device)
        if settings.compile:
            self.network.compile()
        self.learner = Learner(self.network, settings, group, seed=terms_seed)
        self.actors = make_actors(self.network, play_seeds[group.rank])
        if resume:
            self._restore()
        self._once: Callable[[Annealed], Counts] = self._play_and_learn
        graph = self._device.type == "cuda" and group.size == 1 and settings.cuda_graphs is not False
        if graph and isinstance(self.actors, ResidentActors):  # other actors wait for the device
            self._once = GraphedUpdate(self._play_and_learn, self.actors, self._device)

    def train(self) -> None:
        """Run until the steps are done.

        Raises:
            TrainingError: the loss is no longer finite; the last checkpoint may still be good.
            KeyboardInterrupt: the user stopped the run; a checkpoint was written first.
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
        # With several updates, the weights of all but the first are others than those that acted.
        several = self.settings.trajectories if isinstance(self.actors, ResidentActors) else None
        with self._precision(), torch.set_grad_enabled(several is None):
            rollout = self._with_output(self.actors.collect(Epsilon(now.epsilon_branch, now.epsilon_leaf)))
        if several is None:
            losses = self.learner.update(rollout, now)
        else:
            losses = self._learn_in_turn(replace(rollout, output=None), several, now)
        return counts(rollout, self.network, losses, self.actors.places)

    def _learn_in_turn(self, rollout: Rollout, several: int, now: Annealed) -> dict[str, Tensor]:
        """An update for every so many columns; returns the means of their losses."""
        each = []
        for start in range(0, rollout.first.shape[1], several):
            part = rollout.columns(slice(start, start + several))
            with self._precision():
                part = self._with_output(part)
            each.append(self.learner.update(part, now))
        return {name: torch.stack([losses[name] for losses in each]).mean() for name in each[0]}

    def _with_output(self, rollout: Rollout) -> Rollout:
        """The rollout with the network's pass."""
        return rollout if rollout.output else replace(rollout, output=self.learner.output(rollout))

    def _precision(self) -> torch.autocast:
        return torch.autocast(self._device.type, torch.bfloat16, enabled=self.settings.amp)

    def _passed(self, before: int, every: int) -> bool:
        return before // every != self.step // every or self.step >= self.settings.steps

    def _log(self, loggers: list[Logger], statistics: Statistics, rate: float) -> None:
        metrics = statistics.read() | self.actors.measures()
        if not math.isfinite(metrics["loss/total"]):
            terms = " and ".join(f"term '{name}'" for name in self.learner.broken_terms())
            raise TrainingError(
                f"The loss {terms or 'as a whole'} is no longer finite at step {self.step}; lower "
                f"{'its weight in train.terms or ' if terms else ''}train.learning_rate, or set "
                "train.clip_norm, then train again."
            )
        self._write(loggers, metrics | {"steps_per_second": rate, "seconds": self._seconds})

    def _write(self, loggers: list[Logger], metrics: dict[str, float]) -> None:
        for logger in loggers:
            logger.write(self.step, metrics)

    def save(self) -> None:
        """Write a checkpoint from which training resumes to the bit."""
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
                f"{self.run.checkpoint} does not fit its own settings ({error}); train a new run."
            ) from None


@contextmanager
def _stop_requested() -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether Ctrl-C or SIGTERM came; a second Ctrl-C interrupts at once."""
    requested = False

    def request(number: int, frame: FrameType | None) -> None:
        nonlocal requested
        if requested and number == signal.SIGINT:
            raise KeyboardInterrupt
        requested = True

    try:
        before = {number: signal.signal(number, request) for number in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # signals can be handled in the main thread only
        before = {}
    try:
        yield lambda: requested
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
