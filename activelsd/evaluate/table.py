"""Prints a comparison as tables for a screen of 80 columns."""

from __future__ import annotations

import inspect
import io
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING

from activelsd import registry
from activelsd.evaluate.compare import Comparison, Difference, Standing
from activelsd.evaluate.frontier import CHOOSING, MEANS, Frontier
from activelsd.evaluate.metrics import Interval
from activelsd.evaluate.recognisers.rows import NO_MOVEMENT, PUBLISHED

if TYPE_CHECKING:
    from rich.console import Group, RenderableType
    from rich.table import Table

WIDTH = 80
VERSUS = "  vs "
HEADS = ("Accuracy, %", "Views seen", "Steps")


def render(comparison: Comparison, width: int = WIDTH) -> Group:
    """Returns Rich's renderable: each player, its difference from the reference, and notes on the figures.

    Values are never cut; names are shortened if `width` columns do not hold them.
    """
    from rich.console import Group
    from rich.text import Text

    lines = list(_lines(comparison))
    room = width - 3 - sum(max(len(cells[i]) for _, cells, _ in lines) + 1 for i in range(3))
    table = _table(
        ("Player", *HEADS), [([_short(name, room), *cells], style) for name, cells, style in lines]
    )
    more = (
        *_frontier(comparison, room),
        *_more(comparison, width, room),
        *_recognised(comparison, width),
    )
    return Group(table, *more, *(Text(line) for line in notes(comparison)))


def _table(heads: Sequence[str], lines: Iterable[tuple[Sequence[str], str]]) -> Table:
    """A table of lines with a style each."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for head in heads:
        table.add_column(Text(head), no_wrap=True)
    for cells, style in lines:
        table.add_row(*map(Text, cells), style=style)
    return table


def _frontier(comparison: Comparison, name_width: int) -> Iterator[RenderableType]:
    """Accuracy at equal mean views, a line per player and one for its differences."""
    from rich.text import Text

    of = comparison.frontier
    if of is None:
        return
    lines = []
    for one in of.curves:
        accuracy = [f"{100 * each.mean:.1f}" for each in (*one.accuracy, one.area)]
        lines.append(([_short(one.name, name_width), *accuracy], "" if one.difference else "bold"))
        if one.difference is not None and one.area_difference is not None:
            apart = [_marked(each) for each in (*one.difference, one.area_difference)]
            name = _short(VERSUS + comparison.reference.name, name_width)
            lines.append(([name, *apart], "dim"))
    yield Text("")
    yield _table(("At equal views", *(f"{mean:g}" for mean in of.means), "area"), lines)


def _marked(apart: Interval) -> str:
    """A difference in points, with a star if its interval leaves out 0."""
    star = "*" if apart.low > 0 or apart.high < 0 else ""
    return _rounded(100 * apart.mean, 1, "+") + star


def _more(comparison: Comparison, width: int, name_width: int) -> Iterator[RenderableType]:
    """Results by difficulty and registered figures, a line per player, in as many tables as they need."""
    from rich.text import Text

    reference, players = comparison.reference, comparison.players
    title = "By difficulty" if reference.difficulties else "Player"
    names = [_short(one.name, name_width) for one in players]
    room = width - max(map(len, [title, *names])) - 2
    columns = [
        [f"{group.name}, {group.episodes}"]
        + [f"{100 * g.right / g.episodes:.1f} / {g.views:.1f}" for g in (p.difficulties[i] for p in players)]
        for i, group in enumerate(reference.difficulties)
    ]
    columns += [
        [_short(name, room - 1), *(_figure(one.figures[name]) for one in players)]
        for name in reference.figures
    ]
    while columns:
        sizes = accumulate(max(map(len, column)) + 1 for column in columns)
        fitting = max(1, sum(size <= room for size in sizes))
        heads, *lines = zip([title, *names], *columns[:fitting], strict=True)
        yield Text("")
        yield _table(heads, [(line, "" if i else "bold") for i, line in enumerate(lines)])
        columns, title = columns[fitting:], "Player"


def _recognised(comparison: Comparison, width: int) -> Iterator[RenderableType]:
    """Results of recognisers, a line for each number of views."""
    from rich.text import Text

    if not comparison.recognised:
        return
    lines = []
    for one in comparison.recognised:
        views = str(one.views) if one.views else "-"
        accuracy = _cell(Interval(*(100 * x for x in one.accuracy)), 1, "")
        published = "" if one.published is None else f"{one.published:.1f}"
        effort = _large(one.parameters), _long(one.seconds)
        lines.append((one.name, one.given, views, *effort, accuracy, published))
    heads = ("Recogniser", "Given", "Views", "Params", "Trained", "Accuracy, %", "Published")
    columns = list(zip(heads, *lines, strict=True))[1:]
    room = width - sum(max(map(len, column)) + 2 for column in columns)
    yield Text("")
    yield _table(heads, [((_short(name, room), *cells), "") for name, *cells in lines])


def _large(number: int) -> str:
    return f"{number / 1e6:.2f} M" if number >= 1e6 else f"{number / 1e3:.0f} k"


def _long(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _figure(interval: Interval | None) -> str:
    """Two decimals, or four if they would show little of it; a dash if it is not known."""
    return "-" if interval is None else _cell(interval, 2 if max(map(abs, interval)) >= 0.1 else 4, "")


def text(comparison: Comparison, width: int = WIDTH) -> str:
    """Returns the same without colours or control codes."""
    from rich.console import Console

    out = io.StringIO()
    Console(file=out, width=width, color_system=None, force_terminal=False).print(render(comparison, width))
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def notes(comparison: Comparison) -> Iterator[str]:
    """Yields sentences on what was played and what the figures mean."""
    reference = comparison.reference
    starts = "every start" if comparison.per_object is None else f"{comparison.per_object} random starts"
    yield f"{reference.episodes} episodes: {comparison.objects} {comparison.split} objects, {starts} of each."
    places = {(one.world, one.backend) for one in comparison.players}
    for world, backend in sorted(places):
        yield f"World {world}, pictures by {backend}." if backend != world else f"World {world}."
    if left_out := comparison.graph.left_out:
        yield f"Left out as broken: {len(left_out)} objects of all splits, named in the JSON file."
    if comparison.changed:
        changes = (f"{key}={'null' if x is None else x}" for key, x in comparison.changed.items())
        yield f"Changed since training: {', '.join(changes)}."
    yield (
        "[ ] are 95 % intervals over objects; differences are paired. Steps: views seen, "
        f"a wrong answer counts {reference.max_views}."
    )
    if comparison.wanted_views is not None:
        views = f"{comparison.wanted_views:g} views"
        yield f"Thresholds of all stops were chosen on {CHOOSING} objects for {views}."
    if comparison.frontier is not None:
        yield from _about_frontier(comparison, comparison.frontier)
    if comparison.recognised:
        yield from _about_recognisers(comparison)
    if reference.difficulties:
        yield "By difficulty of the first view: number of episodes; accuracy, % / views seen."
    for name in reference.figures:
        if about := inspect.getdoc(registry.figures.get(name)):
            yield f"{name}: {about.splitlines()[0]}"
    if comparison.gain_closed is not None:
        mean, low, high = (100 * x for x in comparison.gain_closed)
        yield (
            f"{reference.name} goes {mean:.0f} % of the way from no_move's accuracy to all_views' "
            f"[{low:.0f}, {high:.0f}]."
        )


def _about_frontier(comparison: Comparison, of: Frontier) -> Iterator[str]:
    yield (
        f"At equal views: accuracy, % at these mean views, thresholds of the stops from {CHOOSING} objects;"
        " area: its mean over them; *: the interval of the difference leaves out 0."
    )
    if comparison.split == CHOOSING:
        yield "These are the objects that thresholds were chosen on, so all figures are too good."
    if of.means != MEANS:
        yield f"Means above {of.reached:.1f} are left out, which is all that {of.shortest} sees."
    left_out = {one.name for one in comparison.players} - {one.name for one in of.curves}
    if left_out:
        yield f"Without a stop to set: {', '.join(sorted(left_out))}."


def _about_recognisers(comparison: Comparison) -> Iterator[str]:
    sets = max(one.sets for one in comparison.recognised)
    yield (
        "Recognisers were trained on the training objects, with sets of one to all views. Fewer views than"
        f" all: {sets} random sets of each object."
    )
    yield f"Published: {PUBLISHED}; its network without moves {NO_MOVEMENT} %."


def _lines(comparison: Comparison) -> Iterator[tuple[str, tuple[str, str, str], str]]:
    """Yields the name, cells and style of every line."""
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
    """Returns for example `95.2 [93.1, 97.0]`; a value that rounds to 0 has no sign."""
    mean, low, high = (_rounded(x, digits, sign) for x in interval)
    return f"{mean} [{low}, {high}]"


def _rounded(x: float, digits: int, sign: str) -> str:
    part, zero = f"{x:{sign}.{digits}f}", f"{0:.{digits}f}"
    return zero if part.lstrip("+-") == zero else part


def _short(name: str, room: int) -> str:
    """Shortens a name to its end, which tells a run from others of the same day."""
    if name.startswith(VERSUS):
        return VERSUS + _short(name.removeprefix(VERSUS), room - len(VERSUS))
    return name if len(name) <= room else "…" + name[len(name) - max(room, 2) + 1 :]
