"""Voxels that depths tell of, against the bodies that were rendered."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.scenery.depths import NOTHING, STEP, as_levels
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.orbit_renderer import DEEPEST, render_depths
from activelsd.scenery.voxels import (
    FILLED,
    FREE,
    SIDE,
    SURFACE,
    THICKNESS,
    UNSEEN,
    VoxelCameras,
    merged,
)

SIZE = 64
CAMERAS = np.array([(a, 30.0) for a in range(0, 360, 30)] + [(0.0, 80.0)])
RADIUS = 0.8  # of a cylinder in the unit sphere, 1.2 high


def test_levels_are_depths_to_half_a_step() -> None:
    depths = np.array([0, 1, DEEPEST // 2, DEEPEST - 1, DEEPEST], np.uint16)
    levels = as_levels(depths)
    assert levels.tolist() == [0, 0, 127, NOTHING - 1, NOTHING]
    every = np.arange(DEEPEST, dtype=np.uint16)
    error = as_levels(every) * STEP - every * (2 / (DEEPEST - 1))
    assert np.abs(error).max() <= STEP / 2 + 1e-6


def seen(cameras: np.ndarray) -> torch.Tensor:  # type: ignore[type-arg]
    """States (C, SIDE³) of a cylinder that fills the unit sphere, from each camera."""
    body = trimesh.creation.cylinder(RADIUS, 1.2, sections=256)
    mesh = Mesh(np.asarray(body.vertices, np.float32), np.asarray(body.faces, np.int32))
    levels = as_levels(render_depths(mesh, size=SIZE, cameras=[tuple(c) for c in cameras]))
    one = VoxelCameras(cameras, SIZE)
    return one.states(torch.from_numpy(levels), torch.arange(len(cameras)))


def test_what_is_free_lies_outside_and_what_is_surface_lies_on_it() -> None:
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) * 2 / FILLED
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    sideways, upright = np.hypot(x, y) - RADIUS, np.abs(z) - 0.6
    outside = np.maximum(sideways, upright).ravel()  # negative inside; a bound of the distance outside
    slack = 2.2 / SIZE  # a pixel at the object's distance
    views = seen(CAMERAS)
    together = merged(views, torch.ones(1, len(CAMERAS), dtype=torch.bool))[0].numpy()
    assert outside[together == FREE].min() > -slack
    assert (together[outside < -2 * THICKNESS] == UNSEEN).all(), "nobody sees inside"
    assert np.abs(outside[together == SURFACE]).max() < THICKNESS + 3 * slack
    on_it = (np.abs(outside) < 0.02) & (z.ravel() > -0.5)
    assert (together[on_it] == SURFACE).mean() > 0.9, "all but the bottom is seen"
    assert (together == FREE).sum() > (views[0].numpy() == FREE).sum(), "more views free more"


def test_from_one_side_the_other_is_unseen() -> None:
    (state,) = seen(np.array([(0.0, 0.0)])).numpy().reshape(-1, SIDE, SIDE, SIDE)
    middle = SIDE // 2
    front, back = state[middle + 3 :, middle, middle], state[:middle, middle, middle]
    assert (front == FREE).any()
    assert (front == SURFACE).any()
    assert (back == UNSEEN).all()


@settings(deadline=None, max_examples=25)
@given(data=st.data())
def test_a_set_tells_the_most_of_its_views_in_any_order(data: st.DataObject) -> None:
    sizes = data.draw(st.lists(st.integers(0, 4), min_size=1, max_size=4))
    rows = st.lists(st.integers(0, 2), min_size=5, max_size=5)
    drawn = data.draw(st.lists(rows, min_size=sum(sizes), max_size=sum(sizes)))
    states = torch.tensor(drawn, dtype=torch.uint8).view(-1, 5)
    present = torch.arange(4) < torch.tensor(sizes)[:, None]
    expected, at = [], 0
    for size in sizes:
        own = states[at : at + size].tolist()
        expected.append([max((row[i] for row in own), default=UNSEEN) for i in range(5)])
        at += size
    assert merged(states, present).tolist() == expected
