"""What a network thinks an object is, view by view: episodes played again, for Figure 4 of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.filmstrips import Filmstrip, choose, filmstrip
from activelsd.evaluate.players import Trained
from activelsd.evaluate.protocol import EpisodeRow, play
from activelsd.policy.heads import ActionDistribution
from activelsd.policy.lsdnet import LSDNet

VIEWS, SHOWN = 4, 4
"""The paper shows four episodes that took four steps before classifying."""


class CertaintyStrip(NamedTuple):
    """An episode as pictures, with the class distribution at every view."""

    strip: Filmstrip
    classes: NDArray[np.float32]  # (L, m) probability of each class given that the agent answers


def certainty_strips(
    network: LSDNet,
    graph: ViewGraph,
    rules: EpisodeRules,
    rows: Sequence[EpisodeRow],
    episodes: NDArray[np.int64],
    *,
    device: str = "cpu",
) -> list[CertaintyStrip]:
    """Plays some of a network's episodes of four views again and keeps its class distributions.

    Right ones of different classes whose first view misled come first, and a wrong one last; there are fewer
    than four if too few took four views.

    Args:
        network: which played.
        graph: the world.
        rules: the rules of training.
        rows: of its episodes.
        episodes: the list that was played, in the order of the rows.
        device: where the network is.
    """
    chosen = choose([row for row in rows if row.views == VIEWS], SHOWN, VIEWS)
    if not chosen:
        return []
    player = _Watched(network, name=rows[0].player)
    listed = np.array([episodes[next(i for i, row in enumerate(rows) if row is one)] for one in chosen])
    again = play(
        player, graph, rules, listed, world=rows[0].world, backend=rows[0].backend, device=device, batch=SHOWN
    )
    classes = np.stack([seen.float().cpu().numpy() for seen in player.seen], 1)  # (episodes, views, m)
    return [
        CertaintyStrip(filmstrip(graph, row), of[: row.views]) for row, of in zip(again, classes, strict=True)
    ]


class _Watched(Trained):
    """Keeps the class distributions of all episodes, (B, m), at every view."""

    def begin(self, batch: int) -> None:
        super().begin(batch)
        self.seen: list[Tensor] = []

    def look(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> ActionDistribution:
        policy = super().look(observation, mask, first)
        self.seen.append(policy.class_log_probs().exp())
        return policy
