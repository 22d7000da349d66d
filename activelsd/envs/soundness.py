"""Checks that the arrays of a `ViewGraph` fit one another, before a world of another package is played."""

from __future__ import annotations

import numpy as np

from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import DataError


def check_graph(graph: ViewGraph) -> None:
    """Check shapes, types and ranges; pictures are not read.

    Raises:
        DataError: with what is wrong, as the end of a sentence.
    """
    if not isinstance(graph, ViewGraph):
        raise DataError(f"there are no views: it is {type(graph).__name__} and must be a ViewGraph")
    views, targets, starts = len(graph.frames), len(graph.targets), len(graph.start_view)
    side = graph.frames.shape[-2]  # also if the channels come last, which is then said
    picture = (3, side, side) if graph.frames.ndim == 4 else (side, side)
    shapes: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
        "frames": ((views, *picture), np.uint8),
        "moves": ((views, len(graph.move_names)), np.int32),
        "labels": ((targets,), np.int64),
        "scene_of": ((views,), np.int32),
        "start_view": ((starts,), np.int32),
        "start_target": ((starts,), np.int32),
        "start_split": ((starts,), np.uint8),
    }
    limits = {
        "moves": (-1, views),
        "labels": (0, len(graph.classes)),
        "scene_of": (0, len(graph.scenes)),
        "start_view": (0, views),
        "start_target": (0, targets),
        "start_split": (0, len(SPLITS)),
    }
    if graph.pair_of is not None:
        pairs = 0 if graph.boxes is None else len(graph.boxes)
        shapes |= {"pair_of": ((views, targets), np.int32), "boxes": ((pairs, 4), np.float32)}
        limits["pair_of"] = (-1, pairs)
        if graph.crops is not None:
            shapes["crops"] = ((pairs, *picture), np.uint8)
    if graph.directions is not None:
        shapes["directions"] = ((views, 2), np.float32)
    if graph.poses is not None:
        width = 5 if np.shape(graph.poses)[1:] == (5,) else 3
        shapes["poses"] = ((views, width), np.float32)
    for name, (shape, dtype) in shapes.items():
        array = getattr(graph, name)
        if not isinstance(array, np.ndarray):
            raise DataError(f"`{name}` is {type(array).__name__} and must be an array")
        if (array.shape, array.dtype) != (shape, np.dtype(dtype)):
            found = f"{array.dtype} {array.shape}"
            raise DataError(f"`{name}` is {found} and must be {np.dtype(dtype)} {shape}")
    for name, (low, end) in limits.items():
        array = getattr(graph, name)
        if array.min(initial=low) < low or array.max(initial=low) >= end:
            raise DataError(f"`{name}` must be from {low} to {end - 1}")
    there = graph.moves >= 0
    if (there & (graph.scene_of[np.where(there, graph.moves, 0)] != graph.scene_of[:, None])).any():
        raise DataError("a move leads from one scene into another")
    if len(graph.view_names) != views:
        raise DataError("`view_names` must have a name for every view")
