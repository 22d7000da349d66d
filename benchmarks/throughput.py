"""Steps per second of the trainer beside what the bare network allows on the same machine, in one run.

The bare network does, for every step, one acting forward and one learning forward with its backward and the
optimiser, at the best of several batch sizes, on frames already in memory. The trainer does everything:
episodes, exploration, losses, statistics; with resident actors, and with GA3C's in threads and in processes.
All take turns (GA3C's agents stand still at a full training queue meanwhile), so a machine that slows down
slows all. CPU time is that of this process: what GA3C's processes spend on their environments is not in it.

    python benchmarks/throughput.py --seconds 5 --rounds 3
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import Recording
from activelsd.envs.modelnet.env import modelnet_graph
from activelsd.envs.viewgraph import ViewGraph
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.ga3c.actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.actors.protocol import MakeActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.run import Run
from activelsd.train.settings import GA3CSettings, TrainSettings
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer, new_network

BATCHES = (64, 128, 192, 320)
WORLD: dict[str, Any] = {"train_per_class": 20, "test_per_class": 2}


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

    def step() -> int:
        before = trainer.step
        trainer._update(sums)
        return trainer.step - before

    return step


def ga3c(
    graph: ViewGraph,
    frames: int,
    settings: TrainSettings,
    kind: Literal["processes", "threads"],
    options: argparse.Namespace,
) -> MakeActors:
    """GA3C's actors with as many episodes side by side as the resident ones."""
    envs = settings.envs // options.agents
    chosen = GA3CSettings(kind=kind, agents=options.agents, envs_per_agent=envs)
    world: EnvSpec | Callable[[], ViewGraphEnv]
    if kind == "threads":
        world = lambda: ViewGraphEnv(graph, PRESETS["V4"], frames=frames)  # noqa: E731
    else:
        kwargs = {"rules": "V4", "frames": frames, **WORLD}
        world = EnvSpec(id="activelsd.envs:activelsd/ModelNet-v0", kwargs=kwargs, tree=tree_of(graph))
    return lambda network, seed: GA3CActors(world, network, chosen, settings.length, seed)


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
    parser.add_argument("--agents", type=int, default=4, help="of ga3c; the episodes are dealt out to them")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)

    graph = modelnet_graph(**WORLD)
    shape = NetworkShape(memory=options.memory, frames=3 if options.memory == "stack" else 1)
    settings, world = TrainSettings(steps=10**9), Recording("modelnet", graph, PRESETS["V4"])
    crews = {
        "resident": on_recordings([world], settings, frames=shape.frames),
        "ga3c, threads": ga3c(graph, shape.frames, settings, "threads", options),
        "ga3c, processes": ga3c(graph, shape.frames, settings, "processes", options),
    }
    contestants = {
        f"bare network, batch {b}": bare_step(new_network(tree_of(graph), shape, 0), b) for b in BATCHES
    }
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(Path(folder), "throughput", "")
        trainers = {
            name: Trainer(run, tree_of(graph), shape, settings, crew, seed=0) for name, crew in crews.items()
        }
        contestants |= {name: trainer_step(trainer, Statistics()) for name, trainer in trainers.items()}
        rates: dict[str, list[tuple[float, float]]] = {name: [] for name in contestants}
        for _ in range(options.rounds):
            for name, step in contestants.items():
                rates[name].append(rate(step, options.seconds))
        for trainer in trainers.values():
            trainer.actors.close()
    median = {
        name: tuple(statistics.median(column) for column in zip(*rows, strict=True))
        for name, rows in rates.items()
    }
    print(f"{options.memory} memory, {options.threads} torch thread(s)")
    for name, (wall, cpu) in median.items():
        print(f"{name:28} {wall:8.0f} steps/s   {cpu:8.0f} steps per CPU-second")
    for i, clock in enumerate(("wall", "CPU")):
        best = max(values[i] for name, values in median.items() if name not in crews)
        for name in crews:
            print(f"{name} / best bare network, {clock} time: {median[name][i] / best:.2f}")


if __name__ == "__main__":
    main()
