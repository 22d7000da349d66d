"""The Active Vision Dataset's own baseline: move to the next best view until a class scores high enough.

Ammirato et al., ICRA 2017, section V: the agent has no action that answers. It moves until the recogniser's
score of the newest view reaches 0.9 or no moves are left, and the recogniser's answer at that view counts.
Their Table II shows the accuracy after 0, 3, 5, 10 and 20 moves, compared with random moves and with forward
only. Here the run's own network recognises and moves, with memory `stack` of one view, so that only the
newest view counts; theirs was a frozen ResNet-18 trained on other pictures.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from activelsd.evaluate.players import Trained

SURE = 0.9
"""Score of the likeliest class at which a player answers."""


class NextBestMove(Trained):
    """Makes the network's likeliest move until the network's score of a class is high enough."""

    name = "next_best_move"

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the likeliest class if it is sure or no move is legal, else a move."""
        policy = self.look(observation, mask, first)
        sure = policy.class_log_probs().amax(-1).exp() >= SURE
        return torch.where(
            sure | ~mask[:, self.moves].any(1), self.name_class(), self.move(observation, mask, first)
        )

    def move(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the next move, int64 (B,); illegal only if no move is legal."""
        return self.likeliest_move()
