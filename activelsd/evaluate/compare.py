"""Plays several players on the same episodes and computes their results and differences."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from activelsd import registry
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.graphenv import tree_of
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, RunError
from activelsd.evaluate.frontier import Frontier
from activelsd.evaluate.metrics import (
    EpisodeGroup,
    Interval,
    Scores,
    by_allowed,
    by_class,
    by_difficulty,
    by_views,
    figure_interval,
    gain_closed,
    intervals,
    score,
)
from activelsd.evaluate.players import Trained, make_player
from activelsd.evaluate.protocol import BATCH, EpisodeRow, Player, Progress, Recognising, episodes_of, play
from activelsd.evaluate.recognisers.interface import Recogniser
from activelsd.evaluate.recognisers.rows import Recognition
from activelsd.policy.lsdnet import LSDNet
from activelsd.registry import BrokenPartError

_LOG = logging.getLogger("activelsd")


@dataclass(frozen=True, kw_only=True, eq=False)
class Entrant:
    """A trained run and the world it plays in.

    Attributes:
        name: what tables and files call it.
        network: the trained network.
        graph: its world with its own moves.
        rules: the rules of training; what ends an episode is replaced by the protocol's own.
        world: the world's name.
        backend: what made the pictures.
    """

    name: str
    network: LSDNet
    graph: ViewGraph
    rules: EpisodeRules
    world: str
    backend: str


@dataclass(frozen=True, kw_only=True)
class Standing:
    """The results of one player.

    Attributes:
        name: name of the player.
        world: name of the world.
        backend: what made the pictures.
        episodes: number of episodes.
        max_views: T.
        accuracy: fraction of right answers.
        views: mean views seen when the answer was given.
        steps: mean steps-to-recognise over all episodes; a wrong answer counts T.
        views_right: mean views seen in the episodes answered right; None if there is none.
        forced: fraction of answers given when no move was legal.
        figures: registered figures that are known for any player, by name; None if not for this one.
        difficulties: episodes by the difficulty of their first view, if it is graded.
        classes: episodes by label.
        seen: episodes by views seen, 1 … T (the paper's Table 3).
        allowed: the same episodes as if only 1 … T views had been allowed.
    """

    name: str
    world: str
    backend: str
    episodes: int
    max_views: int
    accuracy: Interval
    views: Interval
    steps: Interval
    views_right: float | None
    forced: float
    figures: dict[str, Interval | None]
    difficulties: list[EpisodeGroup]
    classes: list[EpisodeGroup]
    seen: list[EpisodeGroup]
    allowed: list[EpisodeGroup]


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Means and intervals of a player minus the reference, paired by episode."""

    name: str
    reference: str
    episodes: int
    accuracy: Interval
    views: Interval
    steps: Interval


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Results of several players on the same episodes.

    Attributes:
        split: the split that the episodes are from.
        per_object: random starts per object; None for every start.
        seed: of random starts, of players that draw at random, and of resampling.
        objects: number of objects in the episodes.
        players: results of every player, the reference first.
        paired: differences of the other players from the reference.
        gain_closed: `metrics.gain_closed` of the reference; None if `no_move` or `all_views` did not play.
        changed: settings of the reference's world that were changed since its training, by dotted key.
        recognised: results of recognisers with the same objects.
        frontier: accuracy at equal mean views, if it was asked for.
        wanted_views: mean views that thresholds of stops were chosen for; None: the usual ones.
        rows: episodes of every player, in the same order.
        graph: the reference's world.
    """

    split: str
    per_object: int | None
    seed: int
    objects: int
    players: list[Standing]
    paired: list[Difference]
    gain_closed: Interval | None
    changed: Mapping[str, Any] = field(default_factory=dict)
    recognised: Sequence[Recognition] = ()
    frontier: Frontier | None = None
    wanted_views: float | None = None
    rows: dict[str, list[EpisodeRow]] = field(repr=False)
    graph: ViewGraph = field(repr=False)

    @property
    def reference(self) -> Standing:
        """Results of the trained run that the others are compared with."""
        return self.players[0]


def compare(
    entrants: Sequence[Entrant],
    baselines: Sequence[str] = (),
    *,
    split: str = "test",
    per_object: int | None = None,
    seed: int = 0,
    device: str = "cpu",
    batch: int = BATCH,
    progress: Progress | None = None,
    recognisers: Mapping[str, Recogniser] | None = None,
    thresholds: Mapping[str, NDArray[np.float64]] | None = None,
) -> Comparison:
    """Plays trained runs and registered players on the same episodes.

    Args:
        entrants: at least one; the first is the reference, and the baselines share its network, moves and
            rules.
        baselines: names in `registry.players`, or MOVES+STOP, see `make_player`.
        split: `train`, `val` or `test`.
        per_object: random starts per object; None for every start.
        seed: of random starts, of players that draw at random, and of resampling.
        device: where the views are and the networks compute.
        batch: episodes in parallel; it changes only the time taken.
        progress: called with the finished and all episodes of all players.
        recognisers: trained ones by name, for baselines that name by them.
        thresholds: of players' stops by player, in place of the usual ones.

    Raises:
        ConfigError: a baseline is unknown or does not fit the world, or two players have the same name.
        DataError: the split is empty.
        RunError: a run does not fit its world, or two runs' worlds have different episodes.
    """
    first = entrants[0]
    for entrant in entrants:
        check_fits(entrant)
        entrant.network.to(device)
    turns: list[tuple[Player, Entrant]] = [(Trained(one.network, name=one.name), one) for one in entrants]
    turns += [(make_player(name, first.network, first.graph, seed), first) for name in baselines]
    for player, _ in turns:
        if isinstance(player, Recognising):
            if recognisers is None or player.recogniser not in recognisers:
                raise ConfigError(
                    f"Player '{player.name}' needs the recogniser '{player.recogniser}'; train it first."
                )
            player.take(recognisers[player.recogniser])
        if thresholds and player.name in thresholds:
            assert isinstance(player, Trained)
            player.stop.thresholds = torch.from_numpy(thresholds[player.name]).float()
    names = [player.name for player, _ in turns]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"Player '{name}' is named twice; name each run and baseline once.")
    episodes = [episodes_of(one.graph, split, per_object=per_object, seed=seed) for one in entrants]
    for entrant, listed in zip(entrants, episodes, strict=True):
        _check_same(first, episodes[0], entrant, listed)

    total, rows = len(turns) * len(episodes[0]), dict[str, list[EpisodeRow]]()
    for player, entrant in turns:
        moves = registry.moves_and_stop(player.name)[0] if player.name in baselines else registry.LEARNED
        with nullcontext() if moves == registry.LEARNED else registry.players.blaming(moves, "fails"):
            rows[player.name] = play(
                player,
                entrant.graph,
                entrant.rules,
                episodes[entrants.index(entrant)],
                world=entrant.world,
                backend=entrant.backend,
                device=device,
                batch=batch,
                progress=shifted(progress, len(rows) * len(episodes[0]), total),
            )
    limits = {player.name: entrant.rules.max_views for player, entrant in turns}
    return assemble(rows, limits, first.graph, split=split, per_object=per_object, seed=seed)


def measure(
    network: LSDNet,
    graph: ViewGraph,
    rules: EpisodeRules,
    *,
    split: str = "val",
    world: str,
    backend: str,
    device: str = "cpu",
    batch: int = BATCH,
) -> dict[str, float]:
    """Returns the figures that a run logs while it trains, by the same protocol and without random draws."""
    rows = play(
        Trained(network),
        graph,
        rules,
        episodes_of(graph, split),
        world=world,
        backend=backend,
        device=device,
        batch=batch,
    )
    means = score(rows, rules.max_views).values.mean(0)
    return {
        "accuracy": float(means[0]),
        "views": float(means[1]),
        "steps": float(means[2]),
        "accuracy_at_first_view": float(np.mean([row.answers[0] == row.label for row in rows])),
    }


def assemble(
    rows: dict[str, list[EpisodeRow]],
    max_views: dict[str, int],
    graph: ViewGraph,
    *,
    split: str,
    per_object: int | None,
    seed: int,
) -> Comparison:
    """Computes the results of players that played the same list of episodes, the reference first."""
    scores = {name: score(some, max_views[name]) for name, some in rows.items()}
    reference = next(iter(rows))
    figures = _figures(rows, seed)
    right = {name: one.right for name, one in scores.items()}
    closed = None
    if right.keys() >= {"no_move", "all_views"}:
        objects = scores[reference].objects
        closed = gain_closed(right[reference], right["no_move"], right["all_views"], objects, seed=seed)
    return Comparison(
        split=split,
        per_object=per_object,
        seed=seed,
        objects=int(scores[reference].objects.max()) + 1,
        players=[
            _standing(some, scores[name], figures[name], max_views[name], seed, graph.difficulty_names)
            for name, some in rows.items()
        ],
        paired=[
            _difference(name, one, reference, scores[reference], seed)
            for name, one in scores.items()
            if name != reference
        ],
        gain_closed=closed,
        rows=rows,
        graph=graph,
    )


def _figures(rows: dict[str, list[EpisodeRow]], seed: int) -> dict[str, dict[str, Interval | None]]:
    """Computes the registered figures of every player; leaves out those that are known for none.

    A figure that fails is left out with a warning, since every comparison would fail otherwise.
    """
    figures: dict[str, dict[str, Interval | None]] = {name: {} for name in rows}
    for figure in registry.figures.names():
        try:
            if figure in Standing.__dataclass_fields__:
                raise registry.figures.broken(figure, "has a name that every player's own figures use")
            function = registry.figures.get(figure)
            with registry.figures.blaming(figure, "fails"):
                found = {name: figure_interval(function, some, seed=seed) for name, some in rows.items()}
        except BrokenPartError as error:
            _LOG.warning("%s It is left out.", error)
            continue
        if any(found.values()):
            for name, interval in found.items():
                figures[name][figure] = interval
    return figures


def _standing(
    rows: list[EpisodeRow],
    scores: Scores,
    figures: dict[str, Interval | None],
    max_views: int,
    seed: int,
    difficulties: tuple[str, ...] | None,
) -> Standing:
    accuracy, views, steps = intervals(scores.values, scores.objects, seed=seed)
    return Standing(
        name=rows[0].player,
        world=rows[0].world,
        backend=rows[0].backend,
        episodes=len(rows),
        max_views=max_views,
        accuracy=accuracy,
        views=views,
        steps=steps,
        views_right=float(scores.views[scores.right].mean()) if scores.right.any() else None,
        forced=float(np.mean([row.forced for row in rows])),
        figures=figures,
        difficulties=by_difficulty(rows, difficulties),
        classes=by_class(rows),
        seen=by_views(rows, max_views),
        allowed=by_allowed(rows, max_views),
    )


def _difference(name: str, scores: Scores, reference: str, to: Scores, seed: int) -> Difference:
    accuracy, views, steps = intervals(scores.values - to.values, to.objects, seed=seed)
    return Difference(
        name=name,
        reference=reference,
        episodes=len(scores.right),
        accuracy=accuracy,
        views=views,
        steps=steps,
    )


def check_fits(entrant: Entrant) -> None:
    """Checks that the world has the actions and the picture size that the network was trained with."""
    network, graph = entrant.network, entrant.graph
    if network.tree != tree_of(graph):
        raise RunError(
            f"{entrant.name} was trained for other classes or moves than this world has:"
            f" {network.tree.differences(tree_of(graph))}; give it the world it was trained in, or train"
            " again."
        )
    if network.shape.size != graph.size:
        raise RunError(
            f"{entrant.name} was trained on pictures of {network.shape.size} pixels and this world's "
            f"have {graph.size}; set env.size={network.shape.size}."
        )
    if network.shape.channels != graph.channels:
        learned = "gray" if network.shape.channels == 1 else "rgb"
        raise RunError(
            f"{entrant.name} was trained on pictures in {learned} and this world's have {graph.channels} "
            f"channel(s); set env.colour={learned}."
        )


def _check_same(
    first: Entrant, episodes: NDArray[np.int64], other: Entrant, listed: NDArray[np.int64]
) -> None:
    """Checks that both worlds list the same episodes."""
    if other.graph is first.graph:
        return
    ours = [first.graph.episode(int(row)).id for row in episodes]
    theirs = [other.graph.episode(int(row)).id for row in listed]
    if ours != theirs or first.graph.classes != other.graph.classes:
        raise RunError(
            f"{first.name} and {other.name} do not play the same episodes; "
            "compare runs whose worlds have the same settings."
        )


def shifted(progress: Progress | None, before: int, total: int) -> Progress | None:
    """Returns the progress of one player as a part of all players' progress."""
    if progress is None:
        return None
    return lambda done, _: progress(before + done, total)
