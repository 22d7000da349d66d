"""Random augmentation of episodes, so that the network learns the target and not its place.

A walk through few homes shows every instance in a few places only, and a network learns those by heart:
what is around the target, and how the light falls there. A variation is drawn per episode: if it were drawn
per view, a blocked move would be worth its price, since it would show the same view in another variation.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.errors import ConfigError

ZOOM, SQUEEZE, SHIFT = 0.25, 0.1, 0.15
"""Largest change of a crop's extent, of one side against the other, and of its centre, as fractions."""

CONTRAST, BRIGHTNESS = 0.8, 0.25
"""Largest change of contrast as an exponent of e, and of brightness as a fraction of white."""

_OPPOSITE = {"left": "right", "right": "left", "cw": "ccw", "ccw": "cw"}

VARIATION_SIZE = 8
"""Width of a variation, drawn per episode: extent, squeeze (2), shift (2), contrast, brightness, mirror."""


def in_mirror(move: str) -> str:
    """The opposite of a move in a mirror: left and right, cw and ccw exchanged, as in orbit_cw_60."""
    return "_".join(_OPPOSITE.get(word, word) for word in move.split("_"))


def kept(features: tuple[int, ...], dropout: float, generator: torch.Generator) -> Tensor:
    """Dropout's factors: 0 for a share of `dropout`, 1 / (1 - dropout) for the rest (Srivastava 2014)."""
    drawn = torch.rand(features, generator=generator, device=generator.device)
    return drawn.ge_(dropout).mul_(1 / (1 - dropout))


class Variation:
    """Augments what environments show: crops by margin and brightness, whole episodes by mirroring.

    A crop that is zeros, since the target is out of sight, stays so, and so does a frame that takes the place
    of a crop because the target fills it. Every other episode is mirrored: pictures, boxes and moves. If
    nothing varies, nothing is drawn.

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
        """Prepare the tables.

        Args:
            trees: each world's own actions.
            whole: the actions of all worlds, by whose indices masks and actions are given.
            device: of the observations.
            crops: whether to vary crops, which observations then must have.
            mirror: whether to mirror every other episode.

        Raises:
            ConfigError: episodes are to be mirrored, and a move has no opposite in its world.
        """
        if mirror:
            _check_opposites(trees)
        swapped = [
            whole.index(branch, in_mirror(leaf)) if branch != CLASSIFY and mirror else i
            for i, (branch, leaf) in enumerate(whole.names)
        ]
        self._swapped = torch.tensor(swapped, device=device)
        self._crops, self._mirrors = crops, mirror
        self.varies = crops or mirror

    def draw(self, variations: Tensor, first: Tensor, generator: torch.Generator) -> Tensor:
        """Variations (B, VARIATION_SIZE) in [0, 1): new ones where `first` (B,) begins an episode."""
        if not self.varies:
            return variations
        fresh = torch.rand(variations.shape, generator=generator, device=variations.device)
        return torch.where(first[:, None], fresh, variations)

    def look(self, observation: dict[str, Tensor], variations: Tensor) -> dict[str, Tensor]:
        """The observation, uint8 (B, K C, S, S) and boxes (B, K, 5), augmented; its input is unchanged."""
        if "features" in observation:
            observation = observation | {"features": self._variant(observation["features"], variations)}
        elif self._crops:
            varied = cut(observation["crops"], observation["target"], variations)
            observation = observation | {"crops": varied}
        return _mirrored(observation, variations) if self._mirrors else observation

    def _variant(self, features: Tensor, variations: Tensor) -> Tensor:
        """(B, K, F) of features (B, K, W, F): those of the cut and the mirror image that an episode has."""
        images = 2 if self._mirrors else 1
        cuts = features.shape[2] // images
        index = (variations[:, 0] * cuts).long() * images
        if self._mirrors:
            index = index + _is_mirrored(variations)
        return features[torch.arange(len(features), device=features.device), :, index]

    def actions(self, actions: Tensor, variations: Tensor) -> Tensor:
        """Swaps left and right in (B,) actions of mirrored episodes; applying it twice changes nothing."""
        if not self._mirrors:
            return actions
        return torch.where(_is_mirrored(variations), self._swapped[actions], actions)

    def mask(self, mask: Tensor, variations: Tensor) -> Tensor:
        """Swaps left and right in (B, n) masks over actions, such as the legal ones, of mirrored episodes."""
        if not self._mirrors:
            return mask
        return torch.where(_is_mirrored(variations)[:, None], mask[:, self._swapped], mask)


def _check_opposites(trees: Sequence[ActionTree]) -> None:
    for tree in trees:
        for branch, leaf in tree.names[tree.moves]:
            if (branch, in_mirror(leaf)) not in tree.names:
                raise ConfigError(
                    f"train.mirror=true needs the opposite of every move, and a world with '{leaf}' has no"
                    f" '{in_mirror(leaf)}'; set train.mirror=false, or add that move to the world's."
                )


def _is_mirrored(variations: Tensor) -> Tensor:
    return variations[:, -1] < 0.5


def cut(crops: Tensor, target: Tensor, variations: Tensor) -> Tensor:
    """Crops uint8 (B, K C, S, S) with another margin and another light, which is the same for all channels.

    Args:
        crops: of targets whose boxes `target` (B, K, 5) gives; where a box fills the frame, or the target is
            out of sight, the crop stays.
        target: the boxes.
        variations: (B, VARIATION_SIZE) in [0, 1).
    """
    between = 2 * variations[:, :-1] - 1
    extent, squeeze, shift, contrast, brightness = torch.split(between, [1, 2, 2, 1, 1], 1)
    scale = (1 + ZOOM * extent) * (1 + SQUEEZE * squeeze)
    where = functional.affine_grid(
        torch.cat([torch.diag_embed(scale), SHIFT * shift[:, :, None]], 2),
        list(crops.shape),
        align_corners=False,
    )
    cut = functional.grid_sample(crops.float() / 255, where, padding_mode="border", align_corners=False)
    cut = cut.view(*target.shape[:2], -1, *cut.shape[2:])  # (B, K, C, S, S)
    mean = cut.mean((2, 3, 4), keepdim=True)
    lit = (cut - mean) * (CONTRAST * contrast).exp()[..., None, None, None] + mean
    lit = lit + (BRIGHTNESS * brightness)[..., None, None, None]
    was_cut = ((target[..., 4] > 0) & (target[..., 2:4] < 1).any(-1))[..., None, None, None]
    new = torch.where(was_cut, (lit.clamp(0, 1) * 255).round().to(torch.uint8), crops.view(cut.shape))
    return new.flatten(1, 2)


def _mirrored(observation: dict[str, Tensor], variations: Tensor) -> dict[str, Tensor]:
    """Pictures and boxes, flipped in the mirrored episodes."""
    here = _is_mirrored(variations)
    # Copies whole rows at once; `torch.where` would choose byte by byte.
    rows = torch.arange(len(variations), device=variations.device) + len(variations) * here
    target = observation["target"].clone()
    flipped = torch.where(target[..., 4] > 0, 1 - target[..., 0], target[..., 0])
    target[..., 0] = torch.where(here[:, None], flipped, target[..., 0])
    pictures = {
        name: torch.cat([picture, picture.flip(-1)]).index_select(0, rows)
        for name, picture in observation.items()
        if name not in ("target", "features")  # features have a variant for it
    }
    return observation | pictures | {"target": target}
