"""The Active Vision Dataset's own baseline: move to the next best view until a class scores high enough.

Ammirato et al., ICRA 2017, section V: the agent has no action that answers. It moves until the recogniser's
score of the newest view reaches 0.9 or no moves are left, and the recogniser's answer at that view counts.
Their Table II shows the accuracy after 0, 3, 5, 10 and 20 moves, compared with random moves and with forward
only. Here the run's own network recognises and moves, with memory `stack` of one view, so that only the
newest view counts; theirs was a frozen ResNet-18 trained on other pictures.
"""

from __future__ import annotations

from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.players import Trained
from activelsd.evaluate.stops import Confidence
from activelsd.policy.lsdnet import LSDNet


class NextBestMove(Trained):
    """Makes the network's likeliest move until the network's score of a class is high enough."""

    name = "next_best_move"
    takes_stops = False

    def __init__(self, network: LSDNet, graph: ViewGraph | None = None, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        self.stop = Confidence(network)
