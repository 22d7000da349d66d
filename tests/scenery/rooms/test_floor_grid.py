"""Where an agent can stand and step, against discs and segments sampled point by point."""

from __future__ import annotations

import numpy as np
import pytest

from activelsd.errors import DataError
from activelsd.scenery.rooms.floor_grid import DIRECTIONS, draw_floor_grid
from activelsd.scenery.rooms.layout import FLOOR, furnish, set_out
from activelsd.scenery.rooms.library import Embedded
from activelsd.scenery.rooms.smallthings import small_thing

STEP, RADIUS = 0.25, 0.2


@pytest.fixture(scope="module", params=range(3))
def room(request):
    room = furnish(Embedded(), request.param)
    return set_out(room, [small_thing("box", i) for i in range(8)], request.param)


@pytest.fixture(scope="module")
def lattice(room):
    return draw_floor_grid(room, step=STEP, radius=RADIUS)


def touched(room, points, radius):
    """Whether discs about points (P, 2) meet a wall or a rectangle."""
    hit = ((points < radius) | (points > np.array([room.plan.width, room.plan.depth]) - radius)).any(axis=1)
    for thing in room.things:
        if thing.on == FLOOR:
            rect = thing.footprint
            beyond = np.maximum(np.abs(rect.local(points)) - (rect.half_x, rect.half_y), 0.0)
            hit |= np.linalg.norm(beyond, axis=1) < radius
    return hit


def test_points_are_clear_of_everything(room, lattice):
    assert len(lattice.points) > 20
    assert not touched(room, lattice.points, RADIUS - 1e-6).any()


def test_moves_are_clear_all_along(room, lattice):
    for i in range(len(DIRECTIONS)):
        here = np.flatnonzero(lattice.neighbours[:, i] >= 0)
        there = lattice.neighbours[here, i]
        for share in np.linspace(0, 1, 9):
            between = (1 - share) * lattice.points[here] + share * lattice.points[there]
            assert not touched(room, between, RADIUS - 1e-6).any()


def test_moves_lead_one_step_that_way_and_back(lattice):
    for i, direction in enumerate(DIRECTIONS):
        here = np.flatnonzero(lattice.neighbours[:, i] >= 0)
        there = lattice.neighbours[here, i]
        moved = lattice.points[there] - lattice.points[here]
        np.testing.assert_allclose(moved, STEP * np.tile(direction, (len(here), 1)), atol=1e-9)
        np.testing.assert_array_equal(lattice.neighbours[there, (i + 4) % 8], here)


def test_a_missing_move_is_blocked_or_leaves_the_lattice(room, lattice):
    """What is not a neighbour is touched on the way, or is part of the floor cut off from here."""
    cells = {tuple(cell) for cell in lattice.cells.tolist()}
    for i, (dx, dy) in enumerate(DIRECTIONS):
        for here in np.flatnonzero(lattice.neighbours[:, i] < 0):
            column, row = lattice.cells[here].tolist()
            along = lattice.points[here] + np.linspace(0, 1, 40)[:, None] * STEP * np.array((dx, dy))
            blocked = touched(room, along, RADIUS + 2e-3).any()
            assert blocked or ((column + dx, row + dy) not in cells and i % 2 == 1)


def test_all_points_are_connected_along_the_axes(lattice):
    reached, edge = {0}, [0]
    while edge:
        edge = [n for p in edge for n in lattice.neighbours[p, ::2].tolist() if n >= 0 and n not in reached]
        reached.update(edge)
    assert len(reached) == len(lattice.points)


def test_an_agent_too_wide_is_refused(room):
    with pytest.raises(DataError, match="has no free place"):
        draw_floor_grid(room, step=STEP, radius=2.5)
