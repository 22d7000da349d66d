"""The parts of an episode: its question, its rules, and the view that a look returns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.errors import ConfigError

WHOLE_FRAME = (0.5, 0.5, 1.0, 1.0, 1.0)
"""The target box (cx, cy, w, h, present) if the target fills the frame."""


class View(NamedTuple):
    """What the agent sees at one place."""

    frame: NDArray[np.uint8]  # (S, S) gray, or (3, S, S) red, green and blue
    target: NDArray[np.float32]  # (5,) box centre, width, height as fractions of the frame; present 0 or 1
    crop: NDArray[np.uint8] | None = None  # ([3,] S, S) the box cropped from the full-resolution image
    features: NDArray[np.float16] | None = None  # (W, F) of a frozen trunk, for W variants of the picture


@dataclass(frozen=True, kw_only=True)
class Episode:
    """The target and the start of an episode; `id` replays it exactly.

    `oracle_views` is the fewest views until one shows the target well, -1 if no such view can be reached, and
    None if unknown. `difficulty` is the annotated grade of the first view, None if there is none.
    """

    id: str
    scene: str
    target: str
    label: int
    start: str
    split: str
    oracle_views: int | None = None
    difficulty: str | None = None


@dataclass(frozen=True, kw_only=True)
class EpisodeRules:
    """A row of the paper's Table 1 as data: rewards, and what ends the episode.

    Attributes:
        move: reward for a move that succeeded.
        blocked: reward for a move that was blocked.
        right: reward for the right class.
        wrong: reward for a wrong class.
        ends_on_right: the right class terminates the episode.
        ends_on_wrong: a wrong class terminates the episode.
        can_move: if False, only answers are legal (the paper's 64.3 % baseline).
        try_again: a blocked move stays legal; otherwise it is illegal until the view changes.
        revisit: moves to views that the episode has shown stay legal; otherwise they are illegal as long as
            another move leads to a new one. For views that are known beforehand, as recorded ones are.
        max_views: T. The T-th action of an episode is its last and must be an answer: moves are not legal
            there.
    """

    move: float = 0.0
    blocked: float = 0.0
    right: float = 1.0
    wrong: float = 0.0
    ends_on_right: bool = True
    ends_on_wrong: bool = False
    can_move: bool = True
    try_again: bool = False
    revisit: bool = True
    max_views: int = 12

    def __post_init__(self) -> None:
        if self.max_views < 1:
            raise ConfigError(f"max_views must be at least 1, not {self.max_views}; set it to 1 or more.")

    def for_evaluation(self) -> EpisodeRules:
        """The same rules, but the first answer, right or wrong, ends the episode."""
        return replace(self, ends_on_right=True, ends_on_wrong=True)


PRESETS: dict[str, EpisodeRules] = {
    "V0": EpisodeRules(),
    "V1": EpisodeRules(ends_on_right=False),
    "V2": EpisodeRules(wrong=-1.0, ends_on_right=False),
    "V3": EpisodeRules(wrong=-1.0),
    "V4": EpisodeRules(ends_on_wrong=True),
    "V5": EpisodeRules(wrong=-1.0, ends_on_wrong=True),
    "V6": EpisodeRules(ends_on_wrong=True, can_move=False),
}
"""Table 1's variants, named as in the authors' code; V0 is the paper's best."""
