"""Compares runs, given by their folders, with players and recognisers, and writes the result files."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from activelsd import registry
from activelsd.build import build_device
from activelsd.compose import change, load
from activelsd.config import RunConfig
from activelsd.console import progress
from activelsd.envs.actions import CLASSIFY
from activelsd.envs.graphenv import tree_of
from activelsd.envs.settings import WorldSettings
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import RunError
from activelsd.evaluate import result_files
from activelsd.evaluate.compare import Comparison, Entrant, compare
from activelsd.evaluate.equal_views import EqualViews
from activelsd.evaluate.players import check_stop
from activelsd.evaluate.recognisers.objects import Objects
from activelsd.evaluate.recognisers.rows import recognise
from activelsd.features import with_features
from activelsd.policy.checkpoint import load_network
from activelsd.policy.lsdnet import LSDNet
from activelsd.policy.transfer import narrow
from activelsd.sections import flatten
from activelsd.train.run import CONFIG, Run, check_writable

CHANGEABLE = ("evaluate", "device", "threads", "env.dataset")
"""Settings that may be changed when a run is measured, besides the world's paths."""

_LOG = logging.getLogger("activelsd")

AS_PLAYED = {"navigate", "branches", "rules", "cache"}
"""Settings of a world that its list of episodes does not depend on."""

ELSEWHERE = "name another folder for the results by --out DIR"

RUNS = Path("runs")
"""Folder in which the newest run is used if none is named."""


def evaluate(
    folders: Sequence[str], words: Sequence[str], out: Path | None = None
) -> tuple[list[Comparison], list[Path]]:
    """Measure one run; writes `evaluation.json` and so on, and does not overwrite comparisons."""
    return _play(folders, (), words, "evaluation", out)


def contest(
    folders: Sequence[str],
    baselines: Sequence[str],
    words: Sequence[str],
    out: Path | None = None,
    recognisers: Sequence[str] = (),
    frontier: bool = False,
    views: float | None = None,
) -> tuple[list[Comparison], list[Path]]:
    """Play runs and players on the same episodes, measure recognisers, and write the results.

    Args:
        folders: of runs; the first is what the others are compared with. None: the newest in `./runs`.
        baselines: names of players, or MOVES+STOP, that share the first run's network and rules.
        words: settings as `key=value`, see `CHANGEABLE`.
        out: folder of the results; None: the first run's.
        recognisers: names of recognisers that name the same objects; trained in the first run's world, with
            its kind of trunk, unless that is done. Those that baselines need are added.
        frontier: also compare all at equal mean views, with thresholds chosen on validation objects.
        views: let every player that takes a stop answer so late that it sees about so many views on average
            on validation objects; None: when its stop says so as usual.

    Raises:
        UserError: a run, baseline, recogniser or setting is not one there is, the runs' episodes are not the
            same, or the world lacks what a recogniser needs.
    """
    return _play(folders, baselines, words, "comparison", out, recognisers, frontier=frontier, views=views)


def _play(
    folders: Sequence[str],
    baselines: Sequence[str],
    words: Sequence[str],
    stem: str,
    out: Path | None,
    recognisers: Sequence[str] = (),
    *,
    frontier: bool = False,
    views: float | None = None,
) -> tuple[list[Comparison], list[Path]]:
    runs = named_runs(folders)
    folder = runs[0].folder if out is None else out.expanduser()
    check_writable(folder, ELSEWHERE)  # before anything is played
    comparisons: list[Comparison] = []
    written: list[Path] = []
    for played in play_runs(runs, baselines, words, recognisers, frontier=frontier, views=views):
        comparisons.append(played.comparison)
        with writing(folder):
            written += result_files.write(played.comparison, folder, stem + played.suffix)
    return comparisons, written


class Played(NamedTuple):
    """What runs and baselines played in one world."""

    entrants: list[Entrant]
    comparison: Comparison
    suffix: str  # of the names of its files, if the first run has several worlds


def named_runs(folders: Sequence[str]) -> list[Run]:
    """Returns the runs in folders, or, if none is named, the newest in `./runs`."""
    return [Run(Path(folder)) for folder in folders] or [Run.newest(RUNS)]


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns an OSError inside into a RunError that names the folder."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{folder} cannot be written ({error.strerror}); {ELSEWHERE}.") from None


def play_runs(
    runs: Sequence[Run],
    baselines: Sequence[str],
    words: Sequence[str],
    recognisers: Sequence[str] = (),
    *,
    frontier: bool = False,
    views: float | None = None,
) -> Iterator[Played]:
    """Plays and measures all in each world of the first run, as `contest` does."""
    wanted = _recognisers(baselines, recognisers)  # unknown names are refused before worlds are opened
    own = [load(run.folder / CONFIG) for run in runs]
    configs = [change(one, words, CHANGEABLE, "a run is measured in its own world") for one in own]
    how = configs[0]
    device = build_device(how.device, how.threads)
    names = ["trained"] if len(runs) == 1 else [run.folder.name for run in runs]
    networks = [load_network(run.checkpoint, device) for run in runs]
    playing = _playing(names, configs)
    entered = _entered(playing, names, configs, networks, device)
    objects = {  # worlds without any are refused before anything is trained
        world: Objects(graph=entrants[0].graph, world=playing[world][0], shape=networks[0].shape)
        for world, entrants in (entered.items() if wanted else ())
    }
    for world, entrants in entered.items():
        settings = playing[world][0]
        recognised, learned = (
            recognise(
                wanted,
                objects[world],
                split=how.evaluate.split,
                seed=how.evaluate.seed,
                cache=settings.cache_folder,
                device=device,
                epochs=how.evaluate.epochs,
                progress=progress,
            )
            if wanted
            else ([], {})
        )
        per_object, seed = how.evaluate.episodes_per_object, how.evaluate.seed
        thresholds = curves = None
        if frontier or views is not None:
            equal = EqualViews(entrants, baselines, per_object=per_object, seed=seed, device=device)
        if views is not None:
            with progress("Choosing thresholds") as show:
                thresholds = equal.thresholds(views, show)
        with progress("Playing episodes") as show:
            comparison = compare(
                entrants,
                baselines,
                split=how.evaluate.split,
                device=device,
                progress=show,
                recognisers=learned,
                thresholds=thresholds,
                per_object=per_object,
                seed=seed,
            )
        if frontier:
            with progress("Playing to the last view") as show:
                curves = equal.frontier(how.evaluate.split, show)
        comparison = replace(
            comparison,
            changed=_changes(own[0].worlds[world], settings),
            recognised=recognised,
            frontier=curves,
            wanted_views=views,
        )
        yield Played(entrants, comparison, "" if len(entered) == 1 else f"_{world}")


def _recognisers(baselines: Sequence[str], recognisers: Sequence[str]) -> list[str]:
    """The recognisers asked for, and those that baselines need. Raises ConfigError for unknown names."""
    wanted = list(recognisers)
    for name in baselines:
        moves, stop = registry.moves_and_stop(name)
        check_stop(moves, stop)
        needed = None if stop else getattr(registry.players.get(moves), "recogniser", None)
        wanted += [needed] if needed is not None and needed not in wanted else []
    for name in wanted:
        registry.recognisers.get(name)
    return wanted


def _entered(
    playing: Mapping[str, Mapping[int, WorldSettings]],
    names: Sequence[str],
    configs: Sequence[RunConfig],
    networks: Sequence[LSDNet],
    device: str,
) -> dict[str, list[Entrant]]:
    """The runs in each world, whose views and features are prepared now if they are not there."""
    graphs: dict[str, ViewGraph] = {}
    featured: dict[tuple[str, str], ViewGraph] = {}
    entered: dict[str, list[Entrant]] = {}
    for world, players in playing.items():
        for i, settings in players.items():
            views, trunk = settings.model_dump_json(), networks[i].frozen_trunk
            if views not in graphs:  # runs of the same world share its views
                with progress("Preparing views") as show:
                    graphs[views] = settings.open(show)
            seen = views, "" if trunk is None else trunk.digest()
            if seen not in featured:  # and those of the same trunk its features
                featured[seen] = with_features(
                    graphs[views], trunk, cache=settings.cache_folder, device=device, progress=progress
                )
            joint = len(configs[i].worlds) > 1
            one = _entrant(names[i], networks[i], world, settings, featured[seen], joint=joint)
            entered.setdefault(world, []).append(one)
    return entered


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


def _changes(before: WorldSettings, after: WorldSettings) -> dict[str, Any]:
    """The settings that were changed, by dotted key, without the cache's."""
    old, new = (dict(flatten(one.model_dump(mode="json", exclude={"cache"}))) for one in (before, after))
    return {f"env.{key}": value for key, value in new.items() if old.get(key) != value}


def _entrant(
    name: str, network: LSDNet, world: str, settings: WorldSettings, graph: ViewGraph, *, joint: bool
) -> Entrant:
    """A run in one of its worlds, with its network restricted to that world's actions.

    If the world has only some of the run's classes, the network still chooses among all of them.
    """
    known = network.tree.leaves[network.tree.branches.index(CLASSIFY)]
    if not joint and graph.classes != known and set(graph.classes) <= set(known):
        _LOG.warning(
            "%s knows %d classes, and objects of %d of them are shown.", name, len(known), len(graph.classes)
        )
        graph = graph.with_classes(known)
    return Entrant(
        name=name,
        network=narrow(network, tree_of(graph)) if joint else network,
        graph=graph,
        rules=settings.rules.rules(),
        world=world,
        backend=settings.made_by(),
    )
