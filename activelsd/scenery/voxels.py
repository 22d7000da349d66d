"""What depths tell of the space around an object, as 3D ShapeNets keeps it (Wu et al. 2015): voxels.

The unit sphere fills 24 of 30 voxels along each side. A voxel is surface, seen to be free, or unseen; what
one view has seen no other takes back.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.scenery.depths import NOTHING, STEP
from activelsd.scenery.orbit_renderer import DISTANCE, FRAME_RADIUS

SIDE, FILLED = 30, 24
UNSEEN, FREE, SURFACE = 0, 1, 2
"""States of a voxel, in the order in which one replaces another."""

THICKNESS = 0.75 * 2 / FILLED
"""How far the middle of a voxel of the surface may lie from it, along the camera's axis."""

_BEYOND = 1 << 14
"""Level, in steps, that stands for the depth of nothing."""


class VoxelCameras:
    """Where the middles of all voxels appear to C cameras.

    Attributes:
        size: S, the side of the pictures in pixels.
        pixels: int64 (C, SIDE³), the pixel of each, row after row; 0 where it is out of the frame.
        levels: int16 (C, SIDE³), its depth in levels of `depths`; far in front of all where out of the frame.
    """

    def __init__(self, cameras: NDArray[np.float64], size: int) -> None:
        """Project them to pictures of `size` pixels from cameras (C, 2), in degrees as in `Depths`."""
        axis = (np.arange(SIDE) - (SIDE - 1) / 2) * (2 / FILLED)
        middles = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        across, up, back = np.moveaxis(_axes(cameras) @ middles.T, 1, 0)
        ahead = DISTANCE - back
        scale = size / 2 / FRAME_RADIUS / ahead
        columns = np.floor(size / 2 + across * scale).astype(np.int64)
        rows = np.floor(size / 2 - up * scale).astype(np.int64)
        framed = (columns >= 0) & (columns < size) & (rows >= 0) & (rows < size)
        levels = np.rint((ahead - (DISTANCE - 1)) / STEP).astype(np.int16)
        self.size = size
        self.pixels = torch.from_numpy(np.where(framed, rows * size + columns, 0))
        self.levels = torch.from_numpy(np.where(framed, levels, np.int16(_BEYOND + 1000)))

    def states(self, levels: Tensor, cameras: Tensor) -> Tensor:
        """What single views tell of the voxels.

        Args:
            levels: uint8 (n, S, S), depths.
            cameras: int64 (n,), which camera each is from.

        Returns:
            uint8 (n, SIDE³).
        """
        seen = levels.flatten(1).gather(1, self.pixels[cameras])
        behind = torch.where(seen == NOTHING, _BEYOND, seen.short()) - self.levels[cameras]
        thickness = round(THICKNESS / STEP)
        return (behind >= -thickness).byte() * (1 + (behind <= thickness).byte())

    def unseen_in_sight(self, states: Tensor, cameras: Tensor) -> Tensor:
        """How many unseen voxels nothing that was seen hides from a camera.

        Args:
            states: uint8 (n, SIDE³).
            cameras: int64 (n,), which camera looks at each.

        Returns:
            int64 (n,).
        """
        pixels, levels = self.pixels[cameras], self.levels[cameras].int()
        front = torch.full((len(states), self.size**2), _BEYOND, dtype=torch.int32)
        surface = torch.where(states == SURFACE, levels, _BEYOND)
        front = front.scatter_reduce(1, pixels, surface, "amin")
        return ((states == UNSEEN) & (levels < _BEYOND) & (levels <= front.gather(1, pixels))).sum(1)


def merged(states: Tensor, present: Tensor) -> Tensor:
    """What sets of views tell together.

    Args:
        states: uint8 (n, SIDE³), of single views, set after set.
        present: bool (B, N), the places of the n views in their sets.

    Returns:
        uint8 (B, SIDE³); all unseen in a set without views.
    """
    padded = states.new_full((*present.shape, states.shape[1]), UNSEEN)
    padded[present] = states
    return padded.amax(1)


def _axes(cameras: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows right, up and back of cameras that look at the origin, (C, 3, 3)."""
    azimuth, elevation = np.radians(cameras).T
    nought = np.zeros(len(cameras))
    (ca, sa), (ce, se) = ((np.cos(x), np.sin(x)) for x in (azimuth, elevation))
    rows = ((-sa, ca, nought), (-se * ca, -se * sa, ce), (ce * ca, ce * sa, se))
    return np.moveaxis(np.array(rows), -1, 0)
