"""Crops of targets, varied at random while learning, so that what is learned is the target and not its place.

A walk through few homes shows every instance in a few places only, and a network learns those by heart:
what is around the target, and how the light falls there. Whole frames stay as they are: where the target is
in them, and what blocks the way, is what moves are chosen by.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

ZOOM, SQUEEZE, SHIFT = 0.25, 0.1, 0.15
"""Most change of a crop's extent, of one side against the other, and of its middle, as fractions."""

CONTRAST, BRIGHTNESS = 0.8, 0.25
"""Most change of contrast as an exponent of e, and of brightness as a fraction of white."""


def vary_crops(observation: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """The observation with each of its `crops` uint8 (B, K, S, S) cut and lit a little otherwise.

    Crops of targets out of sight are zeros and stay so. What was not cut stays as it is too: an observation
    without crops, and a frame that stands for the crop of a target that fills it.
    """
    if "crops" not in observation:
        return observation
    crops = observation["crops"]
    pictures = crops.flatten(0, 1)[:, None].float() / 255

    def between(low: float, high: float, *shape: int) -> Tensor:
        drawn = torch.rand(len(pictures), *shape, generator=generator, device=crops.device)
        return low + (high - low) * drawn

    extent = between(1 - ZOOM, 1 + ZOOM, 1) * between(1 - SQUEEZE, 1 + SQUEEZE, 2)
    middle = between(-SHIFT, SHIFT, 2, 1)
    where = functional.affine_grid(
        torch.cat([torch.diag_embed(extent), middle], 2), list(pictures.shape), align_corners=False
    )
    cut = functional.grid_sample(pictures, where, padding_mode="border", align_corners=False)
    mean = cut.mean((1, 2, 3), keepdim=True)
    contrast = between(-CONTRAST, CONTRAST, 1, 1, 1).exp()
    lit = (cut - mean) * contrast + mean + between(-BRIGHTNESS, BRIGHTNESS, 1, 1, 1)
    extents, present = observation["target"][..., 2:4], observation["target"][..., 4] > 0
    was_cut = (present & (extents < 1).any(-1))[..., None, None]
    varied = (lit.clamp(0, 1) * 255).round().to(torch.uint8).view(crops.shape)
    return observation | {"crops": torch.where(was_cut, varied, crops)}
