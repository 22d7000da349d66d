"""Episodes varied at random: within bounds, the same to an episode's end, and nothing else of it."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError
from activelsd.train.augment import VARIATION_SIZE, Variation, kept

TREE = ActionTree.answer_or_move(("cup", "vase"), ("forward", "orbit_cw_60", "orbit_ccw_60", "left", "right"))
BEGIN, GO_ON = torch.ones(6, dtype=torch.bool), torch.zeros(6, dtype=torch.bool)


def variation(tree: ActionTree = TREE, *, crops: bool = True, mirror: bool = False) -> Variation:
    return Variation([tree], tree, torch.device("cpu"), crops=crops, mirror=mirror)


def variations(seed: int = 0) -> Tensor:
    return torch.rand(6, VARIATION_SIZE, generator=torch.Generator().manual_seed(seed))


def observed() -> dict[str, Tensor]:
    """Six looks of two stacked crops: a bright square left of the middle; the third is out of sight."""
    crops = torch.full((6, 2, 32, 32), 60, dtype=torch.uint8)
    crops[..., 10:22, 6:18] = 200
    target = torch.tensor([0.4, 0.5, 0.2, 0.3, 1.0]).repeat(6, 2, 1)
    crops[2], target[2] = 0, 0
    return {"frames": crops.flip(-1), "crops": crops, "target": target}


def test_crops_vary_and_nothing_else_does() -> None:
    observation = observed()
    varied = variation().look(observation, variations())
    assert varied["frames"] is observation["frames"]
    assert varied["target"] is observation["target"]
    crops = varied["crops"]
    assert (crops.shape, crops.dtype) == (observation["crops"].shape, torch.uint8)
    assert not crops[2].any(), "out of sight stays dark"
    assert torch.equal(observation["crops"], observed()["crops"]), "the recording is not written to"
    seen = crops[[0, 1, 3, 4, 5], 0].float()
    assert len({tuple(crop.flatten().tolist()) for crop in seen}) == len(seen), "each on its own"
    # The square is still there, left of the middle and brighter than what is around it.
    for crop in seen:
        inside = crop > (crop.min() + crop.max()) / 2
        assert 0.04 < inside.float().mean() < 0.35
        assert inside.nonzero()[:, 1].float().mean() < 20


def test_an_episode_varies_in_one_way() -> None:
    """Else a blocked move would be worth a second look at what is the same view."""
    some, generator = variation(), torch.Generator().manual_seed(0)
    before = some.draw(torch.zeros(6, VARIATION_SIZE), BEGIN, generator)
    assert torch.equal(some.draw(before, GO_ON, generator), before)
    ended = torch.tensor([True, False, False, False, False, True])
    after = some.draw(before, ended, generator)
    assert (after == before).all(1).tolist() == [False, True, True, True, True, False]
    one, other = (some.look(observed(), way)["crops"] for way in (before, after))
    assert (one == other).flatten(1).all(1).tolist() == [False, True, True, True, True, False]
    assert torch.equal(other[:, 0], other[:, 1]), "all stacked looks alike"


def test_a_frame_that_stands_for_a_crop_stays_as_it_is() -> None:
    observation = observed()
    observation["target"][3] = torch.tensor([0.5, 0.5, 1.0, 1.0, 1.0])
    crops = variation().look(observation, variations())["crops"]
    assert torch.equal(crops[3], observation["crops"][3])
    assert not torch.equal(crops[4], observation["crops"][4])


def test_a_mirror_flips_pictures_boxes_and_moves() -> None:
    plain, mirrored, drawn = variation(), variation(mirror=True), variations(3)
    straight, seen = plain.look(observed(), drawn), mirrored.look(observed(), drawn)
    everything = torch.arange(TREE.n).repeat(6, 1)
    called = torch.stack([mirrored.actions(column, drawn) for column in everything.T], 1)
    swapped = [TREE.index(*name) for name in (
        ("classify", "cup"), ("classify", "vase"), ("navigate", "forward"), ("navigate", "orbit_ccw_60"),
        ("navigate", "orbit_cw_60"), ("navigate", "right"), ("navigate", "left"),
    )]  # fmt: skip
    inside = [row == swapped for row in called.tolist()]
    assert 0 < sum(inside) < 6
    for i, flipped in enumerate(inside):
        assert called[i].tolist() == (swapped if flipped else list(range(TREE.n)))
        for name in ("frames", "crops"):
            expected = straight[name][i].flip(-1) if flipped else straight[name][i]
            assert torch.equal(seen[name][i], expected)
        x = 0.0 if i == 2 else 0.6 if flipped else 0.4  # the third is out of sight
        torch.testing.assert_close(seen["target"][i, :, 0], torch.full((2,), x))
        assert torch.equal(seen["target"][i, :, 1:], observed()["target"][i, :, 1:])
    # What is legal is called by the same names as what is done.
    mask = torch.rand(6, TREE.n) < 0.5
    mask_seen = mirrored.mask(mask, drawn)
    for column in everything.T:
        theirs = mask_seen.gather(1, column[:, None])
        assert torch.equal(theirs, mask.gather(1, mirrored.actions(column, drawn)[:, None]))


def test_where_nothing_is_to_vary_nothing_is_drawn() -> None:
    """Runs of worlds without crops stay what they were, to the bit."""
    observation, generator = observed(), torch.Generator().manual_seed(0)
    still, before, drawn = variation(crops=False), generator.get_state(), variations()
    assert not still.varies
    assert still.draw(drawn, BEGIN, generator) is drawn
    assert torch.equal(generator.get_state(), before)
    mask, actions = torch.ones(6, TREE.n) > 0, torch.arange(6)
    assert still.look(observation, drawn) is observation
    assert (still.mask(mask, drawn) is mask, still.actions(actions, drawn) is actions) == (True, True)


@pytest.mark.parametrize(
    ("moves", "missing"),
    [
        ({"navigate": ["rotate_cw"]}, "with 'rotate_cw' has no 'rotate_ccw'"),
        ({"navigate": ["left", "right", "orbit_ccw"]}, "with 'orbit_ccw' has no 'orbit_cw'"),
        ({"navigate": ["left"], "walk": ["right"]}, "with 'left' has no 'right'"),
    ],
)
def test_mirroring_a_move_without_its_opposite_is_one_sentence(
    moves: dict[str, list[str]], missing: str
) -> None:
    tree = ActionTree.answer_or_move(("cup",), moves)
    with pytest.raises(ConfigError, match=rf"{missing}; set train\.mirror=false, or add that move"):
        variation(tree, mirror=True)
    assert not variation(tree, crops=False).varies


def test_moves_of_every_branch_are_mirrored_and_classes_are_not() -> None:
    tree = ActionTree.answer_or_move(
        ("left", "right"), {"navigate": ["cw", "ccw"], "tilt": ["up", "left", "right"]}
    )
    some, drawn = variation(tree, crops=False, mirror=True), torch.zeros(tree.n, VARIATION_SIZE)
    names = [tree.names[i] for i in some.actions(torch.arange(tree.n), drawn)]
    assert [leaf for _, leaf in names] == ["left", "right", "ccw", "cw", "up", "right", "left"]
    assert [branch for branch, _ in names] == [branch for branch, _ in tree.names]


def test_dropout_leaves_out_its_share_and_keeps_the_mean() -> None:
    factors = kept((400, 256), 0.25, torch.Generator().manual_seed(0))
    assert factors.unique().tolist() == pytest.approx([0, 4 / 3])
    assert abs(factors.mean().item() - 1) < 0.01
