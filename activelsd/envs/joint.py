"""Several worlds played as one batch: one tree of all their actions, each world's own rules and mask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.envs.episode import EpisodeRules
from activelsd.envs.vector import Step, ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError


class OpenWorld(NamedTuple):
    """A world to play: its recorded views and the rules there."""

    name: str
    graph: ViewGraph
    rules: EpisodeRules
    backend: str = "recording"


def union(trees: Sequence[ActionTree]) -> ActionTree:
    """The tree of all branches and leaves by name, in the order in which they first appear."""
    branches: dict[str, list[str]] = {}
    for tree in trees:
        for branch, leaf in tree.names:
            leaves = branches.setdefault(branch, [])
            if leaf not in leaves:
                leaves.append(leaf)
    return ActionTree(branches)


class _Names(NamedTuple):
    """A world's numbers among those of all worlds, and back."""

    action: Tensor  # (n_world,) its actions in the tree of all
    own_action: Tensor  # (n,) the tree's actions in the world's; n_world, which is none, where it has not it
    label: Tensor  # (m_world + 1,) its classes among all classes; the last, -1 for "no class"


def _names(tree: ActionTree, whole: ActionTree, device: torch.device) -> _Names:
    action = torch.tensor([whole.index(*name) for name in tree.names], device=device)
    own = torch.full((whole.n,), tree.n, device=device)
    own[action] = torch.arange(tree.n, device=device)
    label = action[tree.span(CLASSIFY)] - whole.span(CLASSIFY).start
    return _Names(action, own, torch.cat([label, label.new_tensor([-1])]))


class JointVectorEnv:
    """Environments of several worlds as one batch, with the tensor face of `ViewGraphVectorEnv`.

    The batch is world after world. Actions and labels are numbered by the union of the worlds' trees, and in
    every row only its own world's actions are legal; any other is an error. Where one world has crops, a
    world without them shows its frames in their place: its targets fill them.

    Attributes:
        parts: each world's own environments, by its name.
        places: the rows of the batch that each world has.
        tree: the union of their trees.
        num_envs: rows of the batch, B.
        device: of all tensors.
    """

    def __init__(self, parts: Mapping[str, ViewGraphVectorEnv]) -> None:
        """Put environments side by side.

        Raises:
            ConfigError: the frames of two worlds differ in size.
        """
        self.parts = dict(parts)
        envs = list(parts.values())
        sizes = {name: part.graph.size for name, part in parts.items()}
        if len(set(sizes.values())) > 1:
            said = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise ConfigError(
                f"Worlds played together need frames of one size, not {said} pixels; set env.size."
            )
        self.tree = union([part.tree for part in envs])
        self.device = envs[0].device
        self.num_envs = sum(part.num_envs for part in envs)
        ends = torch.tensor([part.num_envs for part in envs]).cumsum(0).tolist()
        self.places = {
            name: slice(end - part.num_envs, end)
            for (name, part), end in zip(parts.items(), ends, strict=True)
        }
        self._names = [_names(part.tree, self.tree, self.device) for part in envs]
        self._crops = any(part.graph.crops is not None for part in envs)

    def begin(self, seed: int) -> None:
        """Start B episodes; row i's stream is that of a single environment seeded with `seed + i`."""
        for name, part in self.parts.items():
            part.begin(seed + self.places[name].start)

    def observe(self) -> dict[str, Tensor]:
        """`frames` uint8 (B, K, S, S), `target` float32 (B, K, 5), and `crops` where one world has them."""
        seen = [part.observe() for part in self.parts.values()]
        observation = {name: torch.cat([one[name] for one in seen]) for name in ("frames", "target")}
        if self._crops:
            observation["crops"] = torch.cat([one.get("crops", one["frames"]) for one in seen])
        return observation

    @property
    def labels(self) -> Tensor:
        """(B,) int64 class of each target, among the classes of all worlds."""
        return torch.cat([names.label[part.labels] for part, names in self._pairs()])

    def mask(self) -> Tensor:
        """(B, n) bool: the legal actions, none of another world among them."""
        return self._among_all([part.mask() for part in self.parts.values()])

    def nearer(self) -> Tensor:
        """(B, n) bool: the moves on the shortest way to a good look."""
        return self._among_all([part.nearer() for part in self.parts.values()])

    def _among_all(self, own: Sequence[Tensor]) -> Tensor:
        """(B, n) bool from each world's own (b, actions); false for the actions that a world has not."""
        found = torch.zeros(self.num_envs, self.tree.n, dtype=torch.bool, device=self.device)
        for names, place, of_world in zip(self._names, self.places.values(), own, strict=True):
            found[place, names.action] = of_world
        return found

    def advance(self, actions: Tensor) -> Step:
        """Take B actions (int64, (B,)); `row` is of each world's own starts."""
        steps = []
        for (part, names), place in zip(self._pairs(), self.places.values(), strict=True):
            # An action that the world has not is a number past its last, at which indexing fails.
            step = part.advance(names.own_action[actions[place]])
            steps.append(step._replace(answer=names.label[step.answer]))
        return Step(*(torch.cat(column) for column in zip(*steps, strict=True)))

    def state(self) -> dict[str, Tensor]:
        """Where every episode stands, so that `load_state` goes on from here."""
        return {
            f"{world}/{name}": value
            for world, part in self.parts.items()
            for name, value in part.state().items()
        }

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Take back what `state` gave."""
        for world, part in self.parts.items():
            own = f"{world}/"
            part.load_state({k.removeprefix(own): v for k, v in tensors.items() if k.startswith(own)})

    def _pairs(self) -> zip[tuple[ViewGraphVectorEnv, _Names]]:
        return zip(self.parts.values(), self._names, strict=True)


def shares(num_envs: int, worlds: int) -> list[int]:
    """As even a share of environments as can be for each of several worlds."""
    return [num_envs // worlds + (i < num_envs % worlds) for i in range(worlds)]


def play_recordings(
    worlds: Sequence[OpenWorld], *, num_envs: int, frames: int, device: str | torch.device = "cpu"
) -> ViewGraphVectorEnv | JointVectorEnv:
    """Environments of the training split: of one world alone, or of several with as even a share each.

    Raises:
        ConfigError: there are fewer environments than worlds, or the worlds do not fit together.
        DataError: a world has nothing to train on.
    """
    if num_envs < len(worlds):
        raise ConfigError(
            f"train.envs={num_envs} leaves a world of {len(worlds)} without any; set it to at least that."
        )
    parts = {}
    for world, share in zip(worlds, shares(num_envs, len(worlds)), strict=True):
        parts[world.name] = ViewGraphVectorEnv(
            world.graph,
            world.rules,
            num_envs=share,
            split="train",
            frames=frames,
            backend=world.backend,
            device=device,
        )
    return JointVectorEnv(parts) if len(parts) > 1 else parts[worlds[0].name]
