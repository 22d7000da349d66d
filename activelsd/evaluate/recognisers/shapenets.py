"""3D ShapeNets: a network on the voxels that depths of a set of views tell of (Wu et al. 2015).

https://arxiv.org/abs/1406.5670. Theirs is a deep belief net that also completes what is unseen; here a net of
three convolutions names the grid, and the `nextview` players complete by retrieval.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from activelsd.envs.settings import Progress
from activelsd.evaluate.recognisers.interface import Recogniser, RecogniserSettings, ShapeSettings
from activelsd.evaluate.recognisers.objects import Objects
from activelsd.scenery.voxels import SIDE, VoxelCameras, merged

COARSE = 24
"""Side in pixels of pictures in which neighbouring voxels of a surface leave no gaps."""


class ShapeNets(Recogniser):
    """Three convolutions in space, two dense layers; a voxel is 1 on the surface, 0 if free, -1 if unseen.

    Attributes:
        cameras: where the voxels appear to every camera of the world.
        coarse: the same in pictures whose pixels are as large as voxels.
        camera_of: int64 (V,), the camera of every view.
    """

    given = "depth, pose"
    published = 77.3

    Settings: ClassVar[type[RecogniserSettings]] = ShapeSettings

    def __init__(
        self, objects: Objects, settings: RecogniserSettings, progress: Progress | None = None
    ) -> None:
        super().__init__(objects, settings, progress)
        depths = objects.world.depths(progress)
        self._levels = depths.levels
        different, camera_of = np.unique(depths.cameras, axis=0, return_inverse=True)
        self.cameras = VoxelCameras(different, depths.levels.shape[-1])
        self.coarse = VoxelCameras(different, COARSE)
        self.camera_of = torch.from_numpy(camera_of.reshape(-1))
        self.maps = nn.Sequential(
            nn.Conv3d(1, 32, 5, 2),
            nn.ReLU(),
            nn.Conv3d(32, 64, 3, 2),
            nn.ReLU(),
            nn.Conv3d(64, 128, 3),
            nn.ReLU(),
        )
        self.dense = nn.Sequential(
            nn.Linear(128 * 4**3, 256),
            nn.ReLU(),
            nn.Dropout(0.5),
            nn.Linear(256, len(objects.graph.classes)),
        )

    def looks_at(self) -> Sequence[NDArray[np.generic]]:
        """The depths, and what camera each view is from."""
        return self._levels, self.camera_of.numpy()

    def states(self, views: Tensor) -> Tensor:
        """What sets of views (B, N), -1 for none, tell of the voxels: uint8 (B, SIDE³)."""
        present = views >= 0
        seen = views[present]
        levels = torch.from_numpy(self._levels[seen.numpy()])
        return merged(self.cameras.states(levels, self.camera_of[seen]), present)

    def forward(self, targets: Tensor, views: Tensor) -> Tensor:
        """See `Recogniser`."""
        return self.classify(self.states(views))

    def classify(self, states: Tensor) -> Tensor:
        """Logits (B, C) of grids, uint8 (B, SIDE³) as `scenery.voxels` has them."""
        grids = states.to(self.device).float().sub_(1).view(-1, 1, SIDE, SIDE, SIDE)
        logits: Tensor = self.dense(self.maps(grids).flatten(1))
        return logits
