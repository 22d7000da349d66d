"""What the policy keeps of earlier views: a stack of frames, an LSTM, or the maximum of view features."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import torch
from torch import Tensor, nn

from activelsd.errors import ConfigError


class Memory(nn.Module):
    """Turns features of views into features of an episode so far.

    Attributes:
        outputs: width of what it gives.
        width: width of the state carried between rollouts, (B, width) float32, zeros at the start.
    """

    outputs: int
    width: int

    @abstractmethod
    def forward(self, features: Tensor, state: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
        """Run over L steps.

        Args:
            features: (L, B, F) not negative.
            state: (B, width) as it was before the first step.
            first: (L, B) bool, where an episode's first view stands; the state is cleared there.

        Returns:
            (L, B, outputs), and the state after the last step.
        """


class Stack(Memory):
    """No state: the last K frames are channels of the trunk's input (the paper's n = 3)."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.outputs, self.width = features, 0

    def forward(self, features: Tensor, state: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
        """Features as they are."""
        return features, state


class Pool(Memory):
    """The running maximum of view features, as MVCNN pools views (Su 2015), beside the newest view's own.

    The maximum is what recognises; the newest view tells which way to go from here.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.outputs, self.width = 2 * features, features

    def forward(self, features: Tensor, state: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
        """Zeros are the least a feature can be, so a cleared state leaves the first view's features."""
        pooled = []
        for x, begins in zip(features, first, strict=True):
            state = torch.maximum(x, state.masked_fill(begins[:, None], 0.0))
            pooled.append(state)
        return torch.cat([torch.stack(pooled), features], -1), state


class LSTM(Memory):
    """The paper's second model: a recurrent memory in place of stacked frames.

    The paper does not say how wide; A3C's own LSTM has 256 cells (Mnih 2016), and a cell per feature would
    give AlexNet's 4096 features 134 million weights.
    """

    CELLS = 256

    def __init__(self, features: int) -> None:
        super().__init__()
        cells = min(features, self.CELLS)
        self.cell = nn.LSTMCell(features, cells)
        self.outputs, self.width = cells, 2 * cells

    def forward(self, features: Tensor, state: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
        """The state is hidden and cell side by side."""
        outputs = []
        for x, begins in zip(features, first, strict=True):
            hidden, cell = self.cell(x, state.masked_fill(begins[:, None], 0.0).chunk(2, -1))
            state = torch.cat([hidden, cell], -1)
            outputs.append(hidden)
        return torch.stack(outputs), state


def make_memory(name: str, features: int) -> Memory:
    """A memory by name."""
    kinds: dict[str, Callable[[int], Memory]] = {"stack": Stack, "pool": Pool, "lstm": LSTM}
    if name not in kinds:
        raise ConfigError(f"There is no memory '{name}'; choose one of {', '.join(kinds)}.")
    return kinds[name](features)
