"""What an episode is made of: the question asked, the rules it is played by, and what one look gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

WHOLE_FRAME = (0.5, 0.5, 1.0, 1.0, 1.0)
"""The target box (cx, cy, w, h, present) of a world whose target fills the frame."""


class View(NamedTuple):
    """What one look gives."""

    frame: NDArray[np.uint8]  # (S, S) gray
    target: NDArray[np.float32]  # (5,) box centre, width, height as fractions of the frame; present 0 or 1
    crop: NDArray[np.uint8] | None = None  # (S, S) the box cut from the full-resolution picture


@dataclass(frozen=True, kw_only=True)
class Episode:
    """What is being asked, and from where; `id` replays it exactly.

    `oracle_views` is the fewest views until one shows the target well, -1 where none can be reached, and None
    where nobody knows. `difficulty` is of the first view, where somebody graded it.
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
        move: reward of an action that moved.
        blocked: reward of a move that was blocked.
        right: reward of the right class.
        wrong: reward of a wrong class.
        ends_on_right: the right class terminates the episode.
        ends_on_wrong: a wrong class terminates the episode.
        can_move: False leaves only classes legal (the paper's 64.3 % baseline).
        try_again: a move that was blocked stays legal; else it is not, until the view is another.
        max_views: T. The T-th action of an episode is its last and must be a class: moves are not legal
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
    max_views: int = 12

    def __post_init__(self) -> None:
        if self.max_views < 1:
            raise ValueError(f"max_views must be at least 1, not {self.max_views}")

    def for_evaluation(self) -> EpisodeRules:
        """The same rules with the protocol's end: the first class, right or wrong, ends the episode."""
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
"""Table 1's variants by the names the authors' code gives them; V0 is the paper's best."""


def as_rules(rules: str | Mapping[str, Any] | EpisodeRules) -> EpisodeRules:
    """Rules from a preset's name or from their fields by name, as JSON holds them; rules as they are."""
    if isinstance(rules, EpisodeRules):
        return rules
    return PRESETS[rules] if isinstance(rules, str) else EpisodeRules(**rules)
