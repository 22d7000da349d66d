"""Players on the same episodes: play them all, and say how they stand and differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.graphenv import tree_of
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, RunError
from activelsd.evaluate.baselines import make_baseline
from activelsd.evaluate.metrics import (
    EpisodeGroup,
    Interval,
    Scores,
    by_allowed,
    by_class,
    by_difficulty,
    by_views,
    gain_closed,
    intervals,
    path_lengths,
    score,
)
from activelsd.evaluate.players import Trained
from activelsd.evaluate.protocol import BATCH, EpisodeRow, Player, Progress, episodes_of, play
from activelsd.policy.lsdnet import LSDNet


@dataclass(frozen=True, kw_only=True, eq=False)
class Entrant:
    """A trained run, and the world it is played in.

    Attributes:
        name: how tables and files call it.
        network: what it learned.
        graph: its world with its own moves.
        rules: what it was trained by; the protocol's own end takes the place of theirs.
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
    """How one player did.

    Attributes:
        name: of the player.
        world: where it played.
        backend: what made the pictures.
        episodes: how many.
        max_views: T.
        accuracy: fraction of right answers.
        views: views seen when the answer was given.
        steps: steps-to-recognise over all episodes; a wrong answer counts T.
        views_right: views seen, over the episodes answered right; None where there is none.
        forced: fraction of answers given where no move was legal.
        spl: see `metrics.path_lengths`; None where nobody knows the oracle's views.
        difficulties: episodes by the difficulty of their first view, where it is graded.
        classes: episodes by label.
        seen: episodes by views seen, 1 … T (the paper's Table 3).
        allowed: the same episodes had only 1 … T views been allowed.
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
    spl: Interval | None
    difficulties: list[EpisodeGroup]
    classes: list[EpisodeGroup]
    seen: list[EpisodeGroup]
    allowed: list[EpisodeGroup]


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A player less the reference, episode by episode."""

    name: str
    reference: str
    episodes: int
    accuracy: Interval
    views: Interval
    steps: Interval


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """How players stand on the same episodes.

    Attributes:
        split: of the episodes.
        per_object: random starts per object, None for every start.
        seed: of random starts, of players that draw, of resampling.
        objects: how many objects the episodes are about.
        players: how each did, the reference first.
        paired: what each of the others did differently.
        gain_closed: how much of the way from `no_move`'s accuracy to `all_views`' the reference goes; None
            where one of them did not play or the second is not surely better.
        rows: per player its episodes, in one order.
        graph: the reference's world.
    """

    split: str
    per_object: int | None
    seed: int
    objects: int
    players: list[Standing]
    paired: list[Difference]
    gain_closed: Interval | None
    rows: dict[str, list[EpisodeRow]] = field(repr=False)
    graph: ViewGraph = field(repr=False)

    @property
    def reference(self) -> Standing:
        """The trained run that the others are compared with."""
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
) -> Comparison:
    """Play trained runs and baselines on the same episodes.

    Args:
        entrants: at least one; the first is the reference, and the baselines share its network, moves and
            rules.
        baselines: names out of `baselines.BASELINES`.
        split: `train`, `val` or `test`.
        per_object: random starts per object; None for every start.
        seed: of random starts, of players that draw, of resampling.
        device: where the views lie and the networks compute.
        batch: episodes side by side; changes nothing but the time taken.
        progress: told how many episodes of all players are over.

    Raises:
        ConfigError: a baseline is unknown or a name stands twice.
        DataError: the split is empty.
        RunError: a run does not fit its world, or two runs' worlds have different episodes.
    """
    first = entrants[0]
    turns: list[tuple[Player, Entrant]] = [(Trained(one.network, one.name), one) for one in entrants]
    turns += [(make_baseline(name, first.network, first.graph, seed), first) for name in baselines]
    names = [player.name for player, _ in turns]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"Player '{name}' is named twice; name each run and baseline once.")
    for entrant in entrants:
        _check_fits(entrant)
    episodes = [episodes_of(one.graph, split, per_object=per_object, seed=seed) for one in entrants]
    for entrant, listed in zip(entrants, episodes, strict=True):
        _check_same(first, episodes[0], entrant, listed)

    total, rows = len(turns) * len(episodes[0]), dict[str, list[EpisodeRow]]()
    for player, entrant in turns:
        entrant.network.to(device)
        rows[player.name] = play(
            player,
            entrant.graph,
            entrant.rules,
            episodes[entrants.index(entrant)],
            world=entrant.world,
            backend=entrant.backend,
            device=device,
            batch=batch,
            progress=_shifted(progress, len(rows) * len(episodes[0]), total),
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
    """The few figures a run watches while it trains, by the same protocol; it draws nothing at random."""
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
    """Count the episodes of players that played the same list, the reference first."""
    scores = {name: score(some, max_views[name]) for name, some in rows.items()}
    reference = next(iter(rows))
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
            _standing(some, scores[name], max_views[name], seed, graph.difficulty_names)
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


def _standing(
    rows: list[EpisodeRow],
    scores: Scores,
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
        spl=path_lengths(rows, seed=seed),
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


def _check_fits(entrant: Entrant) -> None:
    """A network plays only where its actions mean what they meant, and pictures are of its size."""
    network, graph = entrant.network, entrant.graph
    if network.tree != tree_of(graph):
        raise RunError(
            f"{entrant.name} was trained for other classes or moves than this world has; "
            "give it the world it was trained in, or train again."
        )
    if network.shape.size != graph.size:
        raise RunError(
            f"{entrant.name} was trained on pictures of {network.shape.size} pixels and this world's "
            f"have {graph.size}; set env.size={network.shape.size}."
        )


def _check_same(
    first: Entrant, episodes: NDArray[np.int64], other: Entrant, listed: NDArray[np.int64]
) -> None:
    """Players are compared on the same episodes only."""
    if other.graph is first.graph:
        return
    ours = [first.graph.episode(int(row)).id for row in episodes]
    theirs = [other.graph.episode(int(row)).id for row in listed]
    if ours != theirs or first.graph.classes != other.graph.classes:
        raise RunError(
            f"{first.name} and {other.name} do not play the same episodes; "
            "compare runs whose env.dataset settings are the same."
        )


def _shifted(progress: Progress | None, before: int, total: int) -> Progress | None:
    """Progress of one player as part of all."""
    if progress is None:
        return None
    return lambda done, _: progress(before + done, total)
