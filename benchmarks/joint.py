"""Compares one network trained in several worlds with one network per world.

Every run gets the same number of steps in each of its worlds. The table has one row per world and seed: test
accuracy and views of both runs, and the joint run's accuracy as a fraction of the single-world run's.

    python benchmarks/joint.py modelnet,avd --steps 1000000 --seeds 3
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

from activelsd.compose import resolve
from activelsd.contest import evaluate
from activelsd.launch import begin


def train_and_test(words: Sequence[str], folder: Path) -> dict[str, tuple[float, float]]:
    """Trains a run and returns its test accuracy and number of views by world."""
    config = resolve([*words, f"runs={folder}", "train.loggers=[]", "train.evaluate_every=1000000000"])
    comparisons, _ = evaluate([str(begin(config))], [])
    players = [comparison.players[0] for comparison in comparisons]
    return {
        world: (player.accuracy.mean, player.views.mean)
        for world, player in zip(config.worlds, players, strict=True)
    }


def settings_for(words: Sequence[str], world: str, worlds: Sequence[str]) -> list[str]:
    """Settings of a single-world run: `env.avd.size=84` becomes `env.size=84` for avd, else is dropped."""
    others = tuple(f"env.{other}." for other in worlds if other != world)
    return [word.replace(f"env.{world}.", "env.", 1) for word in words if not word.startswith(others)]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("worlds", help="presets of env, for example modelnet,avd")
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps in each world")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("settings", nargs="*", help="key=value for all runs")
    options = parser.parse_intermixed_args()
    worlds = options.worlds.split(",")
    print(f"{'world':>10}{'seed':>6}{'alone':>18}{'joint':>18}{'share':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            words = [*options.settings, f"seed={seed}"]
            steps = f"train.steps={len(worlds) * options.steps}"
            joint = train_and_test([f"env={options.worlds}", *words, steps], Path(folder))
            for world in worlds:
                single = [f"env={world}", *settings_for(words, world, worlds), f"train.steps={options.steps}"]
                alone = train_and_test(single, Path(folder))[world]
                both = (alone, joint[world])
                cells = "".join(f"{100 * right:8.1f} %{views:6.2f} v" for right, views in both)
                print(f"{world:>10}{seed:>6}{cells}{joint[world][0] / alone[0]:8.0%}", flush=True)


if __name__ == "__main__":
    main()
