"""Draws Table 3 and Figures 3 and 4 of the paper for runs, in colours that the colour-blind tell apart."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from activelsd.evaluate.certainty import CertaintyStrip
from activelsd.evaluate.filmstrips import FAINT, INK, draw_view, move_label
from activelsd.evaluate.fonts import choose_fonts, names_to_draw
from activelsd.evaluate.learning import WINDOW, Curve
from activelsd.evaluate.metrics import EpisodeGroup
from activelsd.evaluate.views_seen import VIEWS, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RIGHT, WRONG, OTHER = "#0072B2", "#E69F00", "#9AA4AE"
LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's colours."""

TOP = 3
"""Classes shown under a view."""


def draw_views_seen(table: Table) -> bytes:
    """Returns Table 3 as PNG: for every name a stacked bar per number of views, with counts and shares."""
    names = _drawable(list(table), "run")

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(table), 1, squeeze=False, sharey=True).flat
        for axes, (name, groups) in zip(panels, table.items(), strict=True):
            _draw_bars(axes, names[name], groups)

    return _png(draw, (9.0, 2.9 * len(table)), [*names.values()])


def _draw_bars(axes: Axes, name: str, groups: Sequence[EpisodeGroup]) -> None:
    """Draws shares of all episodes; below each bar its counts, above it the share that is right."""
    episodes, right = (np.array(counts) for counts in zip(*(one[1:3] for one in groups), strict=True))
    views, wrong, percent = range(1, len(groups) + 1), episodes - right, 100 / episodes.sum()
    axes.bar(views, percent * right, color=RIGHT, width=0.75, label=f"right: {right.sum():,}")
    axes.bar(
        views,
        percent * wrong,
        bottom=percent * right,
        color=WRONG,
        width=0.75,
        label=f"wrong: {wrong.sum():,}",
        hatch="///",
        edgecolor="white",
        linewidth=0,
    )
    axes.set_title(_end(name, 48), loc="left", fontsize=11.5, fontweight="bold", color=INK)
    axes.set_ylabel("episodes, %", fontsize=10)
    if len(groups) <= 2 * VIEWS:
        for n, all_of, good in zip(views, episodes.tolist(), right.tolist(), strict=True):
            if all_of:
                share, top = f"{100 * good / all_of:.0f} %", percent * all_of
                axes.text(n, top, share, fontsize=8.5, color=INK, ha="center", va="bottom")
        heads = ["views\nright\nwrong"]
        heads += [f"{n}\n{good}\n{bad}" for n, good, bad in zip(views, right, wrong, strict=True)]
        axes.set_xticks([0, *views], heads, fontsize=8.5 if len(groups) <= VIEWS else 6.5, linespacing=1.35)
        axes.set_xlim(-0.3, len(groups) + 0.6)
        axes.tick_params(axis="x", length=0)
    else:
        axes.set_xlabel("views seen when it answered", fontsize=10)
    axes.margins(y=0.14)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, fontsize=10, frameon=False)
    _plain(axes)


def draw_learning(curves: Mapping[str, Curve]) -> bytes:
    """Returns Figure 3 as PNG: the moving averages of reward and of -log max pi of runs, by episodes."""
    names = _drawable(list(curves), "run")

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for i, (name, curve) in enumerate(curves.items()):
            style = {"color": LINES[i % len(LINES)], "linewidth": 1.6}
            style |= {"linestyle": ("-", "--", ":")[i // len(LINES) % 3]}
            left.plot(curve.episodes / 1000, curve.reward, **style, label=_end(names[name], 60))
            right.plot(curve.episodes / 1000, curve.entropy, **style)
        left.set_title("Reward of an episode", loc="left", fontsize=12, fontweight="bold", color=INK)
        right.set_title(
            "-log max π (policy entropy loss)", loc="left", fontsize=12, fontweight="bold", color=INK
        )
        for axes in (left, right):
            axes.set_xlabel(f"episodes, thousands (mean of the last {WINDOW:,} or more)", fontsize=10)
            axes.set_xlim(left=0)
            _plain(axes)
        right.set_ylim(bottom=0)
        if len(curves) > 1:
            figure.legend(loc="outside lower center", ncols=2, fontsize=10, frameon=False)

    return _png(
        draw, (12.0, 4.4 + (0.24 * (1 + len(curves) // 2) if len(curves) > 1 else 0)), [*names.values()]
    )


def draw_certainty(strips: Sequence[CertaintyStrip], classes: Sequence[str]) -> bytes:
    """Returns Figure 4 as PNG: an episode per row, under each view the likeliest classes.

    Args:
        strips: episodes.
        classes: their names, in the order of the distributions.
    """
    names = _drawable(list(classes), "class")

    def draw(figure: Figure) -> None:
        columns = max(len(one.classes) for one in strips)
        grid = figure.add_gridspec(
            3 * len(strips),
            columns,
            height_ratios=[1.0, 0.42, 0.16] * len(strips),
            hspace=0.0,
            wspace=0.32,
            left=0.02,
            right=0.98,
            top=1 - 0.55 / figure.get_figheight(),
            bottom=0.0,
        )
        title = "Episodes of four views, and the likeliest classes at each; blue: the right one"
        figure.text(
            0.02, 1 - 0.2 / figure.get_figheight(), title, fontsize=12, fontweight="bold", va="center"
        )
        for i, one in enumerate(strips):
            for j in range(len(one.classes)):
                axes = figure.add_subplot(grid[3 * i, j])
                draw_view(axes, one.strip, j)
                _name(axes, one, j, names)
                _draw_classes(figure.add_subplot(grid[3 * i + 1, j]), one, j, names, classes)

    return _png(draw, (10.5, 0.55 + 3.45 * len(strips)), [*names.values()], layout=None)


def _name(axes: Axes, one: CertaintyStrip, view: int, names: Mapping[str, str]) -> None:
    """Writes the label before the first view, and after each view the move or, at last, the answer."""
    row = one.strip.row
    if view == 0:
        axes.set_title(_short(names[row.label], 24), loc="left", fontsize=11, color=INK, pad=4)
    if view < len(one.strip.moves):
        label = f"{move_label(one.strip.moves[view])}\n→"
        axes.text(1.16, 0.5, label, transform=axes.transAxes, fontsize=9, ha="center", va="center", color=INK)
    else:
        said = f"{'✓' if row.right else '✗'} {_short(names[row.answer], 22)}"
        axes.set_title(said, loc="right", fontsize=11, color=RIGHT if row.right else "#B45F00", pad=4)
        axes.spines[:].set(color=RIGHT if row.right else WRONG, linewidth=2.5)


def _draw_classes(
    axes: Axes, one: CertaintyStrip, view: int, names: Mapping[str, str], classes: Sequence[str]
) -> None:
    """Draws the likeliest classes as bars, with names and percentages; the label's bar has its own colour."""
    likely = np.argsort(-one.classes[view], kind="stable")[:TOP]
    shares = one.classes[view][likely]
    label = one.strip.row.label
    colours = [RIGHT if classes[i] == label else OTHER for i in likely]
    places = np.arange(len(likely))
    axes.barh(places + 0.3, shares, height=0.26, color=colours)
    for place, i, share in zip(places, likely, shares, strict=True):
        weight = "bold" if classes[i] == label else "normal"
        axes.text(
            0, place - 0.02, _short(names[classes[i]], 20), fontsize=8.5, fontweight=weight, va="center"
        )
        axes.text(
            1, place - 0.02, f"{100 * share:.0f} %", fontsize=8.5, fontweight=weight, ha="right", va="center"
        )
    axes.set(xlim=(0, 1), ylim=(TOP - 0.2, -0.45))
    axes.set_axis_off()


def _short(name: str, room: int) -> str:
    name = name.replace("_", " ")
    return name if len(name) <= room else name[: room - 1] + "…"


def _end(name: str, room: int) -> str:
    """The end of a run's name, which tells it from others of the same day."""
    return name if len(name) <= room else "…" + name[1 - room :]


def _drawable(names: Sequence[str], kind: str) -> dict[str, str]:
    """Names as the fonts here can show them."""
    return names_to_draw(names, choose_fonts(names)[1], kind)


def _png(
    draw: Callable[[Figure], None],
    inches: tuple[float, float],
    names: Sequence[str],
    layout: Literal["constrained"] | None = "constrained",
) -> bytes:
    """Makes a figure of a size, has it drawn in fonts that have the letters of all names, and saves it."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.family": choose_fonts(names)[0], "text.parse_math": False}):
        figure = Figure(figsize=inches, dpi=110, facecolor="white")
        FigureCanvasAgg(figure)
        if layout is not None:
            figure.set_layout_engine(layout, w_pad=0.1, h_pad=0.1)
        draw(figure)
        out = io.BytesIO()
        figure.savefig(out, format="png")
    return out.getvalue()


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#d0d7de", linewidth=0.6)
    axes.tick_params(colors=INK)
    axes.xaxis.label.set_color(FAINT)
    axes.set_axisbelow(True)
