"""LSD-Net (paper Figure 2): trunk, memory, a head that is a distribution over an action tree, a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.errors import ConfigError
from activelsd.policy.heads import ActionDistribution, Epsilon, FlatCategorical, TreeCategorical
from activelsd.policy.memories import make_memory
from activelsd.policy.trunks import Compact, as_input, make_trunk


@dataclass(frozen=True, kw_only=True)
class NetworkShape:
    """What fixes an LSD-Net's parameters, beside its action tree.

    Attributes:
        trunk: `compact` or `alexnet`.
        memory: `stack`, `lstm` or `pool`.
        head: `tree` or `flat`.
        size: side of the frames in pixels.
        frames: K, how many frames are stacked as channels.
        crops: whether it looks at crops of the target, and at frames for what is around it.
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
    """What the network says of L x B observations, float32."""

    logits: Tensor  # (L, B, branches + n) for a tree, (L, B, n) flat
    value: Tensor  # (L, B)
    state: Tensor  # (B, width) memory after the last step


class Surroundings(nn.Module):
    """What whole frames say for moving: where the target is in them, and what stands in the way.

    Classes are none of its business: a network that may name a target by the room around it learns the rooms
    it is trained in by heart, and is lost in others. Its outputs begin at zero and are added to the head's.
    """

    SIZE, FEATURES = 32, 64
    """Pixels to which frames are averaged, and width of what they are summed up in."""

    def __init__(self, frames: int, outputs: int) -> None:
        """For K stacked frames, and as many outputs as there are logits and values to add to."""
        super().__init__()
        self.trunk = Compact(frames, self.SIZE, self.FEATURES)
        self.join = nn.Sequential(nn.Linear(self.FEATURES + 5 * frames, self.FEATURES), nn.ReLU())
        self.outputs = nn.Linear(self.FEATURES, outputs)
        nn.init.zeros_(self.outputs.weight)
        nn.init.zeros_(self.outputs.bias)

    def forward(self, frames: Tensor, target: Tensor) -> Tensor:
        """uint8 (N, K, S, S) and boxes float (N, 5 K) to (N, outputs)."""
        small = functional.interpolate(as_input(frames), size=(self.SIZE, self.SIZE), mode="area")
        outputs: Tensor = self.outputs(self.join(torch.cat([self.trunk(small), target], 1)))
        return outputs


class LSDNet(nn.Module):
    """Look at a stack of views, and answer or move.

    Where targets are cut out of frames, trunk and memory see the crops, and `Surroundings` the frames.
    """

    def __init__(self, tree: ActionTree, shape: NetworkShape) -> None:
        """Build with fresh weights, from torch's global generator.

        Raises:
            ConfigError: a part's name is unknown, or the frames do not fit the trunk.
        """
        super().__init__()
        if shape.head not in ("tree", "flat"):
            raise ConfigError(f"There is no head '{shape.head}'; choose tree or flat.")
        self.tree, self.shape = tree, shape
        self.trunk = make_trunk(shape.trunk, shape.frames, shape.size, shape.features)
        self.memory = make_memory(shape.memory, self.trunk.features)
        inputs = self.memory.outputs + 5 * shape.frames
        branches = len(tree.branches) if shape.head == "tree" else 0
        self.policy = nn.Linear(inputs, branches + tree.n)
        self.value = nn.Linear(inputs, 1)
        # Small first logits: every branch and leaf begins near uniform, as the paper wants of the tree.
        with torch.no_grad():
            self.policy.weight.mul_(0.1)
            self.policy.bias.zero_()
        steering = branches + tree.n - tree.sizes[tree.branches.index(CLASSIFY)]
        self.surroundings = Surroundings(shape.frames, steering + 1) if shape.crops else None
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def initial_state(self, batch: int) -> Tensor:
        """(batch, width) the memory before any view."""
        return torch.zeros(batch, self.memory.width, device=self.value.weight.device)

    def forward(self, observation: Mapping[str, Tensor], state: Tensor, first: Tensor) -> Output:
        """Run over L steps of B episodes.

        Args:
            observation: `frames` uint8 (L, B, K, S, S), `target` (L, B, K, 5), `crops` like frames; where
                a world cuts none, its frames stand for them, since the target fills them. While learning
                also `dropout` float (L, B, width), factors of what the memory gives.
            state: (B, width) memory before the first step.
            first: (L, B) bool, where an episode begins.
        """
        frames, target = observation["frames"], observation["target"].flatten(2)
        pictures = observation.get("crops", frames) if self.shape.crops else frames
        features = self.trunk(pictures.flatten(0, 1)).unflatten(0, first.shape)
        remembered, state = self.memory(features, state, first)
        if "dropout" in observation:
            remembered = remembered * observation["dropout"]
        joined = torch.cat([remembered, target], -1)
        logits, value = self.policy(joined), self.value(joined).squeeze(-1)
        if self.surroundings is not None:
            around = self.surroundings(frames.flatten(0, 1), target.flatten(0, 1)).unflatten(0, first.shape)
            # All logits but the classes', which stand together.
            span, branches = self.tree.span(CLASSIFY), logits.shape[-1] - self.tree.n
            start, stop = branches + span.start, branches + span.stop
            ahead, behind = around[..., :start], around[..., start:-1]
            logits = torch.cat(
                [logits[..., :start] + ahead, logits[..., start:stop], logits[..., stop:] + behind], -1
            )
            value = value + around[..., -1]
        # What is made of them is of full precision, whatever the pass was of.
        return Output(logits.float(), value.float(), state.float())

    def distribution(self, logits: Tensor, mask: Tensor, epsilon: Epsilon = Epsilon()) -> ActionDistribution:
        """The policy over actions that logits (..., *) stand for, with mask bool (..., n)."""
        if self.shape.head == "flat":
            return FlatCategorical(self.tree, logits, mask, epsilon)
        branches = len(self.tree.branches)
        return TreeCategorical(self.tree, logits[..., :branches], logits[..., branches:], mask, epsilon)
