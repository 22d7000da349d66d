"""Steps per second of agents in live rooms, of training on recordings of them, and of the bare network.

The bare network acts on and learns from observations that are in memory already. Resident actors play the
recordings, GA3C's agents a simulator each, in processes of their own. All take turns, so a machine that slows
down slows all. The room is the stand-in's; any other words of `activelsd train` may follow.

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
"""Steps before anything is measured."""

Kind = Callable[[RunConfig, OpenWorld], AbstractContextManager[Callable[[], int]]]


@contextmanager
def bare(config: RunConfig, world: OpenWorld) -> Iterator[Callable[[], int]]:
    """Acts on a batch of views and learns from it, over and over; the steps that it stands for."""
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
    """The trainer with all it does; the steps of an update."""
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
    """Steps per second after so many steps."""
    while warm > 0:
        warm -= step()
    began, steps = time.monotonic(), 0
    while time.monotonic() - began < seconds:
        steps += step()
    return steps / (time.monotonic() - began)


def main() -> None:
    """Print a row each: steps per second, and how many times those of the live rooms."""
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
    found = {name: statistics.median(one[name] for one in rounds) for name in kinds}
    fastest = max(value for name, value in found.items() if name.endswith("live"))
    for name, value in found.items():
        print(f"{name:20} {value:8.0f} steps/s   {value / fastest:6.1f} x live")


if __name__ == "__main__":
    main()
