"""Draws a comparison: filmstrips of episodes, accuracy against views, and answers by views seen."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from activelsd.evaluate.compare import Comparison, Standing
from activelsd.evaluate.filmstrips import FAINT, INK, RIGHT, WRONG, choose, draw_filmstrips, filmstrip
from activelsd.evaluate.fonts import choose_fonts, names_to_draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INCHES, DPI = (16.0, 10.0), 100
REFERENCE = "#0550ae"
COLOURS = {
    "random_walk": "#d9730d",
    "no_move": "#6e40c9",
    "all_views": "#1b8a8f",
    "random_policy": "#8c959f",
}
OTHERS = ("#b0307a", "#7a5c00", "#3d6b21", "#4b4b9b")


def draw(comparison: Comparison) -> bytes:
    """Returns the picture as PNG, 1600 x 1000; names that no installed font can show are numbered."""
    from matplotlib import rc_context

    players = [one.name for one in comparison.players]
    answers = (
        name for row in comparison.rows[comparison.reference.name] for name in (row.label, *row.answers)
    )
    classes = list(dict.fromkeys([*comparison.graph.classes, *answers]))
    families, missing = choose_fonts([*classes, *players])
    named = _renamed(
        comparison,
        names_to_draw(classes, missing, "class"),
        names_to_draw(players, missing, "player"),
    )
    with rc_context({"font.family": families, "text.parse_math": False}):
        return _draw(named)


def _renamed(comparison: Comparison, classes: Mapping[str, str], players: Mapping[str, str]) -> Comparison:
    """Returns the comparison with other names, as far as the picture needs it."""
    reference = comparison.reference.name
    rows = [
        replace(
            row,
            label=classes[row.label],
            answer=classes[row.answer],
            answers=tuple(classes[name] for name in row.answers),
        )
        for row in comparison.rows[reference]
    ]
    frontier = comparison.frontier and replace(
        comparison.frontier,
        curves=[replace(one, name=players[one.name]) for one in comparison.frontier.curves],
    )
    return replace(
        comparison,
        frontier=frontier,
        players=[replace(one, name=players[one.name]) for one in comparison.players],
        rows={players[reference]: rows},
    )


def _draw(comparison: Comparison) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=INCHES, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(1, 2, width_ratios=[1.12, 1])
    left, right = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    reference = comparison.reference
    strips = [filmstrip(comparison.graph, row) for row in choose(comparison.rows[reference.name])]
    draw_filmstrips(left, strips, reference.name)
    over, under = right.subplots(2, 1, height_ratios=[1.75, 1.0])
    right.subplots_adjust(left=0.11, right=0.97, top=0.93, bottom=0.105, hspace=0.34)
    _draw_accuracy(over, comparison)
    _draw_ends(under, reference)
    about = _about(comparison)
    figure.text(0.985, 0.012, about, ha="right", va="bottom", fontsize=10, color=FAINT)
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Title": "activelsd comparison", "Description": about})
    return out.getvalue()


def _about(comparison: Comparison) -> str:
    one = comparison.reference
    backend = "" if one.backend == one.world else f", pictures by {one.backend}"
    return (
        f"world {one.world}{backend} · {one.episodes} episodes of {comparison.objects} {comparison.split} "
        "objects · bars are 95 % intervals over objects"
    )


def _draw_accuracy(axes: Axes, comparison: Comparison) -> None:
    """Draws every player's result with intervals, and its frontier, or its accuracy with fewer views."""
    curves = {one.name: one.accuracy for one in comparison.frontier.curves} if comparison.frontier else {}
    for i, one in enumerate(comparison.players):
        colour = REFERENCE if i == 0 else COLOURS.get(one.name, OTHERS[i % len(OTHERS)])
        line = np.array([[group.views, 100 * group.right / group.episodes] for group in one.allowed])
        if comparison.frontier:
            reached = zip(comparison.frontier.means, curves.get(one.name, ()), strict=False)
            line = np.array([[mean, 100 * at.mean] for mean, at in reached]).reshape(-1, 2)
        if len(line) and line[-1, 0] > 1.0:
            axes.plot(*line.T, color=colour, linewidth=1.6, alpha=0.75, marker=".", markersize=6)
        x, y = one.views, one.accuracy
        axes.errorbar(
            x.mean,
            100 * y.mean,
            xerr=[[x.mean - x.low], [x.high - x.mean]],
            yerr=[[100 * (y.mean - y.low)], [100 * (y.high - y.mean)]],
            fmt="*" if i == 0 else "o",
            markersize=17 if i == 0 else 9,
            markeredgecolor="white",
            color=colour,
            elinewidth=1.6,
            capsize=3,
            zorder=5 if i == 0 else 4,
            label=f"{one.name}   {100 * y.mean:.1f} %, {x.mean:.2f} views",
        )
    axes.set_title("Accuracy against views", loc="left", fontsize=14, fontweight="bold", color=INK)
    dots = "thresholds for equal means" if comparison.frontier else "with 1, 2, 3 … views allowed"
    axes.set_xlabel(f"mean views seen (dots: {dots})", fontsize=11)
    axes.set_ylabel("accuracy, %", fontsize=11)
    axes.legend(loc="best", fontsize=11, framealpha=0.95)
    axes.set_xlim(left=0.7)
    _plain(axes)


def _draw_ends(axes: Axes, one: Standing) -> None:
    """Draws right and wrong episodes by views seen (the paper's Table 3)."""
    views = [int(group.name) for group in one.seen]
    right = np.array([group.right for group in one.seen])
    wrong = np.array([group.episodes - group.right for group in one.seen])
    axes.bar(views, right, color=RIGHT, alpha=0.8, label="right")
    axes.bar(views, wrong, bottom=right, color=WRONG, alpha=0.85, label="wrong")
    for n, good, bad in zip(views, right.tolist(), wrong.tolist(), strict=True):
        if good + bad and len(views) <= 24:
            share = f"{100 * good / (good + bad):.0f} %"
            axes.text(n, good + bad, share, fontsize=9.5, color=INK, ha="center", va="bottom")
    title = f"Answers of {one.name} by views seen"
    axes.set_title(title, loc="left", fontsize=14, fontweight="bold", color=INK)
    axes.set_xlabel("views seen when it answered (above: share that is right)", fontsize=11)
    axes.set_ylabel("episodes", fontsize=11)
    if len(views) <= 24:
        axes.set_xticks(views)
    axes.margins(y=0.12)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=11, frameon=False)
    _plain(axes)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#d0d7de", linewidth=0.6)
    axes.set_axisbelow(True)
