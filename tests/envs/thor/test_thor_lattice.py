"""The lattice against walking it by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from activelsd.envs.thor.lattice import HEADINGS, MOVES, Lattice, lattice_of
from activelsd.errors import DataError

HORIZONS = (-30.0, 0.0, 30.0)


def lattice(cells: list[tuple[int, int]]) -> Lattice:
    places = [{"x": 1.0 + 0.25 * x, "y": 0.9, "z": -2.0 + 0.25 * z} for x, z in cells]
    return lattice_of(places, step=0.25, horizons=HORIZONS)


def walked(here: Lattice, view: int, move: str) -> tuple[float, ...] | None:
    """Where a move leads, by trigonometry on the pose alone; None where a cell on the way is missing."""
    pose = here.pose(view)
    x, z, rotation, horizon = pose.x, pose.z, pose.rotation, pose.horizon
    if move in ("look_up", "look_down"):
        horizon += 30 if move == "look_down" else -30
        return (x, z, rotation, horizon) if horizon in HORIZONS else None
    if move.startswith("rotate"):
        return x, z, (rotation + (45 if move == "rotate_cw" else -45)) % 360, horizon
    way = np.deg2rad(rotation + {"forward": 0, "right": 90, "backward": 180, "left": 270}[move])
    # A step of 45 degrees goes to the next corner: longer by the square root of two.
    dx, dz = (round(float(part)) * 0.25 for part in (1.2 * np.sin(way), 1.2 * np.cos(way)))
    cells = {tuple(here.origin[::2] + cell * 0.25) for cell in here.cells}
    needed = {(x + dx, z + dz), (x + dx, z), (x, z + dz)}
    return (x + dx, z + dz, rotation, horizon) if needed <= cells else None


@given(
    st.sets(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=14).map(sorted),
)
def test_moves_lead_where_walking_by_hand_does(cells: list[tuple[int, int]]) -> None:
    here = lattice(cells)
    moves = here.moves()
    assert moves.shape == (len(cells) * HEADINGS * 3, len(MOVES))
    for view in range(0, here.views, 5):
        for move, to in zip(MOVES, moves[view].tolist(), strict=True):
            expected = walked(here, view, move)
            pose = here.pose(to)
            assert (to >= 0) == (expected is not None)
            if expected is not None:
                assert (pose.x, pose.z, pose.rotation, pose.horizon) == pytest.approx(expected)


def test_turns_wrap_and_come_back_after_eight() -> None:
    here = lattice([(0, 0)])
    turn, view = MOVES.index("rotate_cw"), 1
    seen = [view]
    for _ in range(HEADINGS):
        view = int(here.moves()[view, turn])
        seen.append(view)
    assert here.pose(seen[-2]).rotation == 315
    assert seen[-1] == seen[0]
    assert len(set(seen)) == HEADINGS


def test_noise_is_snapped_away() -> None:
    exact = [{"x": 0.25 * i, "y": 0.901, "z": 0.5} for i in range(4)]
    rng = np.random.default_rng(0)
    noisy = [{k: v + rng.uniform(-4e-4, 4e-4) for k, v in place.items()} for place in exact]
    one = lattice_of(exact, step=0.25, horizons=HORIZONS)
    other = lattice_of([*noisy, noisy[2]], step=0.25, horizons=HORIZONS)
    np.testing.assert_array_equal(one.cells, other.cells)
    assert other.origin == pytest.approx(one.origin, abs=1e-3)


def test_no_position_is_said() -> None:
    with pytest.raises(DataError, match="no position"):
        lattice_of([], step=0.25, horizons=HORIZONS)


def test_poses_are_those_of_views() -> None:
    here = lattice([(0, 0), (0, 1), (2, 1)])
    poses = here.poses()
    for view in (0, 17, here.views - 1):
        pose = here.pose(view)
        assert poses[view].tolist() == pytest.approx([pose.x, pose.z, pose.rotation, pose.y, pose.horizon])
