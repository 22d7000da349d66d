"""Convolutional trunks: a stack of frames in, one feature vector out.

A trunk is a module made from the number of channels, the frames' side in pixels, and settings as keywords. It
has an attribute `features`, the width of its output, and takes uint8 (N, C, S, S). A `ViewTrunk` sees every
view by itself, so what it finds in one can be kept.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial

import torch
from torch import Tensor, nn

from activelsd.errors import ConfigError
from activelsd.policy.response_norm import LocalResponseNorm


def _conv_size(size: int, kernel: int, stride: int, padding: int) -> int:
    return (size + 2 * padding - kernel) // stride + 1


class AlexNet(nn.Module):
    """The paper's trunk (section 3.2, Figure 2): AlexNet's layers on 224 px, two layers of 4096 units.

    The text's kernels of depth 192 are AlexNet's two-group split; here the layers are whole.
    """

    features = 4096

    def __init__(self, channels: int, size: int) -> None:
        super().__init__()
        # The pools do not pad: at 63 px one pixel is left after the last.
        side = _conv_size(size, 11, 4, 2)
        for _ in range(3):
            side = _conv_size(side, 3, 2, 0)
        if side < 1:
            raise ConfigError(
                f"policy.trunk=alexnet needs env.size of at least 63 pixels, not {size}; set env.size=224."
            )
        norm = partial(LocalResponseNorm, size=5, alpha=1e-4, beta=0.75, k=2.0)
        self.convolutions = nn.Sequential(
            nn.Conv2d(channels, 64, 11, 4, 2),
            nn.ReLU(),
            norm(64),
            nn.MaxPool2d(3, 2),
            nn.Conv2d(64, 256, 5, 1, 2),
            nn.ReLU(),
            norm(256),
            nn.MaxPool2d(3, 2),
            nn.Conv2d(256, 384, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(384, 384, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(384, 256, 3, 1, 1),
            nn.ReLU(),
            nn.MaxPool2d(3, 2),
        )
        self.dense = nn.Sequential(
            nn.Linear(256 * side * side, 4096), nn.ReLU(), nn.Linear(4096, 4096), nn.ReLU()
        )

    def forward(self, frames: Tensor) -> Tensor:
        """uint8 (N, C, S, S) to (N, features), not negative."""
        features: Tensor = self.dense(self.convolutions(as_input(frames)).flatten(1))
        return features


class Blocks(nn.Module):
    """Turns blocks of 4 x 4 pixels into channels: `nn.PixelUnshuffle(4)`, on bytes in a sixth of the time."""

    SIDE = 4

    def forward(self, frames: Tensor) -> Tensor:
        """uint8, or float in [0, 1], (N, C, S, S) to float (N, 16 C, S / 4, S / 4), channels last."""
        n, channels, height, width = frames.shape
        rows, columns = height // self.SIDE, width // self.SIDE
        pixels = frames.dtype
        if pixels == torch.uint8 and not torch.compiler.is_compiling():
            # The four bytes of a block's row are moved as one word; a compiler does not need this.
            frames = frames.contiguous().view(torch.int32)
        squares = frames.reshape(n, channels, rows, self.SIDE, columns, -1).permute(0, 2, 4, 1, 3, 5)
        blocks = squares.contiguous().view(pixels).reshape(n, rows, columns, -1).permute(0, 3, 1, 2)
        return as_input(blocks) if pixels == torch.uint8 else blocks


class Compact(nn.Module):
    """A small trunk for 32 to 128 px that trains on a laptop: three convolutions and one dense layer.

    Blocks of 4 x 4 pixels first become 16 channels. The first layer is then a 12 x 12 convolution of stride 4
    in a form that is fast on a CPU: the trunk learns from about three times as many frames per second as one
    with strided convolutions on the pixels, and as well.
    """

    def __init__(self, channels: int, size: int, features: int = 256) -> None:
        super().__init__()
        block = Blocks.SIDE
        if size % block or size < 4 * block:
            near = max(4, round(size / block)) * block
            raise ConfigError(
                f"policy.trunk=compact needs env.size to be a multiple of 4, not {size}; set env.size={near}."
            )
        self.features = features
        side = size // block
        for _ in range(2):
            side = _conv_size(side, 3, 2, 1)
        self.convolutions = nn.Sequential(
            Blocks(),
            nn.Conv2d(channels * block**2, 32, 3, 1, 1),
            nn.ReLU(inplace=True),
            nn.Conv2d(32, 64, 3, 2, 1),
            nn.ReLU(inplace=True),
            nn.Conv2d(64, 64, 3, 2, 1),
            nn.ReLU(inplace=True),
        )
        self.dense = nn.Sequential(nn.Linear(64 * side * side, features), nn.ReLU())

    def forward(self, frames: Tensor) -> Tensor:
        """uint8, or float in [0, 1], (N, C, S, S) to (N, features), not negative."""
        features: Tensor = self.dense(self.convolutions(frames).flatten(1))
        return features


class ViewTrunk(nn.Module):
    """A trunk that sees every view by itself, and a neck that joins what it found in K of them.

    A subclass is made with `frames=K` beside its other settings, and defines `embed` and `digest`. If it is
    `frozen`, what `embed` returns is computed once for every picture of a recording and kept beside it, and
    only the neck is trained and stored in checkpoints.

    Attributes:
        features: width of its output.
        embedding: F, width of what it finds in a view.
        frozen: whether `embed` stays as it is.
        rate: learning rate of its own weights, the neck's aside, as a fraction of the others'.
        variants: how many cuts of every crop are recorded to vary it by, the plain one among them.
        free: names of settings in which a network may differ from the one that it starts from.
    """

    rate = 1.0
    variants = 1
    free: tuple[str, ...] = ()

    def __init__(self, frames: int, embedding: int, features: int, *, frozen: bool) -> None:
        super().__init__()
        self.frames, self.embedding, self.features, self.frozen = frames, embedding, features, frozen
        # What is found in a view may be negative, and the memory that pools takes 0 for the least.
        self.neck = nn.Sequential(nn.Linear(frames * embedding, features), nn.ReLU())

    @abstractmethod
    def embed(self, pictures: Tensor) -> Tensor:
        """uint8 (N, C, S, S) to float (N, F)."""

    @abstractmethod
    def digest(self) -> str:
        """Tells apart trunks whose `embed` differs; any text."""

    def forward(self, pictures: Tensor) -> Tensor:
        """uint8 (N, K C, S, S) to (N, features), not negative."""
        n, channels, height, width = pictures.shape
        views = pictures.reshape(n * self.frames, channels // self.frames, height, width)
        found = self.embed(views).view(n, self.frames, -1)
        # Recordings hold half precision; a world that is played live gets the same numbers.
        return self.join(found.half() if self.frozen else found)

    def join(self, found: Tensor) -> Tensor:
        """What was found in K views, (N, K, F), to (N, features)."""
        features: Tensor = self.neck(found.flatten(1).float())
        return features


def as_input(frames: Tensor) -> Tensor:
    """uint8 (N, C, S, S) to float in [0, 1], channels last, in which convolutions are fastest.

    One channel, too, has the strides of channels last; else convolutions take it for channels first.
    """
    rows = frames.permute(0, 2, 3, 1).to(torch.float32, memory_format=torch.contiguous_format)
    return rows.mul_(1.0 / 255.0).permute(0, 3, 1, 2)
