"""Filters for episode starts that all worlds of rooms use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.oracle import with_oracle
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import DataError


def episodes(graph: ViewGraph, per_target: int | None, moves: Mapping[str, Sequence[str]]) -> ViewGraph:
    """The graph of a world whose starts are filtered: with its frozen list, its moves and the oracle's views.

    Args:
        graph: with all moves and the starts that the world's own filters leave.
        per_target: most validation and test starts of a target; None keeps them all.
        moves: those asked for, by branch.

    Raises:
        DataError: no start is left in the training or test split.
    """
    check_starts(graph)
    if per_target is not None:
        graph = frozen_list(graph, per_target)
    return with_oracle(graph.with_moves(moves))


def frozen_list(graph: ViewGraph, per_target: int, seed: int = 0) -> ViewGraph:
    """The graph with at most `per_target` randomly chosen validation and test starts for each target."""
    keep = graph.start_split == SPLITS.index("train")
    rng = np.random.default_rng(seed)
    for target in range(len(graph.targets)):
        rows = np.flatnonzero((graph.start_target == target) & ~keep)
        keep[rng.choice(rows, min(per_target, len(rows)), replace=False)] = True
    return keep_starts(graph, keep)


def keep_starts(graph: ViewGraph, keep: NDArray[np.bool_]) -> ViewGraph:
    """The graph with only the starts for which `keep`, bool (E,), is True."""
    return replace(
        graph,
        start_view=graph.start_view[keep],
        start_target=graph.start_target[keep],
        start_split=graph.start_split[keep],
    )


def check_starts(graph: ViewGraph) -> None:
    """Raises DataError if the filters leave no start in the training or test split."""
    for split in ("train", "test"):
        if not (graph.start_split == SPLITS.index(split)).any():
            raise DataError(f"The '{split}' split has no episode left; relax the filters in env.starts.")
