"""Steps per second of the trainer, of the network alone, and of other frameworks, in one run.

The network alone runs on frames already in memory: "acting" is a forward pass, "learning" is forward,
backward and optimiser step, each with the best of several batch sizes and memory layouts, found first. On a
GPU (`--device cuda`) each is one CUDA graph, like the trainer's update there. The trainer does its full work
(episodes, exploration, losses, statistics), with resident actors and with GA3C in threads and in processes.
So do the other frameworks, if installed: Stable-Baselines3's A2C and Sample Factory's APPO, with the same
observations, network size, number of environments and rollout length. Both use this project's trunk and
layout, to compare trainers; A2C also runs with the same trunk in plain PyTorch, to compare what users get.

All take turns, each in its own process (GA3C's agents wait at a full training queue meanwhile), so that a
slower machine slows all of them. CPU time is that of the contestant's main process, without the environments
in GA3C's processes.

`--policy paper` measures AlexNet at 224 px as `train=paper` trains it, by itself and with resident actors.

With `--trunk timm:NAME --weights FILE` the trainer also plays on recorded features of that trunk, and the
network alone learns from them; their values are made up, which changes no time.

    python benchmarks/throughput.py --seconds 3 --rounds 3
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from rates import MakeStep, Rate, Step, in_processes, in_turns

from activelsd.compose import resolve
from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.envs.viewgraph import ViewGraph
from activelsd.envs.world import world_settings
from activelsd.policy.lsdnet import NetworkShape, make_trunk
from activelsd.policy.trunks import ViewTrunk
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.actors.interface import MakeActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.cudagraph import WARM_UPS, warm_up
from activelsd.train.run import Run
from activelsd.train.settings import GA3CSettings, TrainSettings
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer, new_network

BATCHES = (1, 2, 3, TrainSettings().length)
"""Batch sizes tried for the network alone, as multiples of the number of episodes."""

LAYOUTS = {"channels last": torch.channels_last, "channels first": torch.contiguous_format}
WORLD: dict[str, Any] = {
    "train_per_class": 20,
    "test_per_class": 2,
    "navigate": ["orbit_cw", "orbit_ccw"],
}
PARTS = ("acting", "learning")
Actors = Literal["resident", "threads", "processes"]
RESIDENT, THREADS, PROCESSES = "resident", "ga3c, threads", "ga3c, processes"
ACTORS: dict[str, Actors] = {RESIDENT: "resident", THREADS: "threads", PROCESSES: "processes"}
ON_GPU = {"kernel by kernel": {"cuda_graphs": False}, "compiled": {"compile": True}}
ON_FEATURES, BARE = "recorded features", "learning alone on features"
BFLOAT16 = {"bfloat16": {"amp": True}}
A2C, APPO = "Stable-Baselines3 A2C", "Sample Factory APPO, this trunk"
A2C_FAST = f"{A2C}, this trunk"


@cache
def graph(size: int = 64, features: int | None = None) -> ViewGraph:
    """The recorded views of the benchmark's world, with made-up features of that width if it is given."""
    if features is not None:
        plain = graph(size)
        drawn = np.random.default_rng(0).random((len(plain.frames) + 1, features)).astype(np.float16)
        return replace(plain, features=(drawn,))
    return world_settings("modelnet", WORLD | {"size": size}).open()


def embedding(shape: NetworkShape) -> int | None:
    """Width of a frozen trunk's features of a view; None for a trunk that learns."""
    trunk = make_trunk(shape)
    return int(trunk.embedding) if isinstance(trunk, ViewTrunk) and trunk.frozen else None


def one_env(frames: int) -> ViewGraphEnv:
    """A single environment."""
    return ViewGraphEnv(graph(), PRESETS["V4"], frames=frames)


def bare(shape: NetworkShape, batch: int, layout: str, device: str) -> tuple[Step, Step]:
    """Functions for an acting pass and a learning step on a batch; on a GPU each is a CUDA graph."""
    network = new_network(tree_of(graph()), shape, 0).to(device)
    network.to(memory_format=LAYOUTS[layout])  # type: ignore[call-overload]
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (1, batch, shape.frames, shape.size, shape.size), dtype=np.uint8)
    boxes = torch.ones(1, batch, shape.frames, 5, device=device)
    observation = {"frames": torch.from_numpy(frames).to(device), "target": boxes}
    width = embedding(shape)
    if width is not None:
        drawn = torch.rand(1, batch, shape.frames, width, device=device).half()
        observation = {"features": drawn, "target": boxes}
    state, first = network.initial_state(batch), torch.ones(1, batch, dtype=torch.bool, device=device)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-6, capturable=device == "cuda")

    @torch.no_grad()
    def act() -> None:
        network(observation, state, first)

    def learn() -> None:
        output = network(observation, state, first)
        loss = output.logits.square().mean() + output.value.square().mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()

    def step(part: Callable[[], None]) -> Step:
        def one() -> int:
            run()
            return batch

        run = replayed(part) if device == "cuda" else part
        return one

    return step(act), step(learn)


def replayed(part: Callable[[], None]) -> Callable[[], None]:
    """Captures a function as a CUDA graph; returns a function that replays it."""
    for _ in range(WARM_UPS):
        warm_up(part)
    captured = torch.cuda.CUDAGraph()
    with torch.cuda.graph(captured):
        part()

    def replay(_keep: object = part) -> None:  # keeps the graph's tensors alive
        captured.replay()

    return replay


@contextmanager
def best_bare(
    part: str, shape: NetworkShape, envs: int, device: str, seconds: float, rounds: int
) -> Iterator[Step]:
    """Gives acting or learning with the batch size and layout that were the fastest in a trial."""
    candidates = {
        (times * envs, layout): bare(shape, times * envs, layout, device)[PARTS.index(part)]
        for times in BATCHES
        for layout in LAYOUTS
    }
    rates = in_turns(candidates, seconds, rounds)
    best = max(rates, key=lambda which: rates[which].cpu if device == "cpu" else rates[which].wall)
    print(f"{part} alone is fastest at a batch of {best[0]}, {best[1]}", flush=True)
    yield candidates[best]


@contextmanager
def trainer(
    shape: NetworkShape, settings: TrainSettings, actors: Actors, agents: int, device: str
) -> Iterator[Step]:
    """Gives a function that runs one update of the trainer."""
    if actors == "resident":
        world = OpenWorld("modelnet", graph(shape.size, embedding(shape)), PRESETS["V4"])
        make_actors = on_recordings([world], settings, frames=shape.frames, device=device)
    else:
        make_actors = ga3c(shape, settings, actors, agents)
    with tempfile.TemporaryDirectory() as folder:
        run, sums = Run.create(Path(folder), "throughput", ""), Statistics()
        made = Trainer(run, tree_of(graph()), shape, settings, make_actors, seed=0, device=device)

        def step() -> int:
            before = made.step
            made._update(sums)
            return made.step - before

        yield step
        made.actors.close()


def ga3c(
    shape: NetworkShape, settings: TrainSettings, kind: Literal["processes", "threads"], agents: int
) -> MakeActors:
    """GA3C's actors, with as many parallel episodes as the resident ones."""
    chosen = GA3CSettings(kind=kind, agents=agents, envs_per_agent=settings.envs // agents)
    world: EnvSpec | Callable[[], ViewGraphEnv] = partial(one_env, shape.frames)
    if kind == "processes":
        kwargs = {"world": "modelnet", "frames": shape.frames, **WORLD}
        world = EnvSpec(id="activelsd.envs:activelsd/World-v0", kwargs=kwargs, tree=tree_of(graph()))
    return lambda network, seed: GA3CActors(world, network, chosen, settings.length, seed)


def others(shape: NetworkShape, settings: TrainSettings, device: str) -> dict[str, MakeStep]:
    """The installed frameworks; prints how to install the missing ones."""
    found: dict[str, MakeStep] = {}
    make = partial(one_env, shape.frames)
    try:
        from outside_a2c import Fast, Plain, a2c

        found[A2C] = partial(a2c, make, shape, settings, Plain, device)
        found[A2C_FAST] = partial(a2c, make, shape, settings, Fast, device)
    except ModuleNotFoundError as error:
        print(f"without {A2C} ({error}): pip install -c constraints.txt -e '.[test]'")
    try:
        from outside_appo import appo

        found[APPO] = partial(appo, make, shape, settings, device)
    except ModuleNotFoundError as error:
        # It requires Gymnasium < 1.0 and NumPy < 2, but also runs with this Gymnasium, and with any NumPy
        # that still converts arrays of one element to numbers.
        print(
            f"without {APPO} ({error}): in a separate environment, pip install --no-deps "
            "sample-factory==2.1.1 faster-fifo signal-slot-mp colorlog tensorboardX psutil threadpoolctl "
            "'numpy<2.4'"
        )
    return found


def report(rates: Mapping[str, Rate]) -> None:
    """Prints the rates and the ratios between them."""
    acting, learning = (rates[f"{part} alone"] for part in PARTS)
    both = Rate(*(1 / (1 / act + 1 / learn) for act, learn in zip(acting, learning, strict=True)))
    for name, rate in ({**rates, "acting plus learning": both}).items():
        print(f"{name:42} {rate.wall:7.0f} steps/s {1e6 / rate.cpu:7.0f} us of CPU per step")
    residents = [name for name in rates if name.startswith(RESIDENT)]
    ratios = [
        *((name, "learning alone", learning) for name in residents),
        *((name, "acting plus learning", both) for name in (*residents, THREADS, PROCESSES) if name in rates),
        *((one, name, rates[name]) for one in residents for name in (A2C, A2C_FAST, APPO) if name in rates),
        *((one, name, rates[name]) for one in (ON_FEATURES,) if one in rates for name in (RESIDENT, BARE)),
    ]
    for name, reference, rate in ratios:
        wall, cpu = (one / other for one, other in zip(rates[name], rate, strict=True))
        print(f"{name} / {reference}: {wall:.2f} by wall time, {cpu:.2f} by CPU time")


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=3.0, help="per measurement")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1, help="torch threads")
    parser.add_argument(
        "--policy", default="default", choices=("default", "paper"), help="network and losses"
    )
    parser.add_argument("--memory", default="pool", choices=("pool", "lstm", "stack"))
    parser.add_argument(
        "--amp",
        action="store_true",
        help="also measure resident actors in bfloat16, for processors that support it",
    )
    parser.add_argument(
        "--agents", type=int, default=4, help="GA3C agents; the episodes are split among them"
    )
    parser.add_argument("--envs", type=int, default=TrainSettings().envs, help="number of parallel episodes")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--trunk", help="also play on recorded features of this trunk, as timm:NAME")
    parser.add_argument("--weights", help="file of that trunk's weights")
    options = parser.parse_args()

    paper = options.policy == "paper"
    shape = NetworkShape(
        trunk="alexnet" if paper else "compact",
        size=224 if paper else 64,
        memory=options.memory,
        frames=3 if options.memory == "stack" else 1,
    )
    envs, device, trial = options.envs, options.device, options.seconds / 5
    chosen = {"steps": 10**9, "envs": envs}
    settings = resolve(["env=modelnet", f"train={options.policy}"]).train.model_copy(update=chosen)
    contestants: dict[str, MakeStep] = {
        f"{part} alone": partial(best_bare, part, shape, envs, device, trial, options.rounds)
        for part in PARTS
    }
    contestants |= {
        name: partial(trainer, shape, settings, actors, options.agents, device)
        for name, actors in ACTORS.items()
        if name == RESIDENT or not paper
    }
    switches = (ON_GPU if device == "cuda" else {}) | (BFLOAT16 if options.amp else {})
    contestants |= {
        f"{RESIDENT}, {name}": partial(
            trainer, shape, settings.model_copy(update=chosen), "resident", options.agents, device
        )
        for name, chosen in switches.items()
    }
    if options.trunk:
        frozen = NetworkShape(
            trunk=options.trunk, trunk_settings={"weights": options.weights}, certainty=True
        )
        varied = settings.model_copy(update={"dropout": 0.5})
        contestants[ON_FEATURES] = partial(trainer, frozen, varied, "resident", options.agents, device)
        contestants[BARE] = partial(best_bare, "learning", frozen, envs, device, trial, options.rounds)
    if not paper:
        contestants |= others(shape, settings, device)
    rates = in_processes(contestants, options.threads, options.seconds, options.rounds)
    where = torch.cuda.get_device_name() if device == "cuda" else "CPU"
    network = f"{shape.trunk} trunk, {options.memory} memory"
    print(f"{where}, {network}, {envs} episodes, {options.threads} torch thread(s)")
    report(rates)


if __name__ == "__main__":
    main()
