"""Crops varied at random: within bounds, by a generator, and nothing else of an observation."""

from __future__ import annotations

import torch
from torch import Tensor

from activelsd.train.augment import vary_crops


def observed() -> dict[str, Tensor]:
    """Six looks of two stacked crops: a bright square left of the middle; the third is out of sight."""
    crops = torch.full((6, 2, 32, 32), 60, dtype=torch.uint8)
    crops[..., 10:22, 6:18] = 200
    target = torch.tensor([0.5, 0.5, 0.2, 0.3, 1.0]).repeat(6, 2, 1)
    crops[2], target[2] = 0, 0
    return {"frames": crops.flip(-1), "crops": crops, "target": target}


def test_crops_vary_and_nothing_else_does() -> None:
    observation = observed()
    varied = vary_crops(observation, torch.Generator().manual_seed(0))
    assert varied["frames"] is observation["frames"]
    assert varied["target"] is observation["target"]
    crops = varied["crops"]
    assert (crops.shape, crops.dtype) == (observation["crops"].shape, torch.uint8)
    assert not crops[2].any(), "out of sight stays dark"
    assert torch.equal(observation["crops"], observed()["crops"]), "the recording is not written to"
    seen = crops[[0, 1, 3, 4, 5]].flatten(0, 1).float()
    assert len({tuple(crop.flatten().tolist()) for crop in seen}) == len(seen), "each on its own"
    # The square is still there, left of the middle and brighter than what is around it.
    for crop in seen:
        inside = crop > (crop.min() + crop.max()) / 2
        assert 0.04 < inside.float().mean() < 0.35
        assert inside.nonzero()[:, 1].float().mean() < 20


def test_a_frame_that_stands_for_a_crop_stays_as_it_is() -> None:
    observation = observed()
    observation["target"][3] = torch.tensor([0.5, 0.5, 1.0, 1.0, 1.0])
    crops = vary_crops(observation, torch.Generator().manual_seed(0))["crops"]
    assert torch.equal(crops[3], observation["crops"][3])
    assert not torch.equal(crops[4], observation["crops"][4])


def test_a_generator_repeats_it() -> None:
    first, again, other = (
        vary_crops(observed(), torch.Generator().manual_seed(seed))["crops"] for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_worlds_without_crops_draw_nothing() -> None:
    observation = {name: value for name, value in observed().items() if name != "crops"}
    generator = torch.Generator().manual_seed(0)
    before = generator.get_state()
    assert vary_crops(observation, generator) is observation
    assert torch.equal(generator.get_state(), before)
