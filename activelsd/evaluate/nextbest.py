"""The Active Vision Dataset's own baseline: move to the next best view until a class scores high enough.

Ammirato et al., ICRA 2017, section V: the agent has no answer to give. It moves until a recogniser's score of
the newest view reaches 0.9 or its moves are used up, and what counts is the recogniser's answer there. Their
Table II holds its accuracy after 0, 3, 5, 10 and 20 moves beside random moves and forward only. Here the
run's own network is recogniser and actor, with memory `stack` of one view, so that no view but the newest
counts; theirs was a frozen ResNet-18 trained on other pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from activelsd.envs.actions import NAVIGATE
from activelsd.envs.avd.starts import BoxScores
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.metrics import by_allowed
from activelsd.evaluate.players import Draws, Trained
from activelsd.evaluate.protocol import EpisodeRow
from activelsd.evaluate.walkers import move_of
from activelsd.policy.lsdnet import LSDNet

SURE = 0.9
MOVES_ALLOWED = (0, 3, 5, 10, 20)
"""Columns of Table II."""

_BATCH = 512


class NextBestMove(Trained):
    """Makes the network's likeliest move until the network's score of a class is high enough."""

    def __init__(self, network: LSDNet, name: str = "next_best_move", sure: float = SURE) -> None:
        super().__init__(network, name)
        self._sure, self._moves = sure, network.tree.span(NAVIGATE)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """The likeliest class where it is sure or no move is legal, else a move."""
        policy = self.look(observation, mask, first)
        sure = policy.class_log_probs().amax(-1).exp() >= self._sure
        return torch.where(
            sure | ~mask[:, self._moves].any(1), self.name_class(), self.move(observation, mask, first)
        )

    def move(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """(B,) int64 the next move, where one is legal."""
        return self.likeliest_move()


class RandomMoves(NextBestMove):
    """The same with moves drawn uniformly."""

    def __init__(self, network: LSDNet, seed: int, sure: float = SURE) -> None:
        super().__init__(network, "random", sure)
        self._draws = Draws(seed)

    def begin(self, batch: int) -> None:
        """Clear the memory, and draw as at first."""
        super().begin(batch)
        self._draws.begin(batch)

    def move(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Any legal move."""
        self._draws.look(first)
        return self._draws.choose(mask[:, self._moves], 0, 1) + int(self._moves.start)


class ForwardOnly(NextBestMove):
    """The same straight on; blocked, it stays and pays, which takes rules with `try_again`."""

    def __init__(self, network: LSDNet, sure: float = SURE) -> None:
        super().__init__(network, "forward", sure)
        self._forward = move_of(network, "forward", self.name)

    def move(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Forward."""
        return torch.full_like(first, self._forward, dtype=torch.int64)


@torch.inference_mode()
def recognise(
    network: LSDNet,
    graph: ViewGraph,
    *,
    device: str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> BoxScores:
    """Look once at every pair of a view and a target in it, as an episode that starts there would."""
    assert graph.pair_of is not None
    assert graph.boxes is not None
    view, target = np.nonzero(graph.pair_of >= 0)
    pair = graph.pair_of[view, target]
    score, right = np.zeros(len(graph.boxes), np.float32), np.zeros(len(graph.boxes), np.bool_)
    for begin in range(0, len(view), _BATCH):
        some = slice(begin, begin + _BATCH)
        pictures = {"frames": graph.frames[view[some]]}
        if network.shape.crops and graph.crops is not None:
            pictures["crops"] = graph.crops[pair[some]]
        frames = network.shape.frames
        looks = {name: torch.from_numpy(x[:, None].repeat(frames, 1)) for name, x in pictures.items()}
        boxes = np.concatenate([graph.boxes[pair[some]], np.ones((len(pair[some]), 1), np.float32)], 1)
        looks["target"] = torch.from_numpy(boxes[:, None].repeat(frames, 1))
        n = len(boxes)
        output = network(
            {name: x[None].to(device) for name, x in looks.items()},
            network.initial_state(n),
            torch.ones(1, n, dtype=torch.bool, device=device),
        )
        legal = torch.ones(n, network.tree.n, dtype=torch.bool, device=device)
        best = network.distribution(output.logits[0], legal).class_log_probs().max(-1)
        score[pair[some]] = best.values.exp().cpu().numpy()
        right[pair[some]] = best.indices.cpu().numpy() == graph.labels[target[some]]
        if progress is not None:
            progress(min(begin + _BATCH, len(view)), len(view))
    return BoxScores(score, right)


def after_moves(rows: Sequence[EpisodeRow], moves: Sequence[int] = MOVES_ALLOWED) -> list[float]:
    """Accuracy at the last view reached after so many moves at most, blocked ones included."""
    allowed = by_allowed(rows, max(moves) + 1)
    return [allowed[count].right / allowed[count].episodes for count in moves]


def table(rows: Mapping[str, Sequence[EpisodeRow]], column: str) -> str:
    """Players' rows in the shape of Table II, for one split."""
    head = " ".join(f"{count:>4}" for count in MOVES_ALLOWED)
    lines = [f"{'':<16} {column}", f"{'moves':<16} {head}"]
    for name, some in rows.items():
        lines.append(f"{name:<16} " + " ".join(f"{x:4.2f}" for x in after_moves(some)))
    return "\n".join(lines) + "\n"
