"""Rectangles on the floor against dense samples of their points."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from activelsd.scenery.rooms.footprints import Rect, clearance, overlap

places, halves = st.floats(-2, 2), st.floats(0.1, 1.0)
rects = st.builds(Rect, places, places, halves, halves, st.floats(0, 360))
GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41)), axis=-1).reshape(-1, 2)


def inside(rect, points, margin=0.0):
    return (np.abs(rect.local(points)) < np.array([rect.half_x, rect.half_y]) + margin).all(axis=1)


@given(rects, rects)
def test_overlap_is_sharing_a_point(a, b):
    if inside(b, a.points(0.999 * GRID)).any():
        assert overlap(a, b)
        assert overlap(b, a)
    elif not inside(b, a.points(GRID), margin=0.06).any():  # farther apart than the samples are
        assert not overlap(a, b)


@given(rects, places, places, places, places)
def test_clearance_is_the_least_distance_of_any_two_points(rect, x0, y0, x1, y1):
    start, end = np.array([(x0, y0)]), np.array([(x1, y1)])
    along = start + np.linspace(0, 1, 60)[:, None] * (end - start)
    distances = np.linalg.norm(along[:, None] - rect.points(GRID)[None], axis=2)
    found = clearance(rect, start, end)[0]
    assert found <= distances.min() + 1e-9
    assert found >= distances.min() - 0.12


@given(rects, places, places)
def test_a_point_is_a_segment_of_no_length(rect, x, y):
    point = np.array([(x, y)])
    local = np.abs(rect.local(point)[0]) - (rect.half_x, rect.half_y)
    assume(np.abs(local).min() > 1e-6)
    expected = np.linalg.norm(np.maximum(local, 0.0))
    np.testing.assert_allclose(clearance(rect, point, point), [expected], atol=1e-9)


@given(rects, st.floats(-0.05, 0.5))
def test_grown_and_corners(rect, by):
    grown = rect.grown(by)
    sides = np.linalg.norm(np.roll(grown.corners(), -1, axis=0) - grown.corners(), axis=1)
    np.testing.assert_allclose(sides[:2], (2 * (rect.half_x + by), 2 * (rect.half_y + by)), atol=1e-9)
