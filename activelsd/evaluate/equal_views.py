"""Runs and players at equal mean views: their episodes to the last view, and thresholds from val objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd import registry
from activelsd.envs.viewgraph import SPLITS
from activelsd.errors import ConfigError, DataError
from activelsd.evaluate.compare import Entrant, check_fits, shifted
from activelsd.evaluate.frontier import CHOOSING, Frontier, frontier, nearest
from activelsd.evaluate.players import Trained, make_player, takes_stops
from activelsd.evaluate.protocol import Progress, episodes_of
from activelsd.evaluate.traces import Trace, trace
from activelsd.registry import LEARNED, moves_and_stop


class _Part(NamedTuple):
    """A player: whose network it has, and the names of its moves and of its stop, "" for its own."""

    entrant: Entrant
    moves: str
    stop: str


def thresholds_at(
    mean: float,
    entrants: Sequence[Entrant],
    baselines: Sequence[str],
    *,
    per_object: int | None,
    seed: int,
    device: str,
    progress: Progress | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Thresholds (T,) by player with which its mean on validation objects is nearest to a wanted one.

    See `measure_frontier` for the other arguments, for who is left out, and for errors.
    """
    most = entrants[0].rules.max_views
    if mean > most:
        raise ConfigError(f"--views {mean:g} is more than the {most} views that an episode may have.")
    wanted = _wanted(entrants, baselines, device)
    traces = _traces(wanted, (CHOOSING,), per_object=per_object, seed=seed, device=device, progress=progress)
    return {
        name: nearest(traces[one.entrant.name, one.moves][0], one.stop, mean) for name, one in wanted.items()
    }


def measure_frontier(
    entrants: Sequence[Entrant],
    baselines: Sequence[str],
    *,
    split: str,
    per_object: int | None,
    seed: int,
    device: str,
    progress: Progress | None = None,
) -> Frontier:
    """Compares runs, each with its learned stop, and those of the baselines that take other stops.

    Args:
        entrants: trained runs; the first is the reference, and the baselines share its network.
        baselines: names of players; others than MOVES, STOP and MOVES+STOP are left out.
        split: of the episodes that are measured; thresholds are chosen on validation objects.
        per_object: random starts per object; None for every start.
        seed: of random starts, of players that draw at random, and of resampling.
        device: where the networks are.
        progress: called with the finished and all episodes.

    Raises:
        ConfigError: some player sees too few views.
        DataError: there are no validation objects.
        RunError: a run does not fit its world.
    """
    wanted = _wanted(entrants, baselines, device)
    traces = _traces(
        wanted, (CHOOSING, split), per_object=per_object, seed=seed, device=device, progress=progress
    )
    curves = {}
    for name, one in wanted.items():
        chosen_on, measured = traces[one.entrant.name, one.moves]
        curves[name] = (one.stop, chosen_on, measured)
    return frontier(curves, seed=seed)


def _wanted(entrants: Sequence[Entrant], baselines: Sequence[str], device: str) -> dict[str, _Part]:
    """The players that take stops, by name."""
    wanted = {}
    for one in entrants:
        check_fits(one)
        if not (one.graph.start_split == SPLITS.index(CHOOSING)).any():
            raise DataError(
                f"Thresholds are chosen on {CHOOSING} objects, and {one.world} has none; leave out --frontier"
                " and --views, or give the data set some."
            )
        one.network.to(device)
        wanted[one.name] = _Part(one, LEARNED, LEARNED)
    for name in baselines:
        moves, stop = moves_and_stop(name)
        if takes_stops(moves, stop):
            wanted[name] = _Part(entrants[0], moves, stop)
    return wanted


def _traces(
    wanted: Mapping[str, _Part],
    splits: Sequence[str],
    *,
    per_object: int | None,
    seed: int,
    device: str,
    progress: Progress | None,
) -> dict[tuple[str, str], list[Trace]]:
    """By run and moves, a trace for every split; one game serves all stops."""
    games: dict[tuple[str, str], list[_Part]] = {}
    for one in wanted.values():
        games.setdefault((one.entrant.name, one.moves), []).append(one)
    todo = [
        (key, parts, episodes_of(parts[0].entrant.graph, split, per_object=per_object, seed=seed))
        for key, parts in games.items()
        for split in splits
    ]
    done, total = 0, sum(len(rows) for *_, rows in todo)
    traces: dict[tuple[str, str], list[Trace]] = {}
    for key, parts, rows in todo:
        entrant, moves, _ = parts[0]
        players = {
            one.stop: make_player(
                f"{moves}+{one.stop}" if one.stop else moves, entrant.network, entrant.graph, seed
            )
            for one in parts
        }
        stops = {name: player.stop for name, player in players.items() if isinstance(player, Trained)}
        mover = players[parts[0].stop]
        assert isinstance(mover, Trained)
        with nullcontext() if moves == LEARNED else registry.players.blaming(moves, "fails"):
            played = trace(
                mover,
                stops,
                entrant.graph,
                entrant.rules,
                rows,
                device=device,
                progress=shifted(progress, done, total),
            )
        traces.setdefault(key, []).append(played)
        done += len(rows)
    return traces
