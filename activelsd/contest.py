"""From runs' folders to a comparison: their worlds opened, baselines beside them, the files written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from activelsd.build import build_backend, build_device, build_graph, build_rules
from activelsd.compose import change, load
from activelsd.config import RunConfig, World
from activelsd.console import progress
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, did_you_mean
from activelsd.evaluate import files
from activelsd.evaluate.baselines import BASELINES
from activelsd.evaluate.compare import Comparison, Entrant, compare
from activelsd.policy.checkpoint import load_network
from activelsd.train.run import CONFIG, Run

CHANGEABLE = ("evaluate", "device", "threads", "env.cache")
"""What may be set anew when a run is measured."""

RUNS = Path("runs")
"""Where the newest run is looked for when none is named."""


def evaluate(folders: Sequence[str], words: Sequence[str]) -> tuple[Comparison, list[Path]]:
    """Measure one run by itself; what is written, `evaluation.json` and so on, leaves comparisons alone."""
    return _play(folders, (), words, "evaluation")


def contest(
    folders: Sequence[str], baselines: Sequence[str], words: Sequence[str]
) -> tuple[Comparison, list[Path]]:
    """Play runs and baselines on the same episodes, and write what came of it into the first run's folder.

    Args:
        folders: of runs; the first is what the others are compared with. None: the newest in `./runs`.
        baselines: names of players that share the first run's network, moves and rules.
        words: settings as `key=value`, see `CHANGEABLE`.

    Raises:
        UserError: a run, baseline or setting is not one there is, or the runs' episodes are not the same.
    """
    return _play(folders, baselines, words, "comparison")


def _play(
    folders: Sequence[str], baselines: Sequence[str], words: Sequence[str], stem: str
) -> tuple[Comparison, list[Path]]:
    for name in baselines:  # before anything is opened: worlds take a while
        if name not in BASELINES:
            raise ConfigError(f"There is no baseline '{name}'; {did_you_mean(name, BASELINES)}")
    runs = [Run(Path(folder)) for folder in folders] or [Run.newest(RUNS)]
    configs = [
        change(load(run.folder / CONFIG), words, CHANGEABLE, "a run is measured in its own world")
        for run in runs
    ]
    how = configs[0]
    device = build_device(how.device, how.threads)
    graphs: dict[World, ViewGraph] = {}
    names = ["trained"] if len(runs) == 1 else [run.folder.name for run in runs]
    entrants = [
        _entrant(name, run, config, graphs, device)
        for name, run, config in zip(names, runs, configs, strict=True)
    ]
    with progress("Playing episodes") as show:
        comparison = compare(
            entrants,
            baselines,
            split=how.evaluate.split,
            per_object=how.evaluate.episodes_per_object,
            seed=how.evaluate.seed,
            device=device,
            progress=show,
        )
    return comparison, files.write(comparison, runs[0].folder, stem)


def _entrant(name: str, run: Run, config: RunConfig, graphs: dict[World, ViewGraph], device: str) -> Entrant:
    """A run with its world; runs of the same world share its views."""
    network = load_network(run.checkpoint, device)
    if config.env not in graphs:
        with progress("Preparing views") as show:
            graphs[config.env] = build_graph(config.env, show)
    return Entrant(
        name=name,
        network=network,
        graph=graphs[config.env],
        rules=build_rules(config.env.rules),
        world=config.env.name,
        backend=build_backend(config.env),
    )
