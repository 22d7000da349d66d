"""Where episodes begin: which (view, target) pairs of which split, and what they are filtered by."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.avd.splits import Split, validates
from activelsd.envs.oracle import shows_well
from activelsd.envs.start_filters import kept
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import DataError

COLUMNS = ("scene", "view", "target", "score", "right")


class BoxScores(NamedTuple):
    """What a recogniser makes of every box's crop."""

    score: NDArray[np.float32]  # (P,) its probability of the class it names
    right: NDArray[np.bool_]  # (P,) whether that is the target's


def starts(
    graph: ViewGraph,
    split: Split,
    *,
    visible: bool = True,
    shown_well: bool = False,
    max_difficulty: int = 5,
    min_size: float = 0.0,
    max_size: float = 1.0,
) -> ViewGraph:
    """The graph with the starts of a split's scans.

    Args:
        graph: as prepared.
        split: which scan is of which split.
        visible: only views that show the target; else every view of the target's scan, unless another filter
            needs a box to judge by.
        shown_well: also views that show the target well, see `oracle.shows_well`: moving gains little there.
        max_difficulty: of the start's box, as annotated, 1 (easiest) to 5.
        min_size: of the start's box: its larger side as a fraction of the frame.
        max_size: the same.
    """
    assert graph.pair_of is not None
    assert graph.boxes is not None
    assert graph.difficulty is not None
    scene_of_target = [graph.scenes.index(target.partition("/")[0]) for target in graph.targets]
    larger = graph.boxes[:, 2:].max(1)
    good = (graph.difficulty <= max_difficulty) & (min_size <= larger) & (larger <= max_size)
    shown = np.append(good, False)[graph.pair_of]
    if not (visible or max_difficulty < 5 or min_size > 0 or max_size < 1):
        shown = graph.scene_of[:, None] == np.array(scene_of_target)
    if not shown_well:
        shown &= ~np.append(shows_well(graph), False)[graph.pair_of]
    view, target = np.nonzero(shown)
    split_of = _split_of_target(graph, split)[target]
    tells = split_of >= 0
    return replace(
        graph,
        start_view=view[tells].astype(np.int32),
        start_target=target[tells].astype(np.int32),
        start_split=split_of[tells].astype(np.uint8),
    )


def _split_of_target(graph: ViewGraph, split: Split) -> NDArray[np.int64]:
    """(T,) index into SPLITS, -1 for targets of scans that are in none."""
    found = np.full(len(graph.targets), -1)
    trained = 0
    for target in sorted(range(len(graph.targets)), key=graph.targets.__getitem__):
        scan = graph.targets[target].partition("/")[0]
        names = next((name for name in SPLITS if scan in getattr(split, name)), None)
        if names == "train" and not split.val:
            names = "val" if validates(trained) else "train"
            trained += 1
        if names is not None:
            found[target] = SPLITS.index(names)
    return found


def starts_by_score(graph: ViewGraph, scores: BoxScores, threshold: float = 0.9) -> ViewGraph:
    """The graph with the starts that the data set's paper plays from, of those it has.

    Those are the views that a recogniser is not sure of, its score below the threshold, of targets that it
    names rightly in one view of the scene and wrongly in another: there is something to gain from moving.
    """
    assert graph.pair_of is not None
    pair = graph.pair_of[graph.start_view, graph.start_target]
    seen = graph.pair_of >= 0
    said = np.append(scores.right, False)[graph.pair_of]
    mixed = np.any(seen & said, axis=0) & np.any(seen & ~said, axis=0)
    unsure = np.append(scores.score < threshold, False)[pair]
    return kept(graph, unsure & mixed[graph.start_target])


def write_scores(graph: ViewGraph, scores: BoxScores, file: Path) -> None:
    """Write scores as CSV, a row per box: scene, view, target, score, right."""
    assert graph.pair_of is not None
    temporary = file.with_name(file.name + ".tmp")
    with temporary.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(COLUMNS)
        for view, target in np.argwhere(graph.pair_of >= 0):
            pair = graph.pair_of[view, target]
            names = graph.scenes[graph.scene_of[view]], graph.view_names[view], graph.targets[target]
            table.writerow([*names, f"{scores.score[pair]:.6g}", int(scores.right[pair])])
    temporary.replace(file)


def read_scores(graph: ViewGraph, file: Path) -> BoxScores:
    """Read what `write_scores` wrote, for the boxes of a graph.

    Raises:
        DataError: the file is missing or no such table, or lacks a box.
    """
    assert graph.pair_of is not None
    assert graph.boxes is not None
    try:
        with file.open(newline="") as stream:
            table = csv.DictReader(stream)
            rows = {
                (r["scene"], r["view"], r["target"]): (float(r["score"]), r["right"] == "1") for r in table
            }
    except OSError as error:
        raise DataError(
            f"{file} cannot be read ({error.strerror}); name another env.starts.scores."
        ) from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise DataError(f"{file} is no table of {', '.join(COLUMNS)}; write it anew.") from None
    score, right = np.zeros(len(graph.boxes), np.float32), np.zeros(len(graph.boxes), np.bool_)
    for view, target in np.argwhere(graph.pair_of >= 0):
        names = graph.scenes[graph.scene_of[view]], graph.view_names[view], graph.targets[target]
        if names not in rows:
            raise DataError(
                f"{file} has no score of {names[2]} in view {names[1]}; write it anew for these scans."
            )
        score[graph.pair_of[view, target]], right[graph.pair_of[view, target]] = rows[names]
    return BoxScores(score, right)
