"""The protocol for all players: one answer per episode, and the same fixed list of episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph

if TYPE_CHECKING:
    from activelsd.evaluate.recognisers.interface import Recogniser

BATCH = 128
"""Episodes played in parallel: enough to keep a CPU core busy, few enough to end at about the same time."""

Progress = Callable[[int, int], None]
"""Called with the number of finished episodes and of all episodes."""


class Player(Protocol):
    """Plays B episodes in parallel, by a network or by rules.

    Index i of the batch plays the list's episodes i, i + B, i + 2B, …: a player that draws at random can
    number its draws by episode and view, so that it plays the same in a batch of any size.

    Attributes:
        name: what tables and files call it.
        frames: K, how many views the observation stacks.
    """

    name: str
    frames: int

    def begin(self, batch: int) -> None:
        """Forgets everything; `batch` episodes begin."""

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns a legal action for every episode, int64 (B,); called once per view.

        Args:
            observation: tensors (B, ...) as from `ViewGraphVectorEnv.observe`.
            mask: bool (B, n), the legal actions.
            first: bool (B,), whether this is the first view of an episode.
        """

    def answer(self) -> Tensor:
        """Returns the classes it would name if the view of the last `act` were the last one, int64 (B,)."""


@runtime_checkable
class Insider(Protocol):
    """A player that also wants to know where it is, which observations do not say."""

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Called before `act` with the graph's view and target of every episode, int64 (B,)."""


@runtime_checkable
class Recognising(Protocol):
    """A player that names by a recogniser, which is trained before it plays.

    Attributes:
        recogniser: the recogniser's name; of the class, so that it is known before a player is made.
    """

    recogniser: str

    def take(self, recogniser: Recogniser) -> None:
        """Called once before `begin` with the trained recogniser."""


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """One episode of one player, as `episodes.jsonl` holds it; every figure is computed from these rows.

    Attributes:
        player: name of the player.
        world: name of the world.
        backend: what made the pictures.
        scene: name of the scene.
        target: the object asked for.
        label: class of the target.
        start: name of the first view.
        views: views seen when the answer was given.
        answer: the class named.
        right: whether `answer` is `label`.
        forced: whether no move was legal when the answer was given.
        oracle_views: fewest views until one shows the target well, -1 if none can be reached; None if not
            known.
        difficulty: of the first view; None if not graded.
        path: names of the views seen, in order.
        answers: for every view seen, the class it would have named if that were the last view allowed; the
            last one is `answer`.
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
    """Returns the fixed list of episodes, as rows of the graph's starts.

    Args:
        graph: the world.
        split: `train`, `val` or `test`.
        per_object: number of random starts of every target (the paper: 20); None for every start.
        seed: of the random starts.

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
    """Plays a list of episodes and returns a row for each, in the order of the list.

    The first class ends an episode, and at the last view only classes are legal, so each gets an answer.

    Args:
        player: who plays; its network, if it has one, is on `device`.
        graph: the world.
        rules: the rules of training; what ends an episode is replaced by the protocol's own.
        episodes: rows of the graph's starts, as from `episodes_of`.
        world: written into every row.
        backend: written into every row.
        device: where the views are.
        batch: episodes in parallel; it changes only the time taken.
        progress: called as episodes end.

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
    index = list(range(batch))  # in the list, of the episode that each environment plays
    seen: list[list[tuple[int, int]]] = [[] for _ in range(batch)]  # views, and the class for each
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
            # An environment without episodes left repeats the list's last one, which is not counted.
            if index[i] < len(episodes):
                looks = [*seen[i][:-1], (seen[i][-1][0], answers[i])]
                start = int(episodes[index[i]])
                rows[index[i]] = _row(player.name, world, backend, graph, start, looks, forced=forced[i])
                over += 1
            index[i] += batch
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
    """Makes the row of an episode from its views and the class for each."""
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
