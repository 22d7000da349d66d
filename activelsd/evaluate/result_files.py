"""Writes a comparison as JSON, CSV, one row per episode, and a picture; never half of a file."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from activelsd.evaluate.compare import Comparison, Difference, Standing
from activelsd.evaluate.frontier import CHOOSING, Frontier
from activelsd.evaluate.metrics import CONFIDENCE, EpisodeGroup, Interval
from activelsd.evaluate.recognisers.rows import PUBLISHED, Recognition

FORMAT = "activelsd.comparison/1"
MEASURES = ("accuracy", "views", "steps")


def write(comparison: Comparison, folder: Path, stem: str = "comparison") -> list[Path]:
    """Writes `<stem>.json`, `<stem>.csv`, `<stem>.png` and the episodes into a folder; returns their paths.

    Args:
        comparison: what to write.
        folder: made if it is missing.
        stem: of the files' names; the episodes of the stem `comparison` go to `episodes.jsonl`, those of any
            other to `<stem>_episodes.jsonl`.
    """
    from activelsd.evaluate.picture import draw  # matplotlib takes a while to import

    episodes = "episodes.jsonl" if stem == "comparison" else f"{stem}_episodes.jsonl"
    contents = {
        f"{stem}.json": (json.dumps(as_json(comparison), indent=1) + "\n").encode(),
        f"{stem}.csv": as_csv(comparison).encode(),
        episodes: as_lines(comparison).encode(),
        f"{stem}.png": draw(comparison),
    }
    return write_files(contents, folder)


def write_files(contents: Mapping[str, bytes], folder: Path) -> list[Path]:
    """Writes files by name into a folder, which is made if it is missing; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    return [_replace(folder / name, content) for name, content in contents.items()]


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Returns all figures as plain values."""
    closed = comparison.gain_closed
    return {
        "format": FORMAT,
        "world": comparison.reference.world,
        "backend": comparison.reference.backend,
        "split": comparison.split,
        "episodes": comparison.reference.episodes,
        "objects": comparison.objects,
        "left_out": list(comparison.graph.left_out or ()),
        "episodes_per_object": comparison.per_object,
        "seed": comparison.seed,
        "changed": dict(comparison.changed),
        "confidence": CONFIDENCE,
        "interval": "percentile bootstrap over objects",
        "reference": comparison.reference.name,
        "players": [_player(one) for one in comparison.players],
        "paired": [_paired(one) for one in comparison.paired],
        "paired_is": f"player minus {comparison.reference.name}, on the same episodes",
        "recognisers": [_recognition(one) for one in comparison.recognised],
        "wanted_views": comparison.wanted_views,
        "frontier": comparison.frontier and _frontier(comparison.frontier),
        "gain_closed": closed and closed.mean,
        "gain_closed_ci": closed and [closed.low, closed.high],
    }


def as_csv(comparison: Comparison) -> str:
    """Returns a line per player: means, ends of their intervals, and differences from the reference."""
    ends = ("", "_low", "_high")
    head = ["name", "world", "backend", "split", "episodes"]
    head += [name + end for name in MEASURES for end in ends] + ["views_right", "forced"]
    figures = list(comparison.reference.figures)
    head += [name + end for name in figures for end in ends]
    head += [f"{name}_difference{end}" for name in MEASURES for end in ends]
    paired = {one.name: one for one in comparison.paired}
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(head)
    for one in comparison.players:
        differences = _numbers(paired[one.name]) if one.name in paired else [None] * len(MEASURES) * len(ends)
        about = [one.name, one.world, one.backend, comparison.split, one.episodes]
        known = [number for name in figures for number in one.figures[name] or [None] * len(ends)]
        lines.writerow([*about, *_numbers(one), one.views_right, one.forced, *known, *differences])
    return text.getvalue()


def as_lines(comparison: Comparison) -> str:
    """Returns one JSON object per line, for each episode of each player."""
    return "".join(json.dumps(asdict(row)) + "\n" for rows in comparison.rows.values() for row in rows)


def _player(one: Standing) -> dict[str, Any]:
    about = {"name": one.name, "world": one.world, "backend": one.backend, "episodes": one.episodes}
    return {
        **about,
        **_measures(one),
        "views_right": one.views_right,
        "forced": one.forced,
        **_intervals(one.figures),
        "max_views": one.max_views,
        "by_class": _groups("class", one.classes),
        "by_difficulty": _groups("difficulty", one.difficulties),
        "by_views": _groups("views", one.seen),
        "by_views_allowed": _groups("views_allowed", one.allowed),
    }


def _paired(one: Difference) -> dict[str, Any]:
    return {"name": one.name, "reference": one.reference, "episodes": one.episodes, **_measures(one)}


def _recognition(one: Recognition) -> dict[str, Any]:
    about = {key: value for key, value in asdict(one).items() if key not in ("accuracy", "published")}
    published = {"published_percent": one.published, "published_on": one.published and PUBLISHED}
    return {**about, **_intervals({"accuracy": one.accuracy}), **published}


def _frontier(of: Frontier) -> dict[str, Any]:
    """Returns a column per mean for every player; `area` is the mean accuracy over them."""
    curves = []
    for one in of.curves:
        plain: dict[str, Any] = {"name": one.name}
        for name, column in (("accuracy", one.accuracy), ("difference", one.difference)):
            plain[name] = column and [each.mean for each in column]
            plain[f"{name}_ci"] = column and [[each.low, each.high] for each in column]
        curves.append(plain | _intervals({"area": one.area, "area_difference": one.area_difference}))
    return {"mean_views": list(of.means), "thresholds_from": CHOOSING, "curves": curves}


def _measures(one: Standing | Difference) -> dict[str, Any]:
    return _intervals({name: getattr(one, name) for name in MEASURES})


def _intervals(of: Mapping[str, Interval | None]) -> dict[str, Any]:
    """Returns `NAME` and `NAME_ci` for every interval; null if it is not known."""
    plain: dict[str, Any] = {}
    for name, interval in of.items():
        plain |= {name: interval and interval.mean, f"{name}_ci": interval and [interval.low, interval.high]}
    return plain


def _numbers(one: Standing | Difference) -> list[float | None]:
    return [number for name in MEASURES for number in getattr(one, name)]


def _groups(by: str, groups: Sequence[EpisodeGroup]) -> list[dict[str, Any]]:
    """Returns counts of episodes by class or difficulty (a name) or by views (a number)."""
    return [
        {
            by: int(group.name) if by.startswith("views") else group.name,
            "episodes": group.episodes,
            "right": group.right,
            "wrong": group.episodes - group.right,
            "accuracy": group.right / group.episodes if group.episodes else None,
            **({} if by == "views" else {"mean_views": group.views}),
        }
        for group in groups
    ]


def _replace(path: Path, content: bytes) -> Path:
    """Writes under a temporary name, then renames."""
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(content)
    temporary.replace(path)
    return path
