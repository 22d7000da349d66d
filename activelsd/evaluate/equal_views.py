"""Measures runs and players at equal mean views: plays each to the last view and compares the curves."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

from activelsd import registry
from activelsd.evaluate.compare import Entrant, shifted
from activelsd.evaluate.frontier import Frontier, frontier
from activelsd.evaluate.players import Trained, make_player
from activelsd.evaluate.protocol import Progress, episodes_of
from activelsd.evaluate.traces import Trace, trace
from activelsd.registry import LEARNED, moves_and_stop

CHOOSING = "val"
"""The split on which thresholds are chosen."""


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
    wanted = [(one.name, one, LEARNED, LEARNED) for one in entrants]
    for name in baselines:
        moves, stop = moves_and_stop(name)
        made = make_player(name, entrants[0].network, entrants[0].graph, seed)
        if isinstance(made, Trained) and made.takes_stops:
            wanted.append((name, entrants[0], moves, stop or LEARNED))
    stops_of: dict[tuple[str, str], list[str]] = {}  # by run and moves: one game serves all stops
    for _, entrant, moves, stop in wanted:
        stops_of.setdefault((entrant.name, moves), []).append(stop)
    lists = {
        one.name: [episodes_of(one.graph, of, per_object=per_object, seed=seed) for of in (CHOOSING, split)]
        for one in entrants
    }
    runs = {one.name: one for one in entrants}
    total = sum(len(rows) for run, _ in stops_of for rows in lists[run])
    done, traces = 0, dict[tuple[str, str], list[Trace]]()
    for (run, moves), stops in stops_of.items():
        entrant = runs[run]
        for rows in lists[run]:
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
            traces.setdefault((run, moves), []).append(played)
            done += len(rows)
    curves = {}
    for name, entrant, moves, stop in wanted:
        chosen_on, measured = traces[entrant.name, moves]
        curves[name] = (stop, chosen_on, measured)
    return frontier(curves, seed=seed)
