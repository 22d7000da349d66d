"""Views per second of `ViewGraphVectorEnv` alone: steps and observations of a batch, without a network.

The graph is random, but as large as the published Active Vision Dataset: 20,916 views, 54,247 boxes with a
crop each, 14 scans, six moves. A step takes a batch of actions (drawn before, one in twelve an answer) and
gathers each episode's frame, crop and box, K = 1. Bandwidth counts the bytes read and written per view, and
is compared with copying one large array to another on the same machine.

    python benchmarks/walker.py --threads 2
"""

from __future__ import annotations

import argparse
import os

# Set before torch is imported: busy-waiting threads slow each other down if they share cores.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import torch
from rates import Step, in_turns

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph

VIEWS, BOXES, SCANS, INSTANCES, MOVES = 20_916, 54_247, 14, 33, 6
ANSWERS = 1 / 12
BATCHES = (64, 128, 256, 512, 1024, 4096)


def graph(size: int) -> ViewGraph:
    """A random graph as large as the real one, with edges and boxes within each scan."""
    rng = np.random.default_rng(0)
    scene_of = np.arange(VIEWS) * SCANS // VIEWS
    first = np.searchsorted(scene_of, np.arange(SCANS + 1))
    low, high = first[scene_of][:, None], first[scene_of + 1][:, None]
    moves = rng.integers(low, high, (VIEWS, MOVES)).astype(np.int32)
    moves[rng.random(moves.shape) < 0.25] = -1
    target_scene = np.repeat(np.arange(SCANS), INSTANCES)
    possible = np.argwhere(scene_of[:, None] == target_scene)
    seen = possible[np.sort(rng.choice(len(possible), BOXES, replace=False))]
    pair_of = np.full((VIEWS, len(target_scene)), -1, np.int32)
    pair_of[seen[:, 0], seen[:, 1]] = np.arange(BOXES)
    return ViewGraph(
        frames=rng.integers(0, 256, (VIEWS, size, size), dtype=np.uint8),
        moves=moves,
        move_names=tuple(f"move_{i}" for i in range(MOVES)),
        classes=tuple(f"class_{i}" for i in range(INSTANCES)),
        targets=tuple(f"{scan}/{i % INSTANCES}" for i, scan in enumerate(target_scene)),
        labels=np.arange(len(target_scene)) % INSTANCES,
        scenes=tuple(f"scan_{i}" for i in range(SCANS)),
        scene_of=scene_of.astype(np.int32),
        view_names=tuple(map(str, range(VIEWS))),
        start_view=seen[:, 0].astype(np.int32),
        start_target=seen[:, 1].astype(np.int32),
        start_split=np.zeros(BOXES, np.uint8),
        pair_of=pair_of,
        boxes=rng.random((BOXES, 4), np.float32),
        crops=rng.integers(0, 256, (BOXES, size, size), dtype=np.uint8),
    )


def walker(views: ViewGraph, batch: int) -> Step:
    """A function that steps a batch and returns the number of views."""
    env = ViewGraphVectorEnv(views, EpisodeRules(ends_on_wrong=True), num_envs=batch, frames=1)
    env.begin(0)
    drawn = torch.Generator().manual_seed(0)
    actions = torch.randint(env.tree.n - MOVES, env.tree.n, (64, batch), generator=drawn)
    actions[torch.rand(actions.shape, generator=drawn) < ANSWERS] = 0
    turn = 0

    def step() -> int:
        nonlocal turn
        env.advance(actions[turn % len(actions)])
        env.observe()
        turn += 1
        return batch

    return step


def copier(megabytes: int = 256) -> Step:
    """A function that copies an array larger than any cache and returns the bytes read and written."""
    source = torch.ones(megabytes * 2**20, dtype=torch.uint8)
    target = torch.zeros_like(source)

    def step() -> int:
        target.copy_(source)
        return 2 * len(source)

    return step


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=1.0, help="per measurement")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2, help="torch threads")
    parser.add_argument("--size", type=int, default=64, help="side of frames and crops in pixels")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)

    views = graph(options.size)
    contestants = {f"batch {batch:5}": walker(views, batch) for batch in BATCHES}
    rates = in_turns(contestants | {"copy": copier()}, options.seconds, options.rounds)
    copied = rates.pop("copy").wall
    moved = 2 * (2 * options.size**2 + 5 * 4)  # frame, crop and box, read and written
    print(f"{options.size} px, {options.threads} torch thread(s), {moved} bytes read and written per view")
    for name, (wall, cpu) in rates.items():
        print(
            f"{name}  {wall / 1e6:5.2f} M views/s  {wall * moved / 1e9:5.1f} GB/s"
            f"   {cpu / 1e6:5.2f} M views per CPU-second"
        )
    print(f"copying 256 MiB arrays: {copied / 1e9:.1f} GB/s")


if __name__ == "__main__":
    main()
