"""DeepPano: a network on an object's distance panorama, whose maximum along every row forgets the azimuth.

Shi et al. 2015 (IEEE Signal Processing Letters 22.12). It is given the whole shape, so it is a row beside the
players and none of them. Its sides are joined: convolutions go on around the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from activelsd.envs.settings import Progress
from activelsd.evaluate.recognisers.interface import Recogniser, RecogniserSettings, ShapeSettings
from activelsd.evaluate.recognisers.objects import Objects

STRIDE = 16
"""Columns of the panorama that the last maps have one for: shifts by as many change nothing."""

_MARGIN = 0.125
"""Rows without anything above and below, as a fraction of the panorama's."""


class Around(nn.Module):
    """A convolution whose input goes on around the object: columns are circular, rows are filled with 0."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        self.wide = kernel // 2
        self.convolution = nn.Conv2d(inputs, outputs, kernel, stride, (self.wide, 0))

    def forward(self, maps: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H / stride, W / stride)."""
        maps = functional.pad(maps, (self.wide, self.wide, 0, 0), mode="circular")
        convolved: Tensor = self.convolution(maps)
        return convolved


class DeepPano(Recogniser):
    """Four convolutions with pools, the maximum of every row, two dense layers."""

    given = "whole shape"
    published = 77.6
    whole = True

    Settings: ClassVar[type[RecogniserSettings]] = ShapeSettings

    def __init__(
        self, objects: Objects, settings: RecogniserSettings, progress: Progress | None = None
    ) -> None:
        super().__init__(objects, settings, progress)
        self._panoramas = objects.world.panoramas(progress)
        rows = self._panoramas.shape[1]
        self._margin = round(rows * _MARGIN)
        self.maps = nn.Sequential(
            Around(1, 16, 5, 2),
            nn.ReLU(),
            nn.MaxPool2d(2),
            Around(16, 32, 3),
            nn.ReLU(),
            nn.MaxPool2d(2),
            Around(32, 64, 3),
            nn.ReLU(),
            nn.MaxPool2d(2),
            Around(64, 128, 3),
            nn.ReLU(),
        )
        self.dense = nn.Sequential(
            nn.Linear(128 * ((rows + 2 * self._margin) // STRIDE), 256),
            nn.ReLU(),
            nn.Dropout(0.5),
            nn.Linear(256, len(objects.graph.classes)),
        )

    def looks_at(self) -> Sequence[NDArray[np.generic]]:
        """The panoramas."""
        return (self._panoramas,)

    def forward(self, targets: Tensor, views: Tensor) -> Tensor:
        """See `Recogniser`; `views` are of no use to it."""
        return self.classify(torch.from_numpy(self._panoramas[targets.numpy()]).to(self.device))

    def classify(self, panoramas: Tensor) -> Tensor:
        """Logits (B, C) of panoramas, uint8 (B, H, W)."""
        framed = functional.pad(panoramas[:, None].float() / 255, (0, 0, self._margin, self._margin))
        logits: Tensor = self.dense(self.maps(framed).amax(-1).flatten(1))
        return logits
