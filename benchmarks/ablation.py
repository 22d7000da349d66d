"""Ablation study: trains variants of a world's default preset with equal budgets and several seeds.

The table shows each variant's accuracy on unseen objects and its number of views, as mean ± 95 % confidence
interval over seeds (Student's t), and the differences to the default, paired by seed. It uses the validation
split, which is for choosing; use `--split test` for final results. With this many variants, some interval may
exclude zero by chance.

    python benchmarks/ablation.py env=modelnet --steps 600000 --seeds 3 --out ablation --only flat,V0

Runs, results and the table are stored in a folder. The same command continues after an interruption; a
command with more variants, more seeds or another split adds to the folder. Use one folder per version of the
code.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from activelsd.compose import load, resolve
from activelsd.contest import evaluate
from activelsd.errors import ConfigError, did_you_mean
from activelsd.launch import begin, open_worlds, resume
from activelsd.train.run import CONFIG

DEFAULT = "default"
VARIANTS = {
    # The settings that all worlds shared before each got its own.
    "alike": "train.learning_rate=7e-4 train.gamma=0.98 train.mirror=false train.dropout=0"
    " train.terms.guided=0",
    "paper": "train=paper env.rules.preset=V0 policy.memory=stack policy.frames=3",
    "tree": "policy.head=tree",
    "flat": "policy.head=flat",
    # A flat softmax uses only the leaf schedules; here they get the values of the tree's branch schedules.
    "flat-explored": "policy.head=flat train.epsilon_leaf.start=0.8 train.entropy_leaf.start=0.05 "
    "train.entropy_leaf.end=0.005",
    "V0": "env.rules.preset=V0",
    "V5": "env.rules.preset=V5",
    "stack": "policy.memory=stack policy.frames=3",
    "stack-1": "policy.memory=stack policy.frames=1",
    "stack-2": "policy.memory=stack policy.frames=2",
    "stack-4": "policy.memory=stack policy.frames=4",
    "lstm": "policy.memory=lstm policy.frames=1",
    "pool": "policy.memory=pool policy.frames=1",
    "unsupervised": "train.terms.supervised=0",
    "supervised": "train.terms.supervised=1",
    "V6": "env.rules.preset=V6",
    "dropout-0": "train.dropout=0",
    "dropout-0.25": "train.dropout=0.25",
    "dropout-0.5": "train.dropout=0.5",
    "mirror": "train.mirror=true",
    "mirror-0": "train.mirror=false",
    "revisit": "env.rules.revisit=true",
    "no-revisit": "env.rules.revisit=false",
    "smooth": "train.terms.smoothing=0.1 train.rewarded_classes=false",
    "unguided": "train.terms.guided=0",
    "guided-0.5": "train.terms.guided=0.5",
    "amp": "train.amp=true",
    "gray": "env.colour=gray",
    "rgb": "env.colour=rgb",
    "rate-7e-4": "train.learning_rate=7e-4",
    "rate-2e-3": "train.learning_rate=2e-3",
    "envs-16": "train.envs=16",
    "ga3c-threads": "train.actors=ga3c train.ga3c.kind=threads train.ga3c.agents=4 "
    "train.ga3c.envs_per_agent=16",
    "ga3c-processes": "train.actors=ga3c train.ga3c.agents=4 train.ga3c.envs_per_agent=16 train.vtrace=true",
    "epsilon-0.1": "train.epsilon_branch.start=0.1 train.epsilon_leaf.start=0.1",
    "entropy-branch-0": "train.entropy_branch.start=0 train.entropy_branch.end=0",
    "entropy-leaf-0": "train.entropy_leaf.start=0 train.entropy_leaf.end=0",
    "gamma-0.5": "train.gamma=0.5",
    "gamma-0.9": "train.gamma=0.9",
    "gamma-0.98": "train.gamma=0.98",
    "gamma-0.99": "train.gamma=0.99",
    "gamma-1": "train.gamma=1",
    "length-20": "train.length=20",
    "rmsprop": "train.optimiser=rmsprop",
    "rmsprop-7e-4": "train.optimiser=rmsprop train.learning_rate=7e-4",
    "V1": "env.rules.preset=V1",
    "V2": "env.rules.preset=V2",
    "V3": "env.rules.preset=V3",
    "V4": "env.rules.preset=V4",
}
"""Settings of each variant, the most informative first; a variant equal to the default is skipped."""

OF_WORLD = {"modelnet": {"moves-30": "env.navigate=[orbit_cw,orbit_ccw]"}}
"""Variants for one world only."""

Words = tuple[str, ...]


class Result(NamedTuple):
    """The result of one trained run."""

    variant: str
    words: Words
    split: str
    accuracy: float
    views: float


def variants(base: Words, only: Sequence[str] = ()) -> dict[str, Words]:
    """Settings of the default and of all variants (or those in `only`) that differ from it."""
    default = resolve(base)
    known = {DEFAULT: ""} | VARIANTS | OF_WORLD.get(default.env.name, {})
    for name in only:
        if name not in known:
            raise ConfigError(f"There is no variant '{name}'; {did_you_mean(name, known)}")
    words = {name: (*base, *known[name].split()) for name in known if not only or name in {DEFAULT, *only}}
    return {name: each for name, each in words.items() if name == DEFAULT or resolve(each) != default}


def experiment(variant: str, words: Words, split: str, runs: Path) -> Result:
    """Trains a run, or resumes it if it exists, and evaluates it."""
    config = resolve(["train.loggers=[]", "train.evaluate_every=1000000000", *words, f"runs={runs}"])
    config = config.model_copy(update={"name": variant})
    begun = [path.parent for path in runs.glob(f"*/{CONFIG}") if load(path) == config]
    run = resume(begun[0], []) if begun else begin(config)
    comparisons, _ = evaluate([str(run)], [f"evaluate.split={split}"])
    players = [comparison.reference for comparison in comparisons]
    accuracy = float(np.mean([player.accuracy.mean for player in players]))  # over a joint run's worlds
    return Result(variant, words, split, accuracy, float(np.mean([player.views.mean for player in players])))


def in_own_process(variant: str, words: Words, split: str, runs: Path) -> Result:
    """Runs `experiment` in a separate process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(experiment, variant, words, split, runs).result()


def read(file: Path, split: str) -> dict[Words, Result]:
    """The results of a split in a file, by settings."""
    lines = file.read_text().splitlines() if file.exists() else []
    rows = [json.loads(line) for line in lines]
    results = [Result(**(row | {"words": tuple(row["words"])})) for row in rows]
    return {result.words: result for result in results if result.split == split}


def interval(values: Sequence[float], digits: int) -> str:
    """Mean ± half width of the 95 % interval (Student's t); a single value has no interval."""
    mean = f"{np.mean(values):.{digits}f}"
    if len(values) < 2:
        return mean
    half = stdtrit(len(values) - 1, 0.975) * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{mean} ± {half:.{digits}f}"


def table(wanted: Mapping[str, Sequence[Words]], done: Mapping[Words, Result]) -> str:
    """The finished runs as a Markdown table; differences use only seeds that the default also has."""
    lines = [
        "| variant | seeds | accuracy, % | difference | views | difference |",
        "|---|---|---|---|---|---|",
    ]
    default = [done.get(words) for words in wanted[DEFAULT]]
    for name, runs in wanted.items():
        results = [done.get(words) for words in runs]
        finished = [one for one in results if one]
        pairs = [(one, other) for one, other in zip(results, default, strict=True) if one and other]
        cells = [name, str(len(finished)), "", "", "", ""]
        if finished:
            cells[2] = interval([100 * one.accuracy for one in finished], 1)
            cells[4] = interval([one.views for one in finished], 2)
        if pairs and name != DEFAULT:
            cells[3] = interval([100 * (one.accuracy - other.accuracy) for one, other in pairs], 1)
            cells[5] = interval([one.views - other.views for one, other in pairs], 2)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def study(wanted: Mapping[str, Sequence[Words]], split: str, out: Path, jobs: int) -> str:
    """Runs what is not done yet, stores each result and the table at once, and returns the table."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "results.jsonl"
    done = read(file, split)
    todo = [
        (name, words, split, out / "runs")
        for name, runs in wanted.items()
        for words in runs
        if words not in done
    ]
    with ThreadPoolExecutor(jobs) as threads:
        for result in threads.map(lambda one: in_own_process(*one), todo):
            done[result.words] = result
            with file.open("a") as lines:
                lines.write(json.dumps(result._asdict()) + "\n")
            (out / f"{split}.md").write_text(table(wanted, done))
    return table(wanted, done)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("settings", nargs="+", help="group=preset and key=value for all runs")
    parser.add_argument("--steps", type=int, default=600_000, help="training steps of each run")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", default="", help=f"variants besides the default: {', '.join(VARIANTS)}")
    parser.add_argument("--split", default="val", choices=("val", "test"), help="split to evaluate on")
    parser.add_argument("--out", type=Path, default=Path("ablation"), help="folder of runs and results")
    parser.add_argument("--jobs", type=int, default=1, help="number of runs in parallel")
    options = parser.parse_intermixed_args()
    base = ("threads=1", *options.settings, f"train.steps={options.steps}")
    only = [name for name in options.only.split(",") if name]
    wanted = {
        name: [(*words, f"seed={seed}") for seed in range(options.seeds)]
        for name, words in variants(base, only).items()
    }
    open_worlds(resolve(base))  # prepares the views once, instead of in several jobs at the same time
    print(study(wanted, options.split, options.out, options.jobs), end="")


if __name__ == "__main__":
    main()
