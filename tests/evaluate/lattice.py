"""A made-up room to walk in: a lattice of points with 12 headings, one target, and obstacles in between."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from activelsd.envs.oracle import with_oracle
from activelsd.envs.viewgraph import ViewGraph

MOVES = ("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw")
HEADINGS, HALF_VIEW = 12, 45.0
"""Headings go clockwise from up (y grows upwards); the camera sees 45 degrees to either side."""


def lattice(
    *,
    side: int = 7,
    thing: tuple[float, float] = (3.0, 8.0),
    walls: Collection[tuple[int, int]] = (),
    size: int = 16,
) -> ViewGraph:
    """Views of a square of points; a target of one step's width stands at `thing`, walls hide nothing.

    A step goes one point along the axis nearest the heading. Every view is a start, of each split in turn.
    """
    points = [(x, y) for x in range(side) for y in range(side) if (x, y) not in walls]
    place = {point: i for i, point in enumerate(points)}
    poses = [(x, y, h) for x, y in points for h in range(HEADINGS)]
    moves = np.full((len(poses), len(MOVES)), -1, np.int32)
    boxes = np.zeros((len(poses), 4))
    for view, (x, y, h) in enumerate(poses):
        for column, turned in enumerate((0, 180, -90, 90)):
            way = np.radians(30 * h + turned)
            dx, dy = np.sin(way), np.cos(way)
            step = (round(float(np.sign(dx))), 0) if abs(dx) > abs(dy) else (0, round(float(np.sign(dy))))
            to = place.get((x + step[0], y + step[1]))
            moves[view, column] = -1 if to is None else to * HEADINGS + h
        moves[view, 4:] = [view - h + (h + 1) % HEADINGS, view - h + (h - 1) % HEADINGS]
        boxes[view] = _box(thing[0] - x, thing[1] - y, 30.0 * h)
    seen = boxes[:, 2] > 0
    starts = np.arange(len(poses))
    rng = np.random.default_rng(0)
    graph = ViewGraph(
        frames=rng.integers(0, 256, (len(poses), size, size), dtype=np.uint8),
        moves=moves,
        move_names=MOVES,
        classes=("cup", "lamp"),
        targets=("room/cup",),
        labels=np.array([0]),
        scenes=("room",),
        scene_of=np.zeros(len(poses), np.int32),
        view_names=tuple(f"{x}_{y}_{30 * h}" for x, y, h in poses),
        start_view=starts.astype(np.int32),
        start_target=np.zeros(len(poses), np.int32),
        start_split=np.full(len(poses), 2, np.uint8),
        pair_of=np.where(seen, np.cumsum(seen) - 1, -1)[:, None].astype(np.int32),
        boxes=boxes[seen].astype(np.float32),
        crops=rng.integers(0, 256, (int(seen.sum()), size, size), dtype=np.uint8),
    )
    return with_oracle(graph)


def _box(dx: float, dy: float, heading: float) -> tuple[float, float, float, float]:
    """cx, cy, w, h of something of width 1 that is dx, dy away; nothing where it is out of sight."""
    off = (np.degrees(np.arctan2(dx, dy)) - heading + 180) % 360 - 180
    distance = float(np.hypot(dx, dy))
    width = min(0.9, 0.5 / distance)
    if abs(off) >= HALF_VIEW:
        return (0.0, 0.0, 0.0, 0.0)
    middle = 0.5 + off / (2 * HALF_VIEW)
    low, high = max(0.0, middle - width / 2), min(1.0, middle + width / 2)
    return ((low + high) / 2, 0.5, high - low, width)
