"""Episodes as filmstrips: which are worth showing, and what was seen, done and thought in each."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.protocol import EpisodeRow

if TYPE_CHECKING:
    from matplotlib.figure import SubFigure

SHOWN = 6
LONGEST = 4
"""Views of an episode that fit a strip."""

RIGHT, WRONG, INK, FAINT = "#1a7f37", "#c62828", "#24292f", "#6e7781"

# Of the panel's width and height.
_MARGIN, _TOP, _WIDE, _HIGH = 0.03, 0.942, 0.80, 0.925


class Filmstrip(NamedTuple):
    """One episode as pictures."""

    row: EpisodeRow
    frames: list[NDArray[np.uint8]]  # per view (S, S)
    moves: list[str]  # name of the move between each view and the next, "blocked" where it led nowhere


class Place(NamedTuple):
    """Where a picture lies in a panel, as fractions of it."""

    x: float  # left
    y: float  # bottom
    width: float
    height: float


def choose(rows: Sequence[EpisodeRow], count: int = SHOWN, longest: int = LONGEST) -> list[EpisodeRow]:
    """Episodes of different classes that tell most: right ones whose first view misled, and a wrong one last.

    Always the same ones for the same rows, and fewer where there are not so many that fit a strip.
    """
    fitting = sorted(
        (row for row in rows if row.views <= longest), key=lambda row: (row.scene, row.target, row.start)
    )
    right = [row for row in fitting if row.right]
    wrong = [row for row in fitting if not row.right]
    # Where there are too few right ones, wrong ones fill the strips.
    ends = _varied(wrong, max(1, count - len(right)), longest)
    return _varied(right, count - len(ends), longest) + ends


def _varied(rows: Sequence[EpisodeRow], count: int, longest: int) -> list[EpisodeRow]:
    """The most telling rows, no class again before each has come, the lengths 2, 3, … in turn."""
    chosen: list[EpisodeRow] = []
    left = list(rows)
    while left and len(chosen) < count:
        shown = [row.label for row in chosen]
        length = 2 + len(chosen) % max(longest - 1, 1)
        best = min(
            left,
            key=lambda row: (
                shown.count(row.label),
                row.views == 1,
                row.answers[0] == row.answer,
                abs(row.views - length),
            ),
        )
        chosen.append(best)
        left.remove(best)
    return chosen


def filmstrip(graph: ViewGraph, row: EpisodeRow) -> Filmstrip:
    """The pictures of an episode's views, and the moves between them."""
    scene = graph.scenes.index(row.scene)
    views = {graph.view_names[view]: int(view) for view in np.flatnonzero(graph.scene_of == scene)}
    path = [views[name] for name in row.path]
    moves = [_move(graph, view, to) for view, to in pairwise(path)]
    return Filmstrip(row, [np.asarray(graph.frames[view]) for view in path], moves)


def _move(graph: ViewGraph, view: int, to: int) -> str:
    columns = np.flatnonzero(graph.moves[view] == to)
    return graph.move_names[columns[0]] if len(columns) else "blocked"


def draw_filmstrips(panel: SubFigure, strips: Sequence[Filmstrip], player: str) -> None:
    """Fill a panel: a row an episode, under each view the answer it would give, behind the last its own."""
    panel.text(
        _MARGIN, 0.967, f"Episodes of {player}", fontsize=14, fontweight="bold", color=INK, va="center"
    )
    hint = "under each view: the answer it would give there"
    panel.text(0.98, 0.967, hint, fontsize=10, color=FAINT, ha="right", va="center")
    if not strips:
        panel.text(0.5, 0.5, f"No episode is over within {LONGEST} views.", ha="center", color=FAINT)
        return
    inches = panel.bbox.width / panel.figure.dpi, panel.bbox.height / panel.figure.dpi
    across = min(_WIDE / max(len(strip.frames) for strip in strips), 0.25)
    down = _HIGH / max(len(strips), 4)
    side = min(across * 0.70 * inches[0], down * 0.76 * inches[1])
    for i, strip in enumerate(strips):
        place = Place(_MARGIN, _TOP - i * down - side / inches[1], side / inches[0], side / inches[1])
        _draw_strip(panel, strip, place, across)


def _draw_strip(panel: SubFigure, strip: Filmstrip, place: Place, across: float) -> None:
    """Views from left to right, a move's name between two, the answer behind the last."""
    row = strip.row
    middle = place.y + place.height / 2
    for frame, named in zip(strip.frames, row.answers, strict=True):
        axes = panel.add_axes(place)
        axes.imshow(frame, cmap="gray", vmin=0, vmax=255)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set(color=FAINT, linewidth=0.8)
        centre, colour = place.x + place.width / 2, RIGHT if named == row.label else WRONG
        panel.text(
            centre, place.y - 0.006, _lines(named, 16, 1), fontsize=10, ha="center", va="top", color=colour
        )
        place = place._replace(x=place.x + across)
    colour = RIGHT if row.right else WRONG
    axes.spines[:].set(color=colour, linewidth=2.5)
    for i, move in enumerate(strip.moves):
        centre = _MARGIN + (i + 0.5) * across + place.width / 2
        panel.text(centre, middle + 0.006, "→", fontsize=15, ha="center", va="center", color=INK)
        short = move.removeprefix("orbit_").replace("_", "\n")
        panel.text(centre, middle - 0.010, short, fontsize=9, ha="center", va="top", color=INK)
    x = place.x - across + place.width + 0.015
    answer = ("✓ " if row.right else "✗ ") + _lines(row.answer, 14, 2)
    panel.text(x, middle, answer, fontsize=12, fontweight="bold", color=colour, va="center")
    if not row.right:
        panel.text(x, middle - 0.024, f"is {_lines(row.label, 14, 2)}", fontsize=10.5, color=INK, va="top")


def _lines(name: str, width: int, most: int) -> str:
    """A class's name in short lines."""
    return "\n".join(textwrap.wrap(name.replace("_", " "), width, max_lines=most, placeholder="…"))
