"""Scaling of GA3C with slow environments: steps per second by number of agent processes.

If a step takes 20 ms, n agents can take at most n / 20 ms steps. Prediction latency and, with many agents,
the network reduce this. The trainer does its full work, including learning. The table has one row per number
of agents: steps per second, as a fraction of n / step, and queue measures that show the bottleneck.

    python benchmarks/ga3c.py --agents 8 16 32 --seconds 20
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import torch
from sleeper import ID, graph

from activelsd.envs.graphenv import tree_of
from activelsd.policy.lsdnet import NetworkShape
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.run import Run
from activelsd.train.settings import GA3CSettings, TrainSettings
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer

SHOWN = ("prediction_batch", "prediction_queue", "predictor_idle", "learner_idle", "lag")


def measure(agents: int, options: argparse.Namespace) -> tuple[float, dict[str, float]]:
    """Steps per second after all agents have started, and the actors' measures for that time."""
    tree = tree_of(graph())
    spec = EnvSpec(id=ID, kwargs={"seconds": options.step / 1000}, tree=tree)
    chosen = GA3CSettings(
        agents=agents, envs_per_agent=options.lanes, lanes=options.lanes, prediction_wait_ms=options.wait
    )
    settings = TrainSettings(steps=10**9, ga3c=chosen)
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(
            Run.create(Path(folder), "ga3c", ""),
            tree,
            NetworkShape(),
            settings,
            lambda network, seed: GA3CActors(spec, network, settings.ga3c, settings.length, seed),
            seed=0,
        )
        sums = Statistics()
        try:
            while trainer.actors.measures().get("ga3c/agents", 0) < agents or trainer.step < 20 * agents:
                trainer._update(sums)
            trainer.actors.measures()
            began, before = time.monotonic(), trainer.step
            while time.monotonic() - began < options.seconds:
                trainer._update(sums)
            rate = (trainer.step - before) / (time.monotonic() - began)
            return rate, trainer.actors.measures()
        finally:
            trainer.actors.close()


def main() -> None:
    """Prints the table."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--agents", type=int, nargs="+", default=[8, 16, 32])
    parser.add_argument("--step", type=float, default=20.0, help="duration of a step in milliseconds")
    parser.add_argument("--lanes", type=int, default=1, help="train.ga3c.lanes, with one environment each")
    parser.add_argument("--wait", type=float, default=0.0, help="train.ga3c.prediction_wait_ms")
    parser.add_argument("--seconds", type=float, default=20.0, help="per row")
    parser.add_argument("--threads", type=int, default=1, help="torch threads")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)

    print("agents  steps/s  of agents/step  " + "  ".join(SHOWN))
    for agents in options.agents:
        rate, measures = measure(agents, options)
        shown = "  ".join(f"{measures[f'ga3c/{name}']:{len(name)}.2f}" for name in SHOWN)
        print(f"{agents:6}  {rate:7.0f}  {rate * options.step / 1000 / agents:14.2f}  {shown}", flush=True)


if __name__ == "__main__":
    main()
