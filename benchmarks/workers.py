"""Steps per second of the trainer with resident actors and with Ray's workers on this machine, in turns.

All play the same number of episodes in parallel: 64, divided among the workers. The learner has one PyTorch
thread, as each worker has. Prints a row each: steps per second, and for Ray the share of the time that the
learner waits, and its lag in updates.

    python benchmarks/workers.py --workers 1 2 --seconds 10 --rounds 3
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.envs.world import world_settings
from activelsd.policy.lsdnet import NetworkShape
from activelsd.train.actors.interface import MakeActors
from activelsd.train.actors.ray.ray_actors import RayActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import RaySettings, TrainSettings
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer

WORLD: dict[str, Any] = {
    "train_per_class": 20,
    "test_per_class": 2,
    "navigate": ["orbit_cw", "orbit_ccw"],
}


def worlds() -> list[OpenWorld]:
    """The worlds that are played."""
    return [OpenWorld("modelnet", world_settings("modelnet", WORLD).open(), PRESETS["V4"])]


def measure(workers: int, seconds: float) -> tuple[float, dict[str, float]]:
    """Steps per second once all play, and the actors' measures; no workers: resident actors."""
    here, envs = worlds(), TrainSettings().envs
    make: MakeActors
    if workers:
        own = RaySettings(workers=workers, envs_per_worker=envs // workers)
        settings = TrainSettings(steps=10**9, actors="ray", ray=own)
        make = lambda network, seed: RayActors(worlds, here, network, settings, seed)  # noqa: E731
    else:
        settings = TrainSettings(steps=10**9)
        make = on_recordings(here, settings, frames=1)
    tree, sums = tree_of(here[0].graph), Statistics()
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(Path(folder), "workers", "")
        trainer = Trainer(run, tree, NetworkShape(), settings, make, seed=0)
        try:
            while trainer.step < 5_000 or trainer.actors.measures().get("ray/workers", 0) < workers:
                trainer._update(sums)
            began, before = time.monotonic(), trainer.step
            while time.monotonic() - began < seconds:
                trainer._update(sums)
            return (trainer.step - before) / (time.monotonic() - began), trainer.actors.measures()
        finally:
            trainer.actors.close()


def main() -> None:
    """Print the table."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--seconds", type=float, default=10.0, help="per measurement")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(1)

    counts = [0, *options.workers]
    found: dict[int, list[tuple[float, dict[str, float]]]] = {workers: [] for workers in counts}
    for _ in range(options.rounds):
        for workers in counts:
            found[workers].append(measure(workers, options.seconds))
    for workers, rounds in found.items():
        rate = statistics.median(rate for rate, _ in rounds)
        shown = "".join(
            f"  {name} {statistics.median(measures[f'ray/{name}'] for _, measures in rounds):.2f}"
            for name in ("learner_idle", "lag", "lag_max")
            if workers
        )
        print(f"{f'{workers} workers' if workers else 'resident':12} {rate:7.0f} steps/s{shown}")


if __name__ == "__main__":
    main()
