"""Runs and players at equal mean views: their episodes to the last view, and thresholds from val objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd import registry
from activelsd.evaluate.compare import Entrant, shifted
from activelsd.evaluate.frontier import Frontier, frontier, nearest
from activelsd.evaluate.players import Trained, make_player
from activelsd.evaluate.protocol import Progress, episodes_of
from activelsd.evaluate.traces import Trace, trace
from activelsd.registry import LEARNED, moves_and_stop

CHOOSING = "val"
"""The split on which thresholds are chosen."""


class _Game(NamedTuple):
    """One player's moves, and the stops that are tried on them."""

    entrant: Entrant
    moves: str
    stops: list[str]


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
    wanted = _wanted(entrants, baselines, seed)
    traces = _traces(wanted, (CHOOSING,), per_object=per_object, seed=seed, device=device, progress=progress)
    return {
        name: nearest(traces[entrant.name, moves][0], stop, mean)
        for name, (entrant, moves, stop) in wanted.items()
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
        DataError: there are no validation objects.
    """
    wanted = _wanted(entrants, baselines, seed)
    traces = _traces(
        wanted, (CHOOSING, split), per_object=per_object, seed=seed, device=device, progress=progress
    )
    curves = {}
    for name, (entrant, moves, stop) in wanted.items():
        chosen_on, measured = traces[entrant.name, moves]
        curves[name] = (stop, chosen_on, measured)
    return frontier(curves, seed=seed)


def _wanted(
    entrants: Sequence[Entrant], baselines: Sequence[str], seed: int
) -> dict[str, tuple[Entrant, str, str]]:
    """By player: whose network it has, and the names of its moves and of its stop."""
    wanted = {one.name: (one, LEARNED, LEARNED) for one in entrants}
    for name in baselines:
        moves, stop = moves_and_stop(name)
        made = make_player(name, entrants[0].network, entrants[0].graph, seed)
        if isinstance(made, Trained) and made.takes_stops:
            wanted[name] = entrants[0], moves, stop or LEARNED
    return wanted


def _traces(
    wanted: Mapping[str, tuple[Entrant, str, str]],
    splits: Sequence[str],
    *,
    per_object: int | None,
    seed: int,
    device: str,
    progress: Progress | None,
) -> dict[tuple[str, str], list[Trace]]:
    """By run and moves, a trace for every split; one game serves all stops."""
    games: dict[tuple[str, str], _Game] = {}
    for entrant, moves, stop in wanted.values():
        games.setdefault((entrant.name, moves), _Game(entrant, moves, [])).stops.append(stop)
    todo = [
        (key, game, episodes_of(game.entrant.graph, split, per_object=per_object, seed=seed))
        for key, game in games.items()
        for split in splits
    ]
    done, total = 0, sum(len(rows) for *_, rows in todo)
    traces: dict[tuple[str, str], list[Trace]] = {}
    for key, (entrant, moves, stops), rows in todo:
        player = make_player(f"{moves}+{LEARNED}", entrant.network, entrant.graph, seed)
        assert isinstance(player, Trained)
        with nullcontext() if moves == LEARNED else registry.players.blaming(moves, "fails"):
            played = trace(
                player,
                {name: registry.stops.get(name)(entrant.network) for name in stops},
                entrant.graph,
                entrant.rules,
                rows,
                device=device,
                progress=shifted(progress, done, total),
            )
        traces.setdefault(key, []).append(played)
        done += len(rows)
    return traces
