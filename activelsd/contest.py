"""Compares runs, given by their folders, with each other and with players, and writes the result files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from activelsd import registry
from activelsd.build import build_device
from activelsd.compose import change, load
from activelsd.config import RunConfig
from activelsd.console import progress
from activelsd.envs.graphenv import tree_of
from activelsd.envs.settings import WorldSettings
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import RunError
from activelsd.evaluate import result_files
from activelsd.evaluate.compare import Comparison, Entrant, compare
from activelsd.policy.checkpoint import load_network
from activelsd.policy.lsdnet import LSDNet
from activelsd.policy.transfer import narrow
from activelsd.train.run import CONFIG, Run

CHANGEABLE = ("evaluate", "device", "threads", "env.cache")
"""Settings that may be changed when a run is measured."""

AS_PLAYED = {"navigate", "branches", "rules", "cache"}
"""Settings of a world that its list of episodes does not depend on."""

RUNS = Path("runs")
"""Folder in which the newest run is used if none is named."""


def evaluate(folders: Sequence[str], words: Sequence[str]) -> tuple[list[Comparison], list[Path]]:
    """Measure one run; writes `evaluation.json` and so on, and does not overwrite comparisons."""
    return _play(folders, (), words, "evaluation")


def contest(
    folders: Sequence[str], baselines: Sequence[str], words: Sequence[str]
) -> tuple[list[Comparison], list[Path]]:
    """Play runs and players on the same episodes, and write the results into the first run's folder.

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
) -> tuple[list[Comparison], list[Path]]:
    for name in baselines:  # unknown names are reported first, because opening worlds takes a while
        registry.players.get(name)
    runs = [Run(Path(folder)) for folder in folders] or [Run.newest(RUNS)]
    configs = [
        change(load(run.folder / CONFIG), words, CHANGEABLE, "a run is measured in its own world")
        for run in runs
    ]
    how = configs[0]
    device = build_device(how.device, how.threads)
    names = ["trained"] if len(runs) == 1 else [run.folder.name for run in runs]
    networks = [load_network(run.checkpoint, device) for run in runs]
    playing = _playing(names, configs)
    graphs: dict[str, ViewGraph] = {}
    comparisons: list[Comparison] = []
    written: list[Path] = []
    for world, players in playing.items():
        entrants = []
        for i, settings in players.items():
            views = settings.model_dump_json()
            if views not in graphs:  # runs of the same world share its views
                with progress("Preparing views") as show:
                    graphs[views] = settings.open(show)
            joint = len(configs[i].worlds) > 1
            entrants.append(_entrant(names[i], networks[i], world, settings, graphs[views], joint=joint))
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
        comparisons.append(comparison)
        written += result_files.write(
            comparison, runs[0].folder, stem if len(playing) == 1 else f"{stem}_{world}"
        )
    return comparisons, written


def _playing(names: Sequence[str], configs: Sequence[RunConfig]) -> dict[str, dict[int, WorldSettings]]:
    """For each world of the first run: the runs that play in it, by index, and their settings there."""
    first, *others = (config.worlds for config in configs)
    playing: dict[str, dict[int, WorldSettings]] = {name: {0: world} for name, world in first.items()}
    for i, worlds in enumerate(others, 1):
        shared = _shared(first, worlds)
        if not shared:
            raise RunError(
                f"{names[i]} plays in {', '.join(worlds)} and {names[0]} in {', '.join(first)}; "
                "compare runs that have a world in common."
            )
        for name, world in shared.items():
            playing[name][i] = world
    return playing


def _shared(
    ours: Mapping[str, WorldSettings], theirs: Mapping[str, WorldSettings]
) -> dict[str, WorldSettings]:
    """Their worlds that are also ours, by our names: those with the same settings, else the same names."""
    if len(ours) == len(theirs) == 1:  # their episodes tell better what differs
        return dict(zip(ours, theirs.values(), strict=True))
    same = {
        name: world
        for name, own in ours.items()
        for world in theirs.values()
        if own.model_dump(exclude=AS_PLAYED) == world.model_dump(exclude=AS_PLAYED)
    }
    return same or {name: theirs[name] for name in ours if name in theirs}


def _entrant(
    name: str, network: LSDNet, world: str, settings: WorldSettings, graph: ViewGraph, *, joint: bool
) -> Entrant:
    """A run in one of its worlds, with its network restricted to that world's actions."""
    return Entrant(
        name=name,
        network=narrow(network, tree_of(graph)) if joint else network,
        graph=graph,
        rules=settings.rules.rules(),
        world=world,
        backend=settings.made_by(),
    )
