"""Chooses the (view, target) pairs that episodes start from, by split and by filters."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.avd.settings import StartsSettings
from activelsd.envs.avd.splits import Split, validates
from activelsd.envs.oracle import shows_well
from activelsd.envs.start_filters import keep_starts
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import DataError

COLUMNS = ("scene", "view", "target", "score", "right")


class BoxScores(NamedTuple):
    """A recogniser's predictions for the crops of all boxes."""

    score: NDArray[np.float32]  # (P,) probability of the predicted class
    right: NDArray[np.bool_]  # (P,) whether the predicted class is the target's


def starts(graph: ViewGraph, split: Split, settings: StartsSettings) -> ViewGraph:
    """The graph with the starts that pass the filters.

    Args:
        graph: the graph as prepared.
        split: the scans of each split.
        settings: the filters. Without any that judges by a box, every view of the target's scan is a start.
    """
    assert graph.pair_of is not None
    assert graph.boxes is not None
    assert graph.difficulty is not None
    scene_of_target = [graph.scenes.index(target.partition("/")[0]) for target in graph.targets]
    larger = graph.boxes[:, 2:].max(1)
    good = (settings.min_size <= larger) & (larger <= settings.max_size)
    good &= graph.difficulty <= settings.max_difficulty
    shown = np.append(good, False)[graph.pair_of]
    if not settings.needs_a_box:
        shown = graph.scene_of[:, None] == np.array(scene_of_target)
    if not settings.shown_well:
        shown &= ~np.append(shows_well(graph), False)[graph.pair_of]
    view, target = np.nonzero(shown)
    split_of = _split_of_target(graph, split)[target]
    used = split_of >= 0
    return replace(
        graph,
        start_view=view[used].astype(np.int32),
        start_target=target[used].astype(np.int32),
        start_split=split_of[used].astype(np.uint8),
    )


def _split_of_target(graph: ViewGraph, split: Split) -> NDArray[np.int64]:
    """(T,) index into SPLITS, -1 for targets of scans that are in no split."""
    split_of = np.full(len(graph.targets), -1)
    trained = 0
    for target in sorted(range(len(graph.targets)), key=graph.targets.__getitem__):
        scan = graph.targets[target].partition("/")[0]
        name = next((name for name in SPLITS if scan in getattr(split, name)), None)
        if name == "train" and not split.val:
            name = "val" if validates(trained) else "train"
            trained += 1
        if name is not None:
            split_of[target] = SPLITS.index(name)
    return split_of


def starts_by_score(graph: ViewGraph, scores: BoxScores, threshold: float) -> ViewGraph:
    """The graph with only the starts that the data set's paper uses.

    The recogniser's score in the view is below the threshold, and it recognises the target in some views of
    the scene and not in others, so moving can help.
    """
    assert graph.pair_of is not None
    pair = graph.pair_of[graph.start_view, graph.start_target]
    seen = graph.pair_of >= 0
    right = np.append(scores.right, False)[graph.pair_of]
    mixed = np.any(seen & right, axis=0) & np.any(seen & ~right, axis=0)
    unsure = np.append(scores.score < threshold, False)[pair]
    return keep_starts(graph, unsure & mixed[graph.start_target])


def write_scores(graph: ViewGraph, scores: BoxScores, file: Path) -> None:
    """Writes scores as CSV, one row per box: scene, view, target, score, right."""
    assert graph.pair_of is not None
    temporary = file.with_name(file.name + ".tmp")
    with temporary.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for view, target in np.argwhere(graph.pair_of >= 0):
            pair = graph.pair_of[view, target]
            names = graph.scenes[graph.scene_of[view]], graph.view_names[view], graph.targets[target]
            table.writerow([*names, f"{scores.score[pair]:.6g}", int(scores.right[pair])])
    temporary.replace(file)


def read_scores(graph: ViewGraph, file: Path) -> BoxScores:
    """Reads the scores of a graph's boxes from a file of `write_scores`.

    Raises:
        DataError: the file is missing, is not such a table, or lacks a box.
    """
    assert graph.pair_of is not None
    assert graph.boxes is not None
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            table = csv.DictReader(stream)
            rows = {
                (r["scene"], r["view"], r["target"]): (float(r["score"]), r["right"] == "1") for r in table
            }
    except OSError as error:
        raise DataError(
            f"{file} cannot be read ({error.strerror}); set env.starts.scores to another file."
        ) from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise DataError(f"{file} is not a table of {', '.join(COLUMNS)}; write it again.") from None
    score, right = np.zeros(len(graph.boxes), np.float32), np.zeros(len(graph.boxes), np.bool_)
    for view, target in np.argwhere(graph.pair_of >= 0):
        names = graph.scenes[graph.scene_of[view]], graph.view_names[view], graph.targets[target]
        if names not in rows:
            raise DataError(
                f"{file} has no score for {names[2]} in view {names[1]}; write it again for these scans."
            )
        score[graph.pair_of[view, target]], right[graph.pair_of[view, target]] = rows[names]
    return BoxScores(score, right)
