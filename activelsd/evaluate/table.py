"""A comparison as a table for a screen of 80 columns."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING

from activelsd.evaluate.compare import Comparison, Difference, Standing
from activelsd.evaluate.metrics import Interval

if TYPE_CHECKING:
    from rich.console import Group, RenderableType

WIDTH = 80
VERSUS = "  vs "
HEADS = ("Accuracy, %", "Views seen", "Steps")


def render(comparison: Comparison, width: int = WIDTH) -> Group:
    """Rich's renderable: a line a player, below it what it does differently, and what the figures mean.

    Figures are never cut; names give way where `width` columns do not hold all.
    """
    from rich import box
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    lines = list(_lines(comparison))
    room = width - 3 - sum(max(len(cells[i]) for _, cells, _ in lines) + 1 for i in range(3))
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for head in ("Player", *HEADS):
        table.add_column(head, no_wrap=True)
    for name, cells, style in lines:
        table.add_row(Text(_short(name, room)), *(Text(cell) for cell in cells), style=style)
    return Group(table, *_more(comparison), *(Text(line) for line in notes(comparison)))


def _more(comparison: Comparison) -> Iterator[RenderableType]:
    """A second table where first views are graded or the oracle's way is known: a line a player."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    reference = comparison.reference
    if not reference.difficulties and reference.spl is None:
        return
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("By difficulty" if reference.difficulties else "Player", no_wrap=True)
    for group in reference.difficulties:
        table.add_column(f"{group.name}, {group.episodes}", no_wrap=True)
    if reference.spl is not None:
        table.add_column("SPL", no_wrap=True)
    for one in comparison.players:
        cells = [
            f"{100 * group.right / group.episodes:.1f} / {group.views:.1f}" for group in one.difficulties
        ]
        cells += [] if one.spl is None else [f"{one.spl.mean:.2f}"]
        table.add_row(Text(one.name), *map(Text, cells), style="bold" if one is reference else "")
    yield Text("")
    yield table


def text(comparison: Comparison, width: int = WIDTH) -> str:
    """The same without colours or control codes."""
    from rich.console import Console

    out = io.StringIO()
    Console(file=out, width=width, color_system=None, force_terminal=False).print(render(comparison, width))
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def notes(comparison: Comparison) -> Iterator[str]:
    """What was played and what the figures mean, a sentence each."""
    reference = comparison.reference
    starts = "every start" if comparison.per_object is None else f"{comparison.per_object} random starts"
    yield f"{reference.episodes} episodes: {comparison.objects} {comparison.split} objects, {starts} of each."
    places = {(one.world, one.backend) for one in comparison.players}
    for world, backend in sorted(places):
        yield f"World {world}, pictures by {backend}." if backend != world else f"World {world}."
    yield (
        "[ ] are 95 % intervals over objects; differences are paired. Steps: views seen, "
        f"a wrong answer counts {reference.max_views}."
    )
    if reference.difficulties:
        yield "By difficulty of the first view: number of episodes; accuracy, % / views seen."
    if reference.spl is not None:
        yield "SPL: a right answer counts the oracle's views over those seen, at most 1; a wrong one 0."
    if comparison.gain_closed is not None:
        mean, low, high = (100 * x for x in comparison.gain_closed)
        yield (
            f"{reference.name} goes {mean:.0f} % of the way from no_move's accuracy to all_views' "
            f"[{low:.0f}, {high:.0f}]."
        )


def _lines(comparison: Comparison) -> Iterator[tuple[str, tuple[str, str, str], str]]:
    """Name, figures and style of every line."""
    paired = {one.name: one for one in comparison.paired}
    for one in comparison.players:
        yield one.name, _cells(one), "" if one.name in paired else "bold"
        if one.name in paired:
            yield VERSUS + comparison.reference.name, _cells(paired[one.name]), "dim"


def _cells(one: Standing | Difference) -> tuple[str, str, str]:
    sign = "+" if isinstance(one, Difference) else ""
    percent = Interval(*(100 * x for x in one.accuracy))
    return _cell(percent, 1, sign), _cell(one.views, 2, sign), _cell(one.steps, 2, sign)


def _cell(interval: Interval, digits: int, sign: str) -> str:
    """For example `95.2 [93.1, 97.0]`; a value that rounds to nothing has no sign."""
    parts = [f"{x:{sign}.{digits}f}" for x in interval]
    zero = f"{0:.{digits}f}"
    mean, low, high = (zero if part.lstrip("+-") == zero else part for part in parts)
    return f"{mean} [{low}, {high}]"


def _short(name: str, room: int) -> str:
    """The end of a name tells a run from others made the same day."""
    if name.startswith(VERSUS):
        return VERSUS + _short(name.removeprefix(VERSUS), room - len(VERSUS))
    return name if len(name) <= room else "…" + name[len(name) - max(room, 2) + 1 :]
