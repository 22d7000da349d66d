"""Steps per second of agents in live rooms, of training on recordings of them, and of the network alone.

The network alone acts on and learns from observations that are already in memory. Resident actors play the
recordings; each GA3C agent runs a simulator in its own process. All take turns, so that a slower machine
slows all of them. The room is the stand-in's; further settings of `activelsd train` may follow.

    python benchmarks/live.py --agents 2 4 --seconds 10 --rounds 3 env.scenes.train=1 env.scenes.test=1
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import torch

from activelsd.build import build_actors, build_shape
from activelsd.compose import resolve
from activelsd.config import RunConfig
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld, play_recordings
from activelsd.launch import open_worlds
from activelsd.train.run import Run
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer, new_network

WARM = 2_000
"""Warm-up steps before a measurement."""

Kind = Callable[[RunConfig, OpenWorld], AbstractContextManager[Callable[[], int]]]


@contextmanager
def bare(config: RunConfig, world: OpenWorld) -> Iterator[Callable[[], int]]:
    """Gives a function that acts on a batch of views, learns from it, and returns the number of steps."""
    shape = build_shape(config.policy, world.graph)
    network = new_network(tree_of(world.graph), shape, 0)
    env = play_recordings([world], num_envs=64, frames=shape.frames)
    env.begin(0)
    observation = {name: value[None] for name, value in env.observe().items()}
    state, first = network.initial_state(64), torch.ones(1, 64, dtype=torch.bool)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-6)

    def step() -> int:
        with torch.no_grad():
            network(observation, state, first)
        output = network(observation, state, first)
        optimiser.zero_grad(set_to_none=True)
        (output.logits.square().mean() + output.value.square().mean()).backward()
        optimiser.step()
        return 64

    yield step


@contextmanager
def trained(config: RunConfig, world: OpenWorld) -> Iterator[Callable[[], int]]:
    """Gives a function that runs one full trainer update and returns the number of steps."""
    shape, sums = build_shape(config.policy, world.graph), Statistics()
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(Path(folder), "live", "")
        make = build_actors(config, [world], "cpu")
        trainer = Trainer(run, tree_of(world.graph), shape, config.train, make, seed=0)

        def step() -> int:
            before = trainer.step
            trainer._update(sums)
            return trainer.step - before

        try:
            yield step
        finally:
            trainer.actors.close()


def rate(step: Callable[[], int], warm: int, seconds: float) -> float:
    """Steps per second, measured after `warm` steps."""
    while warm > 0:
        warm -= step()
    began, steps = time.monotonic(), 0
    while time.monotonic() - began < seconds:
        steps += step()
    return steps / (time.monotonic() - began)


def main() -> None:
    """Prints a row for each: steps per second, and the ratio to the fastest live one."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--agents", type=int, nargs="+", default=[2, 4])
    parser.add_argument("--seconds", type=float, default=10.0, help="per measurement")
    parser.add_argument("--rounds", type=int, default=3)
    options, words = parser.parse_known_args()
    torch.set_num_threads(1)

    words = ["env=thor", "env.backend=standin", "train.steps=1000000000", *words]
    config = resolve(words)
    (world,) = open_worlds(config)
    kinds: dict[str, Callable[[], float]] = {}

    def measured(name: str, how: RunConfig, kind: Kind, warm: int) -> None:
        def measure() -> float:
            with kind(how, world) as step:
                return rate(step, warm, options.seconds)

        kinds[name] = measure

    measured("bare network", config, bare, WARM)
    measured("resident, recorded", config, trained, WARM)
    for agents in options.agents:
        live = ["env.live=true", "train.actors=ga3c", f"train.ga3c.agents={agents}"]
        measured(f"{agents} agents, live", resolve([*words, *live]), trained, WARM // 10)

    rounds = [{name: measure() for name, measure in kinds.items()} for _ in range(options.rounds)]
    medians = {name: statistics.median(one[name] for one in rounds) for name in kinds}
    fastest = max(value for name, value in medians.items() if name.endswith("live"))
    for name, value in medians.items():
        print(f"{name:20} {value:8.0f} steps/s   {value / fastest:6.1f} x live")


if __name__ == "__main__":
    main()
