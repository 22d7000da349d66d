"""LSD-Net (paper Figure 2): trunk, memory, a head that is a distribution over an action tree, a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from activelsd.envs.actions import ActionTree
from activelsd.errors import ConfigError
from activelsd.policy.heads import ActionDistribution, Epsilon, FlatCategorical, TreeCategorical
from activelsd.policy.memory import make_memory
from activelsd.policy.trunk import as_input, make_trunk


@dataclass(frozen=True, kw_only=True)
class NetworkShape:
    """What fixes an LSD-Net's parameters, beside its action tree.

    Attributes:
        trunk: `compact` or `alexnet`.
        memory: `stack`, `lstm` or `pool`.
        head: `tree` or `flat`.
        size: side of the frames in pixels.
        frames: K, how many frames are stacked as channels.
        crops: whether crops of the target stand beside the frames.
        features: width of the compact trunk's output.
    """

    trunk: str = "compact"
    memory: str = "pool"
    head: str = "tree"
    size: int = 64
    frames: int = 1
    crops: bool = False
    features: int = 256


class Output(NamedTuple):
    """What the network says of L x B observations."""

    logits: Tensor  # (L, B, branches + n) for a tree, (L, B, n) flat
    value: Tensor  # (L, B)
    state: Tensor  # (B, width) memory after the last step


class LSDNet(nn.Module):
    """Look at a stack of views, and answer or move."""

    def __init__(self, tree: ActionTree, shape: NetworkShape) -> None:
        """Build with fresh weights, from torch's global generator.

        Raises:
            ConfigError: a part's name is unknown, or the frames do not fit the trunk.
        """
        super().__init__()
        if shape.head not in ("tree", "flat"):
            raise ConfigError(f"There is no head '{shape.head}'; choose tree or flat.")
        self.tree, self.shape = tree, shape
        channels = shape.frames * (2 if shape.crops else 1)
        self.trunk = make_trunk(shape.trunk, channels, shape.size, shape.features)
        self.memory = make_memory(shape.memory, self.trunk.features)
        inputs = self.memory.outputs + 5 * shape.frames
        branches = len(tree.branches) if shape.head == "tree" else 0
        self.policy = nn.Linear(inputs, branches + tree.n)
        self.value = nn.Linear(inputs, 1)
        # Small first logits: every branch and leaf begins near uniform, as the paper wants of the tree.
        with torch.no_grad():
            self.policy.weight.mul_(0.1)
            self.policy.bias.zero_()
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def initial_state(self, batch: int) -> Tensor:
        """(batch, width) the memory before any view."""
        return torch.zeros(batch, self.memory.width, device=self.value.weight.device)

    def forward(self, observation: Mapping[str, Tensor], state: Tensor, first: Tensor) -> Output:
        """Run over L steps of B episodes.

        Args:
            observation: `frames` uint8 (L, B, K, S, S), `target` (L, B, K, 5), `crops` like frames; where
                a world cuts none, its frames stand for them, since the target fills them.
            state: (B, width) memory before the first step.
            first: (L, B) bool, where an episode begins.
        """
        pictures = observation["frames"]
        if self.shape.crops:
            pictures = torch.cat([pictures, observation.get("crops", pictures)], 2)
        features = self.trunk(as_input(pictures.flatten(0, 1))).unflatten(0, first.shape)
        remembered, state = self.memory(features, state, first)
        joined = torch.cat([remembered, observation["target"].flatten(2)], -1)
        return Output(self.policy(joined), self.value(joined).squeeze(-1), state)

    def distribution(self, logits: Tensor, mask: Tensor, epsilon: Epsilon = Epsilon()) -> ActionDistribution:
        """The policy over actions that logits (..., *) stand for, with mask bool (..., n)."""
        if self.shape.head == "flat":
            return FlatCategorical(self.tree, logits, mask, epsilon)
        branches = len(self.tree.branches)
        return TreeCategorical(self.tree, logits[..., :branches], logits[..., branches:], mask, epsilon)
