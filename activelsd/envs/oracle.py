"""The shortest way to a good look: how few moves lead from every view to one that shows its target well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.viewgraph import ViewGraph

BORDER = 1e-6
"""A box nearer than this to the frame's edge, as a fraction of it, touches it: the target may be cut off."""


def shows_well(graph: ViewGraph) -> NDArray[np.bool_]:
    """bool (P,): the boxes that show their target well.

    That is off the frame's border, and at least half as large as the target is anywhere off it: by the pixels
    that show it, where they are known, else by the box's area.
    """
    assert graph.pair_of is not None
    assert graph.boxes is not None
    centre, extent = graph.boxes[:, :2].astype(np.float64), graph.boxes[:, 2:].astype(np.float64)
    low, high = centre - extent / 2, centre + extent / 2
    inside = np.all((low > BORDER) & (high < 1 - BORDER), axis=1)
    area = np.where(inside, extent.prod(1) if graph.pixels is None else graph.pixels, 0.0)
    view, target = np.nonzero(graph.pair_of >= 0)
    pair = graph.pair_of[view, target]
    best = np.zeros(len(graph.targets))
    np.maximum.at(best, target, area[pair])
    well = np.zeros(len(area), bool)
    well[pair] = inside[pair] & (area[pair] >= best[target] / 2)
    return well


def moves_to_go(graph: ViewGraph) -> NDArray[np.int16]:
    """(V, T): fewest moves from a view to one that shows a target well; -1 where none can be reached.

    Breadth first against the direction of the moves, all targets at once: whether the way back exists does
    not matter.
    """
    assert graph.pair_of is not None
    well = np.append(shows_well(graph), False)[graph.pair_of]  # -1, out of sight, finds the False
    away = np.where(well, 0, -1).astype(np.int16)
    place = np.zeros(len(away), np.int32)  # number of each view among those of its scene
    for scene in range(len(graph.scenes)):
        views = np.flatnonzero(graph.scene_of == scene)
        targets = np.flatnonzero(well[views].any(0))
        place[views] = np.arange(len(views))
        moves = np.where(graph.moves[views] >= 0, place[graph.moves[views]], -1)
        away[np.ix_(views, targets)] = _spread(away[np.ix_(views, targets)], moves)
    return away


def _spread(away: NDArray[np.int16], moves: NDArray[np.int32]) -> NDArray[np.int16]:
    """Fill in, level by level, how far views are from those that are at 0 already; one scene's (v, t)."""
    away, blocked, level = away.copy(), (moves < 0)[:, :, None], 0
    while True:
        leads = ((away[moves] == level) & ~blocked).any(1) & (away < 0)
        if not leads.any():
            return away
        level += 1
        away[leads] = level


def with_oracle(graph: ViewGraph) -> ViewGraph:
    """The graph with `oracle_views` of every start: views on the shortest way, the first one included."""
    away = moves_to_go(graph)[graph.start_view, graph.start_target].astype(np.int32)
    return replace(graph, oracle_views=np.where(away >= 0, away + 1, -1).astype(np.int32))
