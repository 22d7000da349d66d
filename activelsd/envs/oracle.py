"""Shortest paths to a good view: the fewest moves from every view to one that shows a target well."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.viewgraph import ViewGraph

if TYPE_CHECKING:
    import torch

BORDER = 1e-6
"""A box nearer than this to the frame's edge, as a fraction of it, touches it: the target may be cut off."""


def shows_well(graph: ViewGraph) -> NDArray[np.bool_]:
    """Returns the boxes that show their target well, bool (P,).

    Such a box does not touch the border of the frame and is at least half as large as the largest one of its
    target that does not. Its size is the share of pixels that show the target, if the graph knows it, else
    its area.
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
    """Returns the fewest moves from each view to one that shows each target well, (V, T); -1 if unreachable.

    The breadth-first search follows moves backwards from the good views, for all targets of a scene at once.
    """
    assert graph.pair_of is not None
    well = np.append(shows_well(graph), False)[graph.pair_of]  # -1, out of sight, finds the False
    distance = np.where(well, 0, -1).astype(np.int16)
    index = np.zeros(len(distance), np.int32)  # of each view among those of its scene
    for scene in range(len(graph.scenes)):
        views = np.flatnonzero(graph.scene_of == scene)
        targets = np.flatnonzero(well[views].any(0))
        index[views] = np.arange(len(views))
        moves = np.where(graph.moves[views] >= 0, index[graph.moves[views]], -1)
        distance[np.ix_(views, targets)] = _search(distance[np.ix_(views, targets)], moves)
    return distance


def _search(distance: NDArray[np.int16], moves: NDArray[np.int32]) -> NDArray[np.int16]:
    """Fills in the distances (v, t) of one scene level by level, starting from the views at 0."""
    distance, blocked, level = distance.copy(), (moves < 0)[:, :, None], 0
    while True:
        reached = ((distance[moves] == level) & ~blocked).any(1) & (distance < 0)
        if not reached.any():
            return distance
        level += 1
        distance[reached] = level


def with_oracle(graph: ViewGraph) -> ViewGraph:
    """Returns the graph with `oracle_views` of every start: views on a shortest path, the first included."""
    distance = moves_to_go(graph)[graph.start_view, graph.start_target].astype(np.int32)
    return replace(graph, oracle_views=np.where(distance >= 0, distance + 1, -1).astype(np.int32))


class Guide:
    """Tells which moves are on a shortest path to a good view, for many episodes at once on a device."""

    def __init__(self, graph: ViewGraph, device: torch.device) -> None:
        """Searches all paths; the graph's targets need boxes."""
        import torch  # here, since worlds are opened without it

        self._distance = torch.from_numpy(moves_to_go(graph)).to(device)
        self._moves = torch.from_numpy(graph.moves).to(device).long()

    def nearer(self, views: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Returns the moves that lead nearer to a good view, bool (B, moves), from views and targets (B,).

        No move does if the view is a good one or none can be reached.
        """
        leads_to = self._moves[views]
        distance = self._distance[
            leads_to, targets[:, None]
        ]  # blocked moves, -1, read the last view: ignored
        return (leads_to >= 0) & (distance >= 0) & (distance < self._distance[views, targets][:, None])
