"""What the policy keeps of earlier views: a stack of frames, an LSTM, or the maximum of view features."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from math import prod

import torch
from torch import Tensor, nn

State = dict[str, Tensor]
"""A memory's tensors by name, each (B, ...); there may be none."""


class Memory(nn.Module):
    """Turns features of views into features of the episode so far.

    A subclass takes the width of the trunk's features, and settings as keywords, sets the attributes, and
    writes `forward`.

    Attributes:
        outputs: width of what `forward` returns.
        shapes: shape of every tensor of the state, by name, without the batch.
    """

    outputs: int
    shapes: Mapping[str, tuple[int, ...]] = {}

    def initial(self, batch: int, device: str | torch.device = "cpu") -> State:
        """The state before any view: zeros."""
        return {name: torch.zeros(batch, *shape, device=device) for name, shape in self.shapes.items()}

    @abstractmethod
    def forward(self, features: Tensor, state: State, first: Tensor) -> tuple[Tensor, State]:
        """Run over L steps.

        Args:
            features: (L, B, F) float, not negative for this package's trunks.
            state: before the first step.
            first: (L, B) bool, true at an episode's first view, before which the state must be cleared.

        Returns:
            (L, B, outputs), and the state after the last step.
        """


def cleared(state: State, first: Tensor) -> State:
    """The state with zeros in the rows where `first` (B,) begins an episode."""
    return {name: x.masked_fill(first.view(-1, *[1] * (x.ndim - 1)), 0) for name, x in state.items()}


def split_state(tensor: Tensor, like: State) -> State:
    """A state from one tensor (B, width), as checkpoints of older versions hold it."""
    widths = [prod(x.shape[1:]) for x in like.values()]
    parts = torch.split(tensor, widths, 1) if widths else ()
    return {name: part.reshape(x.shape) for (name, x), part in zip(like.items(), parts, strict=True)}


class Stack(Memory):
    """No state: the last K frames are channels of the trunk's input (the paper's n = 3)."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.outputs = features

    def forward(self, features: Tensor, state: State, first: Tensor) -> tuple[Tensor, State]:
        """Returns the features unchanged."""
        return features, state


class Pool(Memory):
    """The running maximum of view features, as MVCNN pools views (Su 2015), beside the newest view's own.

    The class is recognised from the maximum; the newest view tells which way to go from here.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.outputs, self.shapes = 2 * features, {"maximum": (features,)}

    def forward(self, features: Tensor, state: State, first: Tensor) -> tuple[Tensor, State]:
        """No feature is below zero, so the maximum with a cleared state is the first view's features."""
        pooled = []
        for x, begins in zip(features, first, strict=True):
            state = {"maximum": torch.maximum(x, cleared(state, begins)["maximum"])}
            pooled.append(state["maximum"])
        return torch.cat([torch.stack(pooled), features], -1), state


class LSTM(Memory):
    """The paper's second model: a recurrent memory instead of stacked frames.

    The paper does not say how wide; A3C's own LSTM has 256 cells (Mnih 2016), and a cell per feature would
    give AlexNet's 4096 features 134 million weights.
    """

    CELLS = 256

    def __init__(self, features: int) -> None:
        super().__init__()
        cells = min(features, self.CELLS)
        self.cell = nn.LSTMCell(features, cells)
        self.outputs, self.shapes = cells, {"hidden": (cells,), "cell": (cells,)}

    def forward(self, features: Tensor, state: State, first: Tensor) -> tuple[Tensor, State]:
        """Returns the hidden state of every step."""
        outputs = []
        for x, begins in zip(features, first, strict=True):
            before = cleared(state, begins)
            hidden, cell = self.cell(x, (before["hidden"], before["cell"]))
            state = {"hidden": hidden, "cell": cell}
            outputs.append(hidden)
        return torch.stack(outputs), state
