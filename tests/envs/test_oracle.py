"""Shortest paths to a good view, compared with a search from every view by itself."""

from __future__ import annotations

import subprocess
import sys
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
import torch

from activelsd.envs.oracle import Guide, moves_to_go, shows_well, with_oracle
from activelsd.envs.viewgraph import ViewGraph
from tests.graphs import room_graph


def slow_moves_to_go(graph: ViewGraph, view: int, target: int) -> int:
    """Breadth first, forwards, from one view."""
    assert graph.pair_of is not None
    assert graph.boxes is not None
    areas: dict[int, float] = {}
    for v in range(len(graph.frames)):
        pair = graph.pair_of[v, target]
        if pair >= 0:
            cx, cy, w, h = graph.boxes[pair].astype(float)
            if cx - w / 2 > 1e-6 and cy - h / 2 > 1e-6 and cx + w / 2 < 1 - 1e-6 and cy + h / 2 < 1 - 1e-6:
                areas[v] = w * h
    good = {v for v, area in areas.items() if area >= max(areas.values()) / 2}
    ahead, seen = deque([(view, 0)]), {view}
    while ahead:
        here, moves = ahead.popleft()
        if here in good:
            return moves
        for to in graph.moves[here].tolist():
            if to >= 0 and to not in seen:
                seen.add(to)
                ahead.append((to, moves + 1))
    return -1


@pytest.mark.parametrize("seed", range(6))
def test_it_is_what_a_search_from_every_view_finds(seed: int) -> None:
    graph = room_graph(seed=seed, rooms=4)
    assert graph.boxes is not None
    boxes = graph.boxes.copy()
    boxes[::3, :2] = boxes[::3, 2:] / 2  # a third touches the corner
    # Views of a scene need not lie side by side.
    shuffle = np.random.default_rng(seed).permutation(len(graph.frames))
    place = np.argsort(shuffle)
    assert graph.pair_of is not None
    graph = replace(
        graph,
        boxes=boxes,
        frames=graph.frames[shuffle],
        moves=np.where(graph.moves >= 0, place[graph.moves], -1)[shuffle].astype(np.int32),
        scene_of=graph.scene_of[shuffle],
        pair_of=graph.pair_of[shuffle],
        start_view=place[graph.start_view].astype(np.int32),
    )
    found = moves_to_go(graph)
    slow = [
        [slow_moves_to_go(graph, v, t) for t in range(len(graph.targets))] for v in range(len(graph.frames))
    ]
    assert found.tolist() == slow
    assert {-1, 0, 1, 2} <= set(found.ravel().tolist())
    views = with_oracle(graph).oracle_views
    assert views is not None
    for row, count in enumerate(views.tolist()):
        moves = slow[graph.start_view[row]][graph.start_target[row]]
        assert count == (moves + 1 if moves >= 0 else -1)
        assert graph.episode(row).oracle_views is None
        assert with_oracle(graph).episode(row).oracle_views == count


def test_a_box_at_the_border_never_shows_well() -> None:
    graph = room_graph(rooms=1)
    assert graph.boxes is not None
    boxes = np.full_like(graph.boxes, 0.5)
    boxes[:, :2] = 0.25  # it ends at 0
    graph = replace(graph, boxes=boxes)
    assert not shows_well(graph).any()
    assert (moves_to_go(graph) == -1).all()


def test_moves_that_lead_nearer() -> None:
    graph = room_graph(rooms=4)
    away = moves_to_go(graph)
    views, targets = (x.ravel() for x in np.indices(away.shape))
    nearer = Guide(graph, torch.device("cpu")).nearer(torch.from_numpy(views), torch.from_numpy(targets))
    for view, target, found in zip(views.tolist(), targets.tolist(), nearer.tolist(), strict=True):
        here = away[view, target]
        assert found == [to >= 0 and 0 <= away[to, target] < here for to in graph.moves[view]]
    assert nearer.any()


def test_worlds_find_shortest_paths_without_torch() -> None:
    code = "import sys, activelsd.envs.oracle; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
