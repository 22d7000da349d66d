"""Episodes played to their last view, with what every stop would have said: any stop can be tried on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.players import Trained
from activelsd.evaluate.protocol import BATCH, Progress, play
from activelsd.evaluate.stops import Stop
from activelsd.policy.heads import ActionDistribution
from activelsd.policy.lsdnet import LSDNet


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """N episodes of one player that went on as long as it could, T views at most.

    Attributes:
        right: bool (N, T), whether the class named after 1 … T views is the target's.
        length: int64 (N,), views seen; what follows them repeats the last.
        objects: int64 (N,), index of each episode's target, 0 … O-1.
        scores: for every stop, by name, float32 (N, T).
        by_view: the stops whose thresholds differ by number of views.
    """

    right: NDArray[np.bool_]
    length: NDArray[np.int64]
    objects: NDArray[np.int64]
    scores: Mapping[str, NDArray[np.float32]]
    by_view: frozenset[str]


class _Recording(Stop):
    """Never answers, and keeps what other stops say."""

    usual = float("inf")

    def __init__(self, network: LSDNet, stops: Mapping[str, Stop]) -> None:
        super().__init__(network)
        self._stops = stops
        self.first: list[Tensor] = []
        self.said: dict[str, list[Tensor]] = {name: [] for name in stops}

    def begin(self, batch: int, device: torch.device) -> None:
        super().begin(batch, device)
        for stop in self._stops.values():
            stop.begin(batch, device)

    def rate(self, policy: ActionDistribution, first: Tensor) -> Tensor:
        self.first.append(first.cpu())
        for name, stop in self._stops.items():
            stop.look(policy, first)
            self.said[name].append(stop.score.cpu())
        return torch.zeros_like(self.score)


def trace(
    player: Trained,
    stops: Mapping[str, Stop],
    graph: ViewGraph,
    rules: EpisodeRules,
    episodes: NDArray[np.int64],
    *,
    device: str = "cpu",
    batch: int = BATCH,
    progress: Progress | None = None,
) -> Trace:
    """Plays a list of episodes to their last views.

    Args:
        player: who moves; its own stop is replaced.
        stops: to be asked at every view, by name.
        graph: the world.
        rules: the rules of training.
        episodes: rows of the graph's starts.
        device: where the player's network is.
        batch: episodes in parallel; it changes only the time taken.
        progress: called as episodes end.
    """
    player.stop = watch = _Recording(player.network, stops)
    rows = play(
        player, graph, rules, episodes, world="", backend="", device=device, batch=batch, progress=progress
    )
    length = np.array([len(row.answers) for row in rows])
    at = np.minimum(np.arange(rules.max_views), length[:, None] - 1)
    answers = np.array([np.array(row.answers)[i] for row, i in zip(rows, at, strict=True)])
    _, objects = np.unique([row.target for row in rows], return_inverse=True)
    first = torch.stack(watch.first).numpy()
    scores = {
        name: np.take_along_axis(_by_episode(torch.stack(said).numpy(), first, length), at, 1)
        for name, said in watch.said.items()
    }
    return Trace(
        right=answers == np.array([row.label for row in rows])[:, None],
        length=length,
        objects=objects,
        scores=scores,
        by_view=frozenset(name for name, stop in stops.items() if stop.by_view),
    )


def _by_episode(
    said: NDArray[np.float32], first: NDArray[np.bool_], length: NDArray[np.int64]
) -> NDArray[np.float32]:
    """What was said at every step to each of B episodes at a time, (S, B), as (N, T) by episode and view."""
    steps, batch = first.shape
    number = np.cumsum(first, 0) - 1  # of the episode among those of its place in the batch
    begun = np.maximum.accumulate(np.where(first, np.arange(steps)[:, None], 0), 0)
    episode, view = np.arange(batch) + number * batch, np.arange(steps)[:, None] - begun
    counts = episode < len(length)  # places without episodes left repeat the last
    found = np.zeros((len(length), int(length.max())), np.float32)
    found[episode[counts], view[counts]] = said[counts]
    return found
