"""Table II of the Active Vision Dataset's paper, with a run's network as recogniser and as actor.

Plays next best move, random moves and forward only, each until the network's score for a class reaches 0.9,
and prints the accuracy at the view reached after at most 0, 3, 5, 10 and 20 moves. As in the paper, episodes
start where the recogniser is unsure, with targets that it recognises in some views of a scan and not in
others. For the published splits the paper's rows are printed too; they are comparable only with the same
recogniser.

    activelsd train experiment=avd_next_best_move env.dataset.path=… env.dataset.split=1
    python benchmarks/next_best_move.py RUN [--scores FILE.csv]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from activelsd.compose import load
from activelsd.envs.avd.settings import AVDSettings
from activelsd.envs.avd.starts import BoxScores, starts_by_score, write_scores
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.metrics import by_allowed
from activelsd.evaluate.nextbest import NextBestMove
from activelsd.evaluate.protocol import EpisodeRow, episodes_of, play
from activelsd.evaluate.stops import SURE
from activelsd.evaluate.walkers import move_of
from activelsd.policy.checkpoint import load_network
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.run import CONFIG, Run

PUBLISHED = {
    "1": ((0.30, 0.43, 0.45, 0.49, 0.51), (0.30, 0.26, 0.28, 0.28, 0.33), (0.30, 0.29, 0.29, 0.29, 0.29)),
    "2": ((0.25, 0.40, 0.46, 0.52, 0.53), (0.25, 0.24, 0.26, 0.29, 0.33), (0.25, 0.29, 0.30, 0.31, 0.31)),
    "3": ((0.42, 0.56, 0.62, 0.67, 0.73), (0.42, 0.38, 0.40, 0.42, 0.46), (0.42, 0.39, 0.39, 0.40, 0.40)),
}
"""The paper's accuracy per split: reinforcement learning, random, forward."""


MOVES_ALLOWED = (0, 3, 5, 10, 20)
"""Columns of Table II."""

_BATCH = 512


class RandomMoves(NextBestMove):
    """`NextBestMove` with moves drawn uniformly from the legal ones."""

    name = "random"

    def move(self, mask: Tensor) -> Tensor:
        """Returns any legal move."""
        return self.random_move(mask)


class ForwardOnly(NextBestMove):
    """`NextBestMove` that only goes forward, also where that is blocked, so the rules need `try_again`."""

    name = "forward"

    def __init__(self, network: LSDNet, graph: ViewGraph | None = None, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        self._forward = move_of(network, "forward", self.name)

    def move(self, mask: Tensor) -> Tensor:
        """Returns forward."""
        return torch.full((len(mask),), self._forward, device=mask.device)


@torch.inference_mode()
def recognise(
    network: LSDNet,
    graph: ViewGraph,
) -> BoxScores:
    """Scores every box by one look at its view, as an episode that starts there would."""
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
        looks = {
            name: torch.from_numpy(x[:, None].repeat(frames, 1)).flatten(1, -3)
            for name, x in pictures.items()
        }
        boxes = np.concatenate([graph.boxes[pair[some]], np.ones((len(pair[some]), 1), np.float32)], 1)
        looks["target"] = torch.from_numpy(boxes[:, None].repeat(frames, 1))
        n = len(boxes)
        output = network(
            {name: x[None] for name, x in looks.items()},
            network.initial_state(n),
            torch.ones(1, n, dtype=torch.bool),
        )
        legal = torch.ones(n, network.tree.n, dtype=torch.bool)
        best = network.distribution(output.logits[0], legal).class_log_probs().max(-1)
        score[pair[some]] = best.values.exp().cpu().numpy()
        right[pair[some]] = best.indices.cpu().numpy() == graph.labels[target[some]]
    return BoxScores(score, right)


def after_moves(rows: Sequence[EpisodeRow], moves: Sequence[int] = MOVES_ALLOWED) -> list[float]:
    """Returns the accuracy after at most each of these numbers of moves, blocked ones included."""
    allowed = by_allowed(rows, max(moves) + 1)
    return [allowed[count].right / allowed[count].episodes for count in moves]


def table(rows: Mapping[str, Sequence[EpisodeRow]], column: str) -> str:
    """Returns Table II as text, from the rows of every player by name; `column` is its heading."""
    head = " ".join(f"{count:>4}" for count in MOVES_ALLOWED)
    lines = [f"{'':<16} {column}", f"{'moves':<16} {head}"]
    for name, some in rows.items():
        lines.append(f"{name:<16} " + " ".join(f"{x:4.2f}" for x in after_moves(some)))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="folder of a trained run")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random moves")
    parser.add_argument("--scores", type=Path, help="file to write scores to, for env.starts.scores")
    options = parser.parse_args()

    run = Run(options.run)
    world = load(run.folder / CONFIG).env
    if not isinstance(world, AVDSettings):
        raise ConfigError(f"{run.folder} was trained in {world.name}; give a run with env=avd.")
    graph, network, backend = world.open(), load_network(run.checkpoint, "cpu"), world.made_by()
    scores = recognise(network, graph)
    if options.scores is not None:
        write_scores(graph, scores, options.scores)
    unsure = starts_by_score(graph, scores, SURE)
    episodes = episodes_of(unsure, "test")
    rules = replace(world.rules.rules(), max_views=max(MOVES_ALLOWED) + 1, try_again=True)
    rows = {
        player.name: play(player, unsure, rules, episodes, world=world.name, backend=backend)
        for player in (NextBestMove(network), RandomMoves(network, seed=options.seed), ForwardOnly(network))
    }
    split = world.dataset.split
    print(f"{len(episodes)} episodes of {len(graph.starts('test'))} test starts; pictures by {backend}")
    print(table(rows, f"split {split}"), end="")
    for name, figures in zip(("RL", "random", "forward"), PUBLISHED.get(split, ()), strict=False):
        print(f"{'paper: ' + name:<16} " + " ".join(f"{x:4.2f}" for x in figures))


if __name__ == "__main__":
    main()
