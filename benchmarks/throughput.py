"""Steps per second of the trainer beside what the bare network allows on the same machine, in one run.

The bare network does, for every step, one acting forward and one learning forward with its backward and the
optimiser, at the best of several batch sizes, on frames already in memory. The trainer does everything:
episodes, exploration, losses, statistics. Both take turns, so a machine that slows down slows both.

    python benchmarks/throughput.py --seconds 5 --rounds 3
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import tree_of
from activelsd.envs.modelnet.env import modelnet_graph
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.resident import on_graph
from activelsd.train.run import Run
from activelsd.train.settings import TrainSettings
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer, new_network

BATCHES = (64, 128, 192, 320)


def bare_step(network: LSDNet, batch: int) -> Callable[[], int]:
    """One acting forward and one learning step over a batch; gives the environment steps it stands for."""
    shape = network.shape
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (1, batch, shape.frames, shape.size, shape.size), dtype=np.uint8)
    observation = {"frames": torch.from_numpy(frames), "target": torch.ones(1, batch, shape.frames, 5)}
    state, first = network.initial_state(batch), torch.ones(1, batch, dtype=torch.bool)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-6)

    def step() -> int:
        with torch.no_grad():
            network(observation, state, first)
        output = network(observation, state, first)
        loss = output.logits.square().mean() + output.value.square().mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        return batch

    return step


def trainer_step(trainer: Trainer, sums: Statistics) -> Callable[[], int]:
    """One update of the trainer."""
    settings = trainer.settings

    def step() -> int:
        trainer._update(sums)
        return settings.envs * settings.length

    return step


def rate(step: Callable[[], int], seconds: float) -> tuple[float, float]:
    """Steps per second of wall time and of CPU time."""
    for _ in range(3):
        step()
    wall, cpu, done = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - wall < seconds:
        done += step()
    return done / (time.perf_counter() - wall), done / (time.process_time() - cpu)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="per measurement")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1, help="torch threads")
    parser.add_argument("--memory", default="pool", choices=("pool", "lstm", "stack"))
    options = parser.parse_args()
    torch.set_num_threads(options.threads)

    graph = modelnet_graph(train_per_class=20, test_per_class=2)
    shape = NetworkShape(memory=options.memory, frames=3 if options.memory == "stack" else 1)
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(Path(folder), "throughput", "")
        settings = TrainSettings(steps=10**9)
        actors = on_graph(graph, PRESETS["V4"], settings, frames=shape.frames)
        trainer = Trainer(run, tree_of(graph), shape, settings, actors, seed=0)
        contestants = {
            f"bare network, batch {b}": bare_step(new_network(trainer.network.tree, shape, 0), b)
            for b in BATCHES
        }
        contestants["trainer"] = trainer_step(trainer, Statistics())
        rates: dict[str, list[tuple[float, float]]] = {name: [] for name in contestants}
        for _ in range(options.rounds):
            for name, step in contestants.items():
                rates[name].append(rate(step, options.seconds))
    median = {
        name: tuple(statistics.median(column) for column in zip(*rows, strict=True))
        for name, rows in rates.items()
    }
    print(f"{options.memory} memory, {options.threads} torch thread(s)")
    for name, (wall, cpu) in median.items():
        print(f"{name:28} {wall:8.0f} steps/s   {cpu:8.0f} steps per CPU-second")
    for i, clock in enumerate(("wall", "CPU")):
        best = max(values[i] for name, values in median.items() if name != "trainer")
        print(f"trainer / best bare network, {clock} time: {median['trainer'][i] / best:.2f}")


if __name__ == "__main__":
    main()
