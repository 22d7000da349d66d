"""Table II of the Active Vision Dataset's paper, with a run's network as recogniser and actor.

Plays next best move, random moves and forward only, each until the network's score of a class reaches 0.9,
and prints the accuracy at the view reached after at most 0, 3, 5, 10 and 20 moves. As in the paper it starts
where the recogniser is not sure, with targets that it names rightly in one view of a scan and wrongly in
another. The paper's rows stand beside published splits; they compare only under the same recogniser.

    activelsd train experiment=avd_next_best_move env.dataset.path=… env.dataset.split=1
    python benchmarks/next_best_move.py RUN [--scores FILE.csv]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from activelsd.build import build_backend, build_graph, build_rules
from activelsd.compose import load
from activelsd.config import AVDSettings
from activelsd.envs.avd.starts import starts_by_score, write_scores
from activelsd.errors import ConfigError
from activelsd.evaluate.nextbest import (
    MOVES_ALLOWED,
    SURE,
    ForwardOnly,
    NextBestMove,
    RandomMoves,
    recognise,
    table,
)
from activelsd.evaluate.protocol import episodes_of, play
from activelsd.policy.checkpoint import load_network
from activelsd.train.run import CONFIG, Run

PUBLISHED = {
    "1": ((0.30, 0.43, 0.45, 0.49, 0.51), (0.30, 0.26, 0.28, 0.28, 0.33), (0.30, 0.29, 0.29, 0.29, 0.29)),
    "2": ((0.25, 0.40, 0.46, 0.52, 0.53), (0.25, 0.24, 0.26, 0.29, 0.33), (0.25, 0.29, 0.30, 0.31, 0.31)),
    "3": ((0.42, 0.56, 0.62, 0.67, 0.73), (0.42, 0.38, 0.40, 0.42, 0.46), (0.42, 0.39, 0.39, 0.40, 0.40)),
}
"""The paper's accuracy per split: reinforcement learning, random, forward."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="folder of a trained run")
    parser.add_argument("--seed", type=int, default=0, help="of the random moves")
    parser.add_argument("--scores", type=Path, help="write the recogniser's scores, for env.starts.scores")
    options = parser.parse_args()

    run = Run(options.run)
    world = load(run.folder / CONFIG).env
    if not isinstance(world, AVDSettings):
        raise ConfigError(f"{run.folder} was trained in {world.name}; give a run of env=avd.")
    graph, network, backend = build_graph(world), load_network(run.checkpoint, "cpu"), build_backend(world)
    scores = recognise(network, graph)
    if options.scores is not None:
        write_scores(graph, scores, options.scores)
    unsure = starts_by_score(graph, scores, SURE)
    episodes = episodes_of(unsure, "test")
    rules = replace(build_rules(world.rules), max_views=max(MOVES_ALLOWED) + 1, try_again=True)
    rows = {
        player.name: play(player, unsure, rules, episodes, world=world.name, backend=backend)
        for player in (NextBestMove(network), RandomMoves(network, options.seed), ForwardOnly(network))
    }
    split = world.dataset.split
    print(f"{len(episodes)} episodes of {len(graph.starts('test'))} test starts; pictures by {backend}")
    print(table(rows, f"split {split}"), end="")
    for name, figures in zip(("RL", "random", "forward"), PUBLISHED.get(split, ()), strict=False):
        print(f"{'paper: ' + name:<16} " + " ".join(f"{x:4.2f}" for x in figures))


if __name__ == "__main__":
    main()
