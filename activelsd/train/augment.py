"""Episodes varied at random while learning, so that what is learned is the target and not its place.

A walk through few homes shows every instance in a few places only, and a network learns those by heart:
what is around the target, and how the light falls there. An episode's variation stays what it is to its end.
One drawn anew at every look would make a blocked move worth its price, as a second look at the same view.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from activelsd.envs.actions import NAVIGATE, ActionTree

ZOOM, SQUEEZE, SHIFT = 0.25, 0.1, 0.15
"""Most change of a crop's extent, of one side against the other, and of its middle, as fractions."""

CONTRAST, BRIGHTNESS = 0.8, 0.25
"""Most change of contrast as an exponent of e, and of brightness as a fraction of white."""

_OPPOSITE = {"left": "right", "right": "left", "cw": "ccw", "ccw": "cw"}

VARIATION_SIZE = 8
"""Numbers that say how an episode varies: extent, squeeze (2), shift (2), contrast, brightness, mirror."""


def in_mirror(move: str) -> str:
    """What a move is called in a mirror: its name with left for right and cw for ccw, as in orbit_cw_60."""
    return "_".join(_OPPOSITE.get(word, word) for word in move.split("_"))


def kept(features: tuple[int, ...], dropout: float, generator: torch.Generator) -> Tensor:
    """Factors of features: 0 for a share of `dropout`, more than 1 for the rest (Srivastava et al. 2014)."""
    drawn = torch.rand(features, generator=generator, device=generator.device)
    return (drawn >= dropout) / (1 - dropout)


class Variation:
    """How episodes differ from what their environments show.

    Crops of targets are cut and lit a little otherwise. Those of targets out of sight are zeros and stay so,
    and what was not cut stays as it is too: a frame that stands for the crop of a target that fills it. Every
    other episode is seen in a mirror, pictures, boxes and moves. Where nothing is to vary, nothing is drawn.

    Attributes:
        varies: whether anything does.
    """

    def __init__(
        self,
        trees: Sequence[ActionTree],
        whole: ActionTree,
        device: torch.device,
        *,
        crops: bool,
        mirror: bool,
    ) -> None:
        """Prepare.

        Args:
            trees: each world's own actions.
            whole: the actions of all, by whose numbers masks and actions are given.
            device: where observations are.
            crops: whether observations have crops, and these are to vary.
            mirror: whether to mirror, where every world has the opposite of each of its moves.
        """
        leaves = [{leaf for branch, leaf in tree.names if branch == NAVIGATE} for tree in trees]
        self._mirrors = mirror and all(in_mirror(leaf) in own for own in leaves for leaf in own)
        swapped = [
            whole.index(branch, in_mirror(leaf)) if branch == NAVIGATE and self._mirrors else i
            for i, (branch, leaf) in enumerate(whole.names)
        ]
        self._swapped = torch.tensor(swapped, device=device)
        self._crops = crops
        self.varies = crops or self._mirrors

    def ways(self, ways: Tensor, first: Tensor, generator: torch.Generator) -> Tensor:
        """(B, VARIATION_SIZE) in [0, 1): drawn anew where `first` (B,) begins an episode, else kept."""
        if not self.varies:
            return ways
        fresh = torch.rand(ways.shape, generator=generator, device=ways.device)
        return torch.where(first[:, None], fresh, ways)

    def look(self, observation: dict[str, Tensor], ways: Tensor) -> dict[str, Tensor]:
        """The observation, uint8 (B, K, S, S) and boxes (B, K, 5), varied; nothing is written to."""
        if self._crops:
            observation = observation | {"crops": _cut(observation, ways)}
        return _mirrored(observation, ways) if self._mirrors else observation

    def actions(self, actions: Tensor, ways: Tensor) -> Tensor:
        """(B,) int64 actions chosen in the mirror as what they are behind it, and the other way round."""
        return torch.where(_in_mirror(ways), self._swapped[actions], actions) if self._mirrors else actions

    def mask(self, mask: Tensor, ways: Tensor) -> Tensor:
        """(B, n) bool legal actions, as they are called in the mirror."""
        if not self._mirrors:
            return mask
        return torch.where(_in_mirror(ways)[:, None], mask[:, self._swapped], mask)


def _in_mirror(ways: Tensor) -> Tensor:
    return ways[:, -1] < 0.5


def _cut(observation: dict[str, Tensor], ways: Tensor) -> Tensor:
    """Crops cut and lit otherwise."""
    crops, target = observation["crops"], observation["target"]
    batch, stacked = crops.shape[:2]
    between = 2 * ways[:, :-1] - 1
    extent, squeeze, shift, contrast, brightness = torch.split(between, [1, 2, 2, 1, 1], 1)
    scale = (1 + ZOOM * extent) * (1 + SQUEEZE * squeeze)
    where = functional.affine_grid(
        torch.cat([torch.diag_embed(scale), SHIFT * shift[:, :, None]], 2),
        [batch, stacked, *crops.shape[2:]],
        align_corners=False,
    )
    cut = functional.grid_sample(crops.float() / 255, where, padding_mode="border", align_corners=False)
    mean = cut.mean((2, 3), keepdim=True)
    lit = (cut - mean) * (CONTRAST * contrast).exp()[..., None, None] + mean
    lit = lit + (BRIGHTNESS * brightness)[..., None, None]
    was_cut = ((target[..., 4] > 0) & (target[..., 2:4] < 1).any(-1))[..., None, None]
    return torch.where(was_cut, (lit.clamp(0, 1) * 255).round().to(torch.uint8), crops)


def _mirrored(observation: dict[str, Tensor], ways: Tensor) -> dict[str, Tensor]:
    """Pictures and boxes of the episodes in the mirror flipped."""
    here = _in_mirror(ways)
    # Whole rows are copied at once, where `torch.where` would choose byte by byte.
    rows = torch.arange(len(ways), device=ways.device) + len(ways) * here
    target = observation["target"].clone()
    flipped = torch.where(target[..., 4] > 0, 1 - target[..., 0], target[..., 0])
    target[..., 0] = torch.where(here[:, None], flipped, target[..., 0])
    pictures = {
        name: torch.cat([picture, picture.flip(-1)]).index_select(0, rows)
        for name, picture in observation.items()
        if name != "target"
    }
    return pictures | {"target": target}
