"""The protocol every player is measured by: one answer an episode, one frozen list of episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph

BATCH = 128
"""Episodes side by side: enough to feed a CPU core, few enough that they end at about the same time."""

Progress = Callable[[int, int], None]
"""Called with the episodes that are over and all there are."""


class Player(Protocol):
    """Plays B episodes side by side; what is learned and what is scripted are played alike.

    Place i of the batch plays the list's episodes i, i + B, i + 2B, …: a player that draws can number its
    draws by episode and view, and then plays the same in any batch.

    Attributes:
        name: how tables and files call it.
        frames: K, how many views it wants stacked.
    """

    name: str
    frames: int

    def begin(self, batch: int) -> None:
        """Forget everything; `batch` episodes begin."""

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Choose, once per view.

        Args:
            observation: as of `ViewGraphVectorEnv.observe`, (B, ...).
            mask: (B, n) bool, the legal actions.
            first: (B,) bool, where this is an episode's first view.

        Returns:
            (B,) int64 legal actions.
        """

    def answer(self) -> Tensor:
        """(B,) int64 classes it would have named, had the view it acted on last been the last allowed."""


@runtime_checkable
class Insider(Protocol):
    """A player that is told where it is, which no observation says."""

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Before `act`: int64 (B,) the graph's view and target of every episode."""


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """One episode of one player, as it stands in `episodes.jsonl`; every figure is computed from these.

    Attributes:
        player: who played.
        world: the world's name.
        backend: what made the pictures.
        scene: where.
        target: the object asked for.
        label: its class.
        start: name of the first view.
        views: views seen when the answer was given.
        answer: the class named.
        right: whether it is the label.
        forced: it was named where no move was legal.
        oracle_views: fewest views until one shows the target well, -1 where none can be reached; None where
            nobody knows.
        difficulty: of the first view, where it is graded.
        path: name of every view seen, in order.
        answers: per view seen, the class it would have named were no more allowed; the last is `answer`.
    """

    player: str
    world: str
    backend: str
    scene: str
    target: str
    label: str
    start: str
    views: int
    answer: str
    right: bool
    forced: bool
    oracle_views: int | None
    difficulty: str | None
    path: tuple[str, ...]
    answers: tuple[str, ...]


def episodes_of(
    graph: ViewGraph, split: str, *, per_object: int | None = None, seed: int = 0
) -> NDArray[np.int64]:
    """The frozen list of episodes, as rows of the graph's starts.

    Args:
        graph: the world.
        split: `train`, `val` or `test`.
        per_object: None for every start of every target; else so many random starts of each (the paper: 20).
        seed: draws the random starts.

    Raises:
        DataError: the split is unknown or empty.
    """
    rows = graph.starts(split)
    if per_object is None:
        return rows
    rng = np.random.default_rng(seed)
    rows = rows[np.argsort(graph.start_target[rows], kind="stable")]
    _, begins = np.unique(graph.start_target[rows], return_index=True)
    return np.concatenate([rng.choice(one, per_object) for one in np.split(rows, begins[1:])])


@torch.inference_mode()
def play(
    player: Player,
    graph: ViewGraph,
    rules: EpisodeRules,
    episodes: NDArray[np.int64],
    *,
    world: str,
    backend: str,
    device: str = "cpu",
    batch: int = BATCH,
    progress: Progress | None = None,
) -> list[EpisodeRow]:
    """Play a list of episodes to their end.

    The first class ends an episode, and at the last view only classes are legal, so each gets an answer.

    Args:
        player: who plays; its network, where it has one, is on `device`.
        graph: the world.
        rules: what a run was trained by; the protocol's own end takes the place of theirs.
        episodes: rows of the graph's starts, as of `episodes_of`.
        world: written into every row.
        backend: written into every row.
        device: where the views lie.
        batch: episodes side by side; it changes nothing but the time taken.
        progress: told how many episodes are over.

    Returns:
        A row per episode, in the order of the list.

    Raises:
        ValueError: the player took an action that is not legal.
    """
    batch = min(batch, len(episodes))
    env = ViewGraphVectorEnv(
        graph,
        rules.for_evaluation(),
        num_envs=batch,
        frames=player.frames,
        backend=backend,
        device=device,
        playlist=episodes,
    )
    classes = env.tree.span(CLASSIFY)
    env.begin(0)
    player.begin(batch)
    first = torch.ones(batch, dtype=torch.bool, device=device)
    place = list(range(batch))  # number in the list of the episode that each environment plays
    seen: list[list[tuple[int, int]]] = [[] for _ in range(batch)]  # views, and the class named at each
    rows: list[EpisodeRow | None] = [None] * len(episodes)
    over = 0
    while over < len(episodes):
        mask = env.mask()
        views = env.views_seen()[:, -1].tolist()
        if isinstance(player, Insider):
            player.tell(env.views_seen()[:, -1], env.targets)
        actions = player.act(env.observe(), mask, first)
        if not bool(mask.gather(1, actions[:, None]).all()):
            raise ValueError(f"Player '{player.name}' took an action that the mask forbids.")
        for looks, view, named in zip(seen, views, player.answer().tolist(), strict=True):
            looks.append((view, named))
        step = env.advance(actions)
        first = step.terminated | step.truncated
        forced = (mask.sum(1) == mask[:, classes].sum(1)).tolist()
        answers = step.answer.tolist()
        for i in first.nonzero().squeeze(1).tolist():
            # An environment that has played all of its share goes on with its last episode: not counted.
            if place[i] < len(episodes):
                looks = [*seen[i][:-1], (seen[i][-1][0], answers[i])]
                start = int(episodes[place[i]])
                rows[place[i]] = _row(player.name, world, backend, graph, start, looks, forced=forced[i])
                over += 1
            place[i] += batch
            seen[i] = []
        if progress is not None:
            progress(over, len(episodes))
    return [row for row in rows if row is not None]


def _row(
    player: str,
    world: str,
    backend: str,
    graph: ViewGraph,
    start: int,
    looks: list[tuple[int, int]],
    *,
    forced: bool,
) -> EpisodeRow:
    """The row of an episode over, from the views seen and what each would have been named."""
    episode, answer = graph.episode(start), looks[-1][1]
    return EpisodeRow(
        player=player,
        world=world,
        backend=backend,
        scene=episode.scene,
        target=episode.target,
        label=graph.classes[episode.label],
        start=episode.start,
        views=len(looks),
        answer=graph.classes[answer],
        right=answer == episode.label,
        forced=forced,
        oracle_views=episode.oracle_views,
        difficulty=episode.difficulty,
        path=tuple(graph.view_names[view] for view, _ in looks),
        answers=tuple(graph.classes[named] for _, named in looks),
    )
