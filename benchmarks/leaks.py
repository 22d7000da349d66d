"""Checks for leaks of memory, files, threads and processes in a GA3C run, with a row per tenth of the run.

Shared memory has no name and is counted as an open file. The run passes (exit code 0) if at its end the
memory is at most 5 % above that after the first tenth, and all other counts are the same.

    python benchmarks/leaks.py --steps 1000000 --kind processes
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import torch
from sleeper import ID, Sleeper, graph

from activelsd.envs.graphenv import tree_of
from activelsd.policy.lsdnet import NetworkShape
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.run import Run
from activelsd.train.settings import GA3CSettings, TrainSettings
from activelsd.train.statistics import Statistics
from activelsd.train.trainer import Trainer


class Usage(NamedTuple):
    """Resources that this process uses."""

    megabytes: float  # resident memory of this process and its children
    files: int
    threads: int
    children: int
    named: int  # entries of /dev/shm that this process maps


def usage() -> Usage:
    """The current resource usage."""
    own, children = Path("/proc/self"), []
    for task in (own / "task").iterdir():
        children += [int(pid) for pid in (task / "children").read_text().split()]
    pages = 0
    for pid in (os.getpid(), *children):
        pages += int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return Usage(
        megabytes=pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        files=len(list((own / "fd").iterdir())),
        threads=threading.active_count(),
        children=len(children),
        named=(own / "maps").read_text().count("/dev/shm/"),
    )


def main() -> int:
    """Prints the table; returns 1 if something grew."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--kind", choices=("processes", "threads"), default="processes")
    parser.add_argument("--agents", type=int, default=4)
    parser.add_argument("--envs", type=int, default=16, help="environments per agent")
    parser.add_argument("--size", type=int, default=64, help="network features; few, to be fast")
    options = parser.parse_args()
    torch.set_num_threads(1)

    tree = tree_of(graph())
    spec = EnvSpec(id=ID, kwargs={"seconds": 0.0}, tree=tree)
    world = spec if options.kind == "processes" else lambda: Sleeper(seconds=0.0)
    chosen = GA3CSettings(kind=options.kind, agents=options.agents, envs_per_agent=options.envs)
    settings = TrainSettings(steps=options.steps)
    sums, rows = Statistics(), []
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(
            Run.create(Path(folder), "leaks", ""),
            tree,
            NetworkShape(trunk_settings={"features": options.size}),
            settings,
            lambda network, seed: GA3CActors(world, network, chosen, settings.length, seed),
            seed=0,
        )
        print("   steps  steps/s       MB  files  threads  children  /dev/shm")
        since = time.monotonic()
        for tenth in range(1, 11):
            before = trainer.step
            while trainer.step < options.steps * tenth / 10:
                trainer._update(sums)
                if trainer.step // 10_000 != (trainer.step - 1) // 10_000:
                    sums.read()
            trainer.save()
            rate, since = (trainer.step - before) / (time.monotonic() - since), time.monotonic()
            rows.append(usage())
            mb, files, threads, children, named = rows[-1]
            print(
                f"{trainer.step:8}  {rate:7.0f}  {mb:7.1f}  {files:5}  {threads:7}  {children:8}  {named:8}",
                flush=True,
            )
        trainer.actors.close()
    grown = rows[-1].megabytes > 1.05 * rows[0].megabytes or rows[-1][1:] != rows[0][1:]
    ratio = rows[-1].megabytes / rows[0].megabytes
    print(f"memory is {ratio:.3f} of that after a tenth; child processes left: {usage().children}")
    return int(grown)


if __name__ == "__main__":
    raise SystemExit(main())
