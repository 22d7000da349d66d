"""Chooses episodes worth showing and draws each as a filmstrip of its views, moves and answers."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.colour import channels_last
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.protocol import EpisodeRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

SHOWN = 6
LONGEST = 4
"""The most views that fit into a strip."""

RIGHT, WRONG, INK, FAINT, BOX = "#1a7f37", "#c62828", "#24292f", "#6e7781", "#d9730d"

# Fractions of the panel's width and height.
_MARGIN, _TOP, _WIDE, _HIGH = 0.03, 0.942, 0.80, 0.925


class Plan(NamedTuple):
    """The path of an episode seen from above."""

    points: NDArray[np.float32]  # (N, 2) metres, all places of the scene with recorded views
    path: NDArray[np.float32]  # (L, 3) metres and heading in degrees of each view seen


class Filmstrip(NamedTuple):
    """One episode as pictures."""

    row: EpisodeRow
    frames: list[NDArray[np.uint8]]  # (S, S) or (S, S, 3) for each view
    moves: list[str]  # name of the move after each view but the last, or "blocked"
    boxes: list[NDArray[np.float32]]  # (5,) of the target in each view; empty if it fills every frame
    crops: list[NDArray[np.uint8]]  # likewise, zeros if out of sight; empty if the world has none
    plan: Plan | None  # if the scene's views have poses


class Area(NamedTuple):
    """The area of a panel that a picture covers, as fractions of the panel."""

    x: float  # left
    y: float  # bottom
    width: float
    height: float


def choose(rows: Sequence[EpisodeRow], count: int = SHOWN, longest: int = LONGEST) -> list[EpisodeRow]:
    """Chooses episodes of different classes: right ones whose first view misled, and a wrong one last.

    The order of the rows does not matter. There are fewer than `count` if too few episodes fit into a strip.
    """
    fitting = sorted(
        (row for row in rows if row.views <= longest), key=lambda row: (row.scene, row.target, row.start)
    )
    right = [row for row in fitting if row.right]
    wrong = [row for row in fitting if not row.right]
    # If there are too few right ones, wrong ones fill the strips.
    ends = _varied(wrong, max(1, count - len(right)), longest)
    return _varied(right, count - len(ends), longest) + ends


def _varied(rows: Sequence[EpisodeRow], count: int, longest: int) -> list[EpisodeRow]:
    """Chooses rows such that classes repeat as late as possible and the lengths 2, 3, … take turns."""
    chosen: list[EpisodeRow] = []
    remaining = list(rows)
    while remaining and len(chosen) < count:
        shown = [row.label for row in chosen]
        length = 2 + len(chosen) % max(longest - 1, 1)
        best = min(
            remaining,
            key=lambda row: (
                shown.count(row.label),
                row.views == 1,
                row.answers[0] == row.answer,
                abs(row.views - length),
            ),
        )
        chosen.append(best)
        remaining.remove(best)
    return chosen


def filmstrip(graph: ViewGraph, row: EpisodeRow) -> Filmstrip:
    """Collects the pictures of an episode's views and the moves between them."""
    scene = graph.scenes.index(row.scene)
    views = {graph.view_names[view]: int(view) for view in np.flatnonzero(graph.scene_of == scene)}
    path = [views[name] for name in row.path]
    target = graph.targets.index(row.target)
    return Filmstrip(
        row=row,
        frames=[channels_last(graph.frames[view]) for view in path],
        moves=[_move(graph, view, to) for view, to in pairwise(path)],
        boxes=[] if graph.pair_of is None else [graph.target_box(view, target) for view in path],
        crops=[] if graph.crops is None else [channels_last(graph.crop(view, target)) for view in path],
        plan=_plan(graph, scene, path),
    )


def _plan(graph: ViewGraph, scene: int, path: Sequence[int]) -> Plan | None:
    if graph.poses is None or not np.isfinite(graph.poses[path]).all():
        return None
    places = graph.poses[graph.scene_of == scene][:, :2]
    return Plan(np.unique(places[np.isfinite(places).all(1)].round(2), axis=0), graph.poses[path, :3])


def _move(graph: ViewGraph, view: int, to: int) -> str:
    columns = np.flatnonzero(graph.moves[view] == to)
    return graph.move_names[columns[0]] if len(columns) else "blocked"


def draw_filmstrips(panel: SubFigure, strips: Sequence[Filmstrip], player: str) -> None:
    """Fills a panel: an episode per row, under each view the answer it would give, at the end its answer."""
    panel.text(
        _MARGIN, 0.967, f"Episodes of {player}", fontsize=14, fontweight="bold", color=INK, va="center"
    )
    hint = "under each view: the answer it would give there"
    panel.text(0.98, 0.967, hint, fontsize=10, color=FAINT, ha="right", va="center")
    if not strips:
        panel.text(0.5, 0.5, f"No episode is over within {LONGEST} views.", ha="center", color=FAINT)
        return
    inches = panel.bbox.width / panel.figure.dpi, panel.bbox.height / panel.figure.dpi
    columns = [len(strip.frames) + (strip.plan is not None) for strip in strips]
    across = min(_WIDE / max(columns), 0.25)
    down = _HIGH / max(len(strips), 4)
    side = min(across * 0.70 * inches[0], down * 0.76 * inches[1])
    for i, strip in enumerate(strips):
        area = Area(_MARGIN, _TOP - i * down - side / inches[1], side / inches[0], side / inches[1])
        _draw_strip(panel, strip, area, across)


def _draw_strip(panel: SubFigure, strip: Filmstrip, area: Area, across: float) -> None:
    """Draws views from left to right, a move's name between two, and the answer after the last."""
    row = strip.row
    middle = area.y + area.height / 2
    if strip.plan is not None:
        _draw_plan(panel.add_axes(area), strip.plan, RIGHT if row.right else WRONG)
        area = area._replace(x=area.x + across)
    begin = area.x
    for i, named in enumerate(row.answers):
        axes = panel.add_axes(area)
        draw_view(axes, strip, i)
        centre, colour = area.x + area.width / 2, RIGHT if named == row.label else WRONG
        panel.text(
            centre, area.y - 0.006, _lines(named, 16, 1), fontsize=10, ha="center", va="top", color=colour
        )
        area = area._replace(x=area.x + across)
    colour = RIGHT if row.right else WRONG
    axes.spines[:].set(color=colour, linewidth=2.5)
    for i, move in enumerate(strip.moves):
        centre = begin + (i + 0.5) * across + area.width / 2
        panel.text(centre, middle + 0.006, "→", fontsize=15, ha="center", va="center", color=INK)
        size = 9 if across > 0.18 else 7.5
        panel.text(centre, middle - 0.010, move_label(move), fontsize=size, ha="center", va="top", color=INK)
    x = area.x - across + area.width + 0.015
    answer = ("✓ " if row.right else "✗ ") + _lines(row.answer, 14, 2)
    panel.text(x, middle, answer, fontsize=12, fontweight="bold", color=colour, va="center")
    if not row.right:
        panel.text(x, middle - 0.024, f"is {_lines(row.label, 14, 2)}", fontsize=10.5, color=INK, va="top")


def draw_view(axes: Axes, strip: Filmstrip, i: int) -> None:
    """Draws a view of an episode, with the target's box and crop if it has them."""
    frame = strip.frames[i]
    axes.imshow(frame, cmap="gray", vmin=0, vmax=255)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(color=FAINT, linewidth=0.8)
    if strip.boxes:
        _draw_target(axes, strip.boxes[i], strip.crops[i] if strip.crops else None, len(frame))


def move_label(move: str) -> str:
    """A move's name in short, with a word per line."""
    shorter = move.removeprefix("orbit_").replace("backward", "back").replace("opposite", "180")
    return shorter.replace("_", "\n")


def _draw_target(axes: Axes, box: NDArray[np.float32], crop: NDArray[np.uint8] | None, side: int) -> None:
    """Draws the target's box in a frame, and its crop, as the network sees it, in the lower right corner."""
    from matplotlib.patches import Rectangle

    if not box[4]:
        return
    cx, cy, width, height = (side * float(x) for x in box[:4])
    corner = cx - width / 2 - 0.5, cy - height / 2 - 0.5
    axes.add_patch(Rectangle(corner, width, height, fill=False, edgecolor=BOX, linewidth=1.4))
    if crop is not None:
        inset = axes.inset_axes((0.64, 0.0, 0.36, 0.36))
        inset.imshow(crop, cmap="gray", vmin=0, vmax=255)
        inset.set(xticks=[], yticks=[])
        inset.spines[:].set(color=BOX, linewidth=1.2)


def _draw_plan(axes: Axes, plan: Plan, colour: str) -> None:
    """Draws recorded places as dots, the path as a line, and the camera's direction at each view."""
    axes.scatter(plan.points[:, 0], plan.points[:, 1], s=3, color="#c8cfd6")
    x, y, heading = plan.path.astype(np.float64).T
    axes.plot(x, y, color=INK, linewidth=1.2, zorder=2)
    aside, ahead = 0.45 * np.sin(np.radians(heading)), 0.45 * np.cos(np.radians(heading))
    colours = [INK] * (len(x) - 1) + [colour]
    axes.quiver(
        x, y, aside, ahead, color=colours, angles="xy", scale_units="xy", scale=1, width=0.014, zorder=3
    )
    axes.scatter(x[:1], y[:1], s=26, facecolor="white", edgecolor=INK, zorder=4)
    axes.scatter(x[-1:], y[-1:], s=22, color=colour, zorder=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _lines(name: str, width: int, most: int) -> str:
    """Wraps a class's name."""
    return "\n".join(textwrap.wrap(name.replace("_", " "), width, max_lines=most, placeholder="…"))
