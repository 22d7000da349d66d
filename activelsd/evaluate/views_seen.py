"""Right and wrong answers by the number of views seen: Table 3 of the paper, as published and for any run."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence

from activelsd.evaluate.metrics import EpisodeGroup

Table = Mapping[str, Sequence[EpisodeGroup]]
"""For every name, episodes by views seen, 1 … T, as `metrics.by_views` groups them."""

VIEWS, LATER = 12, 8
"""T of the paper, and up to which view its accuracy rises."""

_RIGHT = {
    "LSD-Net": (118, 77, 84, 47, 37, 25, 19, 12, 6, 4, 7, 137),
    "LSD-Net (LSTM)": (171, 90, 99, 67, 59, 35, 25, 17, 12, 7, 8, 29),
}
_WRONG = {
    "LSD-Net": (76, 29, 25, 11, 10, 4, 2, 3, 3, 2, 2, 20),
    "LSD-Net (LSTM)": (83, 16, 11, 8, 5, 3, 3, 1, 2, 1, 2, 6),
}

PUBLISHED: Table = {
    f"{name}, published, ModelNet40 meshes": [
        EpisodeGroup(str(views), good + bad, good, float(views))
        for views, (good, bad) in enumerate(zip(right, _WRONG[name], strict=True), 1)
    ]
    for name, right in _RIGHT.items()
}
"""The paper's Table 3: 760 test objects."""


def with_published(table: Table) -> Table:
    """The table, and below it the paper's own if every player was allowed as many views as the paper's."""
    alike = all(len(groups) == VIEWS for groups in table.values())
    return {**table, **PUBLISHED} if alike else table


def sentence(groups: Sequence[EpisodeGroup]) -> str:
    """Says how often answers are right at the first view, after 2 to 8 views, and at the last view, T.

    In between it gives the lowest and the highest share of the numbers of views. Of the paper's LSTM: right
    at the first view 67 %, after 2-8 views 85-94 %, after 12 views 83 %.
    """
    first, *others = groups
    parts = [f"right at the first view {_range([first])}"]
    if len(others) > 1:
        between = others[: min(LATER, len(groups) - 1) - 1]
        upto = "" if between[-1].name == "2" else f"-{between[-1].name}"
        parts.append(f"after 2{upto} views {_range(between)}")
    if others:
        parts.append(f"after {others[-1].name} views {_range(others[-1:])}")
    return ", ".join(parts)


def _range(groups: Sequence[EpisodeGroup]) -> str:
    """The lowest and the highest share of right answers."""
    shares = [round(100 * one.right / one.episodes) for one in groups if one.episodes]
    if not shares:
        return "no episode"
    return f"{min(shares)} %" if min(shares) == max(shares) else f"{min(shares)}-{max(shares)} %"


def as_csv(table: Table) -> str:
    """Returns a line per name and number of views."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(["name", "views", "right", "wrong"])
    for name, groups in table.items():
        lines.writerows([name, one.name, one.right, one.episodes - one.right] for one in groups)
    return text.getvalue()


def as_text(table: Table) -> Iterator[str]:
    """Yields lines for a screen: for every name right and wrong answers by views, and the sentence."""
    for name, groups in table.items():
        # If T is larger than the paper's, numbers of views that no episode took are left out.
        columns = [
            (one.name, one.right, one.episodes - one.right)
            for one in groups
            if one.episodes or len(groups) <= VIEWS
        ]
        columns.append(("all", sum(one[1] for one in columns), sum(one[2] for one in columns)))
        width = max(len(str(cell)) for column in columns for cell in column) + 1
        yield name
        for head, cells in zip(("views", "right", "wrong"), zip(*columns, strict=True), strict=True):
            yield f"  {head}" + "".join(f"{cell:>{width}}" for cell in cells)
        yield f"  {sentence(groups)}"
