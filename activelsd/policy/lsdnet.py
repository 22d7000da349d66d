"""LSD-Net (paper Figure 2): trunk, memory, a head that is a distribution over an action tree, a value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from activelsd import registry
from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.errors import ConfigError
from activelsd.policy.heads import ActionDistribution, Epsilon, FlatCategorical, TreeCategorical
from activelsd.policy.memories import State
from activelsd.policy.trunks import Compact, ViewTrunk, as_input


@dataclass(frozen=True, kw_only=True)
class NetworkShape:
    """What fixes an LSD-Net's parameters, beside its action tree; plain values that JSON holds.

    Attributes:
        trunk: name of the trunk.
        trunk_settings: the trunk's keyword arguments.
        memory: name of the memory.
        memory_settings: the memory's keyword arguments.
        head: `tree` or `flat`.
        size: side of the frames in pixels.
        frames: K, how many frames are stacked as channels.
        channels: C of each frame, 1 in gray and 3 in colour.
        crops: whether the trunk sees crops of the target, and `Surroundings` the whole frames.
        certainty: whether moving and stopping depend on `Certainty`.
    """

    trunk: str = "compact"
    trunk_settings: Mapping[str, Any] = field(default_factory=dict)
    memory: str = "pool"
    memory_settings: Mapping[str, Any] = field(default_factory=dict)
    head: str = "tree"
    size: int = 64
    frames: int = 1
    channels: int = 1
    crops: bool = False
    certainty: bool = False

    @property
    def inputs(self) -> int:
        """K C, the channels of the trunk's input."""
        return self.frames * self.channels


class Output(NamedTuple):
    """The network's output for L x B observations, float32."""

    logits: Tensor  # (L, B, branches + n) for a tree, (L, B, n) flat
    value: Tensor  # (L, B)
    features: Tensor  # (L, B, network.trunk.features) of the trunk
    state: State  # of the memory after the last step, each (B, ...)
    policy: ActionDistribution | None = None  # with mask and epsilon; set by the learner, for loss terms


def joined(outputs: Sequence[Output]) -> Output:
    """The output for all steps, from those for consecutive ones."""
    logits, value, features = (torch.cat(parts) for parts in list(zip(*outputs, strict=True))[:3])
    return Output(logits, value, features, outputs[-1].state)


class Surroundings(nn.Module):
    """Looks at whole frames in order to move: where the target is, and what stands in the way.

    It adds nothing to the logits of classes: a network that may name a target by the room around it learns
    its training rooms by heart, and fails in others. Its outputs begin at zero and are added to the head's.
    """

    SIZE, FEATURES = 32, 64
    """Side in pixels to which frames are averaged, and width of their features."""

    def __init__(self, frames: int, channels: int, outputs: int) -> None:
        """Build for K stacked frames, and for as many outputs as there are logits and values to add to."""
        super().__init__()
        self.trunk = Compact(frames * channels, self.SIZE, self.FEATURES)
        self.join = nn.Sequential(nn.Linear(self.FEATURES + 5 * frames, self.FEATURES), nn.ReLU())
        self.outputs = nn.Linear(self.FEATURES, outputs)
        nn.init.zeros_(self.outputs.weight)
        nn.init.zeros_(self.outputs.bias)

    def forward(self, frames: Tensor, target: Tensor) -> Tensor:
        """uint8 (N, K C, S, S) and boxes float (N, 5 K) to (N, outputs)."""
        small = functional.interpolate(as_input(frames), size=(self.SIZE, self.SIZE), mode="area")
        outputs: Tensor = self.outputs(self.join(torch.cat([self.trunk(small), target], 1)))
        return outputs


class Certainty(nn.Module):
    """Lets moving and stopping depend on how sure of the class the network is.

    Whether another view is worth its price is a question of certainty, which no linear layer can read from
    the features. No gradient goes back to the classes. Its outputs begin at zero, as `Surroundings`' do.
    """

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.outputs = nn.Linear(3, outputs)
        nn.init.zeros_(self.outputs.weight)
        nn.init.zeros_(self.outputs.bias)

    def forward(self, classes: Tensor) -> Tensor:
        """Logits of the classes (..., m) to (..., outputs)."""
        log_p = classes.detach().float().log_softmax(-1)
        likely = log_p.topk(min(2, log_p.shape[-1]), -1).values.exp()
        entropy = -(log_p.exp() * log_p).sum(-1, keepdim=True)
        sure = torch.cat([likely[..., :1], likely[..., :1] - likely[..., -1:], entropy], -1)
        outputs: Tensor = self.outputs(sure)
        return outputs


def sees_by_view(trunk: str) -> bool:
    """Whether the trunk of a name is a `ViewTrunk`."""
    part = registry.trunks.get(trunk)
    return isinstance(part, type) and issubclass(part, ViewTrunk)


def make_trunk(shape: NetworkShape) -> Any:
    """The trunk of a network's shape, with fresh weights where it is trained.

    Raises:
        ConfigError: its name is unknown, or it cannot be made so.
    """
    make = registry.trunks.get(shape.trunk)
    with registry.trunks.blaming(shape.trunk, "cannot be made"):
        if sees_by_view(shape.trunk):
            trunk = make(shape.channels, shape.size, frames=shape.frames, **shape.trunk_settings)
        else:
            trunk = make(shape.inputs, shape.size, **shape.trunk_settings)
        trunk.features = int(trunk.features)
        return trunk


class LSDNet(nn.Module):
    """Looks at a stack of views, and answers or moves.

    If the world gives crops of targets, trunk and memory see the crops, and `Surroundings` the frames.
    """

    def __init__(self, tree: ActionTree, shape: NetworkShape) -> None:
        """Build with fresh weights, from torch's global generator.

        Raises:
            ConfigError: a part's name is unknown, or the trunk cannot take frames of this size.
        """
        super().__init__()
        if shape.head not in ("tree", "flat"):
            raise ConfigError(f"There is no head '{shape.head}'; choose tree or flat.")
        self.tree, self.shape = tree, shape
        memory = registry.memories.get(shape.memory)
        self.trunk = make_trunk(shape)
        with registry.memories.blaming(shape.memory, "cannot be made"):
            self.memory = memory(self.trunk.features, **shape.memory_settings)
            inputs = self.memory.outputs + 5 * shape.frames
        branches = len(tree.branches) if shape.head == "tree" else 0
        self.policy = nn.Linear(inputs, branches + tree.n)
        self.value = nn.Linear(inputs, 1)
        # With small logits every branch and leaf begins near uniform, as the paper asks for.
        with torch.no_grad():
            self.policy.weight.mul_(0.1)
            self.policy.bias.zero_()
        steering = branches + tree.n - tree.sizes[tree.branches.index(CLASSIFY)]
        self.surroundings = Surroundings(shape.frames, shape.channels, steering + 1) if shape.crops else None
        self.certainty = Certainty(steering + 1) if shape.certainty else None
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def device(self) -> torch.device:
        """The device of the weights."""
        return self.value.weight.device

    @torch.no_grad()
    def check_parts(self) -> None:
        """Run trunk and memory on two blank views, to check what those of other packages return.

        Raises:
            BrokenPartError: one fails, or returns something of another shape than it must.
        """
        shape, trunks, memories = self.shape, registry.trunks, registry.memories
        views = torch.zeros(2, shape.inputs, shape.size, shape.size, dtype=torch.uint8, device=self.device)
        self.eval()
        with trunks.blaming(shape.trunk, "fails on a blank view"):
            frozen = self.frozen_trunk
            if frozen is None:
                features = self.trunk(views)
            else:  # its net need not be built where all features are recorded
                features = frozen.join(views.new_zeros(2, shape.frames, frozen.embedding))
            if features.shape != (2, self.trunk.features):
                wanted = f"must return (N, {self.trunk.features}), its `features`"
                raise trunks.broken(
                    shape.trunk, f"returns {tuple(features.shape)} for N = 2 views and {wanted}"
                )
        with memories.blaming(shape.memory, "fails on a blank view"):
            before = self.initial_state(2)
            outputs, after = self.memory(features[None], before, views.new_ones(1, 2, dtype=torch.bool))
            shapes = [{name: tuple(x.shape) for name, x in state.items()} for state in (before, after)]
            if outputs.shape != (1, 2, self.memory.outputs) or shapes[0] != shapes[1]:
                found = f"returns {tuple(outputs.shape)} and the state {shapes[1]}"
                wanted = (
                    f"must return {(1, 2, self.memory.outputs)} and {shapes[0]}, its `outputs` and `shapes`"
                )
                raise memories.broken(shape.memory, f"{found} and {wanted}")
        self.train()

    @property
    def class_logits(self) -> slice:
        """Where the classes are among the logits."""
        span, branches = self.tree.span(CLASSIFY), self.policy.out_features - self.tree.n
        return slice(branches + span.start, branches + span.stop)

    @property
    def frozen_trunk(self) -> ViewTrunk | None:
        """The trunk, if what it finds in a view never changes; its features may be recorded then."""
        return self.trunk if isinstance(self.trunk, ViewTrunk) and self.trunk.frozen else None

    @property
    def slow(self) -> list[str]:
        """Names of the parameters that learn at the trunk's own rate, a `ViewTrunk`'s but for its neck."""
        if not isinstance(self.trunk, ViewTrunk):
            return []
        own = (name for name, _ in self.trunk.named_parameters() if not name.startswith("neck."))
        return [f"trunk.{name}" for name in own]

    @property
    def pictures(self) -> tuple[str, ...]:
        """The pictures that it needs where features of its trunk are recorded."""
        return ("frames",) if self.surroundings is not None else ()

    def initial_state(self, batch: int) -> State:
        """The memory's state before any view."""
        state: State = self.memory.initial(batch, self.device)
        return state

    def forward(self, observation: Mapping[str, Tensor], state: State, first: Tensor) -> Output:
        """Run over L steps of B episodes.

        Args:
            observation: `frames` uint8 (L, B, K C, S, S), `target` (L, B, K, 5), `crops` like frames; if a
                world has none, its frames take their place, since the target fills them. Of a frozen
                trunk, `features` float16 (L, B, K, F) may take the place of the pictures it is shown. In
                training also `dropout` float (L, B, memory.outputs), factors for the memory's outputs.
            state: of the memory before the first step.
            first: (L, B) bool, true where an episode begins.
        """
        target = observation["target"].flatten(2)
        if "features" in observation:
            features = self.trunk.join(observation["features"].flatten(0, 1)).unflatten(0, first.shape)
        else:
            crops = self.shape.crops and "crops" in observation
            pictures = observation["crops" if crops else "frames"]
            features = self.trunk(pictures.flatten(0, 1)).unflatten(0, first.shape)
        remembered, after = self.memory(features, state, first)
        if "dropout" in observation:
            remembered = remembered * observation["dropout"]
        joined = torch.cat([remembered, target], -1)
        logits, value = self.policy(joined), self.value(joined).squeeze(-1)
        # What is added to all logits except those of the classes, and to the value.
        start, stop = self.class_logits.start, self.class_logits.stop
        steering: list[Tensor] = []
        if self.surroundings is not None:
            frames = observation["frames"].flatten(0, 1)
            steering.append(self.surroundings(frames, target.flatten(0, 1)).unflatten(0, first.shape))
        if self.certainty is not None:
            steering.append(self.certainty(logits[..., start:stop]))
        for added in steering:
            ahead, behind = added[..., :start], added[..., start:-1]
            logits = torch.cat(
                [logits[..., :start] + ahead, logits[..., start:stop], logits[..., stop:] + behind], -1
            )
            value = value + added[..., -1]
        # Under autocast the pass is in bfloat16; losses are computed, and states kept, in full precision.
        after = {name: x.to(state[name].dtype) for name, x in after.items()}
        return Output(logits.float(), value.float(), features.float(), after)

    def distribution(self, logits: Tensor, mask: Tensor, epsilon: Epsilon = Epsilon()) -> ActionDistribution:
        """The policy for logits (..., *), with mask bool (..., n)."""
        if self.shape.head == "flat":
            return FlatCategorical(self.tree, logits, mask, epsilon)
        branches = len(self.tree.branches)
        return TreeCategorical(self.tree, logits[..., :branches], logits[..., branches:], mask, epsilon)
