"""Which of the places to start from are kept: what worlds of rooms do alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import DataError


def frozen_list(graph: ViewGraph, per_target: int, seed: int = 0) -> ViewGraph:
    """The graph with at most so many starts of every target that validates or tests, drawn by a seed."""
    keep = graph.start_split == SPLITS.index("train")
    rng = np.random.default_rng(seed)
    for target in range(len(graph.targets)):
        rows = np.flatnonzero((graph.start_target == target) & ~keep)
        keep[rng.choice(rows, min(per_target, len(rows)), replace=False)] = True
    return kept(graph, keep)


def kept(graph: ViewGraph, keep: NDArray[np.bool_]) -> ViewGraph:
    """The graph with some of its starts, bool (E,)."""
    return replace(
        graph,
        start_view=graph.start_view[keep],
        start_target=graph.start_target[keep],
        start_split=graph.start_split[keep],
    )


def check_starts(graph: ViewGraph) -> None:
    """Raise DataError where the filters leave nothing to train on or to test."""
    for split in ("train", "test"):
        if not (graph.start_split == SPLITS.index(split)).any():
            raise DataError(f"No episode can start in the '{split}' split; ask less of env.starts.")
