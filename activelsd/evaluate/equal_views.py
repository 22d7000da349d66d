"""Runs and players at equal mean views: their episodes to the last view, and thresholds from val objects."""

from __future__ import annotations

from collections.abc import Sequence
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

    @property
    def game(self) -> tuple[str, str]:
        """Whose network and whose moves; players that share them differ in their stops alone."""
        return self.entrant.name, self.moves


_Games = dict[tuple[str, str], Trace]
"""By run and moves; one game serves all stops."""


class EqualViews:
    """Runs, each with its learned stop, and the baselines that take stops; each split is played once."""

    def __init__(
        self,
        entrants: Sequence[Entrant],
        baselines: Sequence[str],
        *,
        per_object: int | None,
        seed: int,
        device: str,
    ) -> None:
        """Say who takes part; nothing is played yet.

        Args:
            entrants: trained runs; the first is the reference, and the baselines share its network.
            baselines: names of players; others than MOVES, STOP and MOVES+STOP are left out.
            per_object: random starts per object; None for every start.
            seed: of random starts, of players that draw at random, and of resampling.
            device: where the networks are.

        Raises:
            DataError: there are no validation objects.
            RunError: a run does not fit its world.
        """
        self._per_object, self._seed, self._device = per_object, seed, device
        self._most = entrants[0].rules.max_views
        self._parts: dict[str, _Part] = {}
        self._played: dict[str, _Games] = {}
        for one in entrants:
            check_fits(one)
            if not (one.graph.start_split == SPLITS.index(CHOOSING)).any():
                raise DataError(
                    f"Thresholds are chosen on {CHOOSING} objects, and {one.world} has none; leave out"
                    " --frontier and --views, or give the data set some."
                )
            one.network.to(device)
            self._parts[one.name] = _Part(one, LEARNED, LEARNED)
        for name in baselines:
            moves, stop = moves_and_stop(name)
            if takes_stops(moves, stop):
                self._parts[name] = _Part(entrants[0], moves, stop)

    def thresholds(self, mean: float, progress: Progress | None = None) -> dict[str, NDArray[np.float64]]:
        """Thresholds (T,) by player with which its mean on validation objects is nearest to a wanted one.

        Raises:
            ConfigError: no episode may have so many views.
        """
        if mean > self._most:
            raise ConfigError(
                f"--views {mean:g} is more than the {self._most} views that an episode may have."
            )
        (val,) = self._games([CHOOSING], progress)
        return {name: nearest(val[one.game], one.stop, mean) for name, one in self._parts.items()}

    def frontier(self, split: str, progress: Progress | None = None) -> Frontier:
        """Compares all at equal mean views on a split; thresholds are chosen on validation objects.

        Raises:
            ConfigError: some player sees too few views.
        """
        val, measured = self._games([CHOOSING, split], progress)
        traces = {name: (one.stop, val[one.game], measured[one.game]) for name, one in self._parts.items()}
        return frontier(traces, seed=self._seed)

    def _games(self, splits: Sequence[str], progress: Progress | None) -> list[_Games]:
        """All games of each split; those that were not played yet are played now."""
        parts: dict[tuple[str, str], list[_Part]] = {}
        for one in self._parts.values():
            parts.setdefault(one.game, []).append(one)
        todo = [
            (
                split,
                some,
                episodes_of(some[0].entrant.graph, split, per_object=self._per_object, seed=self._seed),
            )
            for split in dict.fromkeys(splits)
            if split not in self._played
            for some in parts.values()
        ]
        done, total = 0, sum(len(rows) for *_, rows in todo)
        for split, some, rows in todo:
            games = self._played.setdefault(split, {})
            games[some[0].game] = self._play(some, rows, shifted(progress, done, total))
            done += len(rows)
        return [self._played[split] for split in splits]

    def _episodes(self, entrant: Entrant, split: str) -> NDArray[np.int64]:
        return episodes_of(entrant.graph, split, per_object=self._per_object, seed=self._seed)

    def _play(self, parts: Sequence[_Part], rows: NDArray[np.int64], progress: Progress | None) -> Trace:
        entrant, moves, _ = parts[0]
        players = {
            one.stop: make_player(
                f"{moves}+{one.stop}" if one.stop else moves, entrant.network, entrant.graph, self._seed
            )
            for one in parts
        }
        stops = {name: player.stop for name, player in players.items() if isinstance(player, Trained)}
        mover = players[parts[0].stop]
        assert isinstance(mover, Trained)
        with nullcontext() if moves == LEARNED else registry.players.blaming(moves, "fails"):
            return trace(
                mover,
                stops,
                entrant.graph,
                entrant.rules,
                rows,
                device=self._device,
                progress=progress,
            )
