"""Several worlds as one batch: one action tree for all of them, with each world's own rules and mask."""

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
    """A world that is ready to play: its recorded views and its rules."""

    name: str
    graph: ViewGraph
    rules: EpisodeRules
    backend: str = "recording"


def union(trees: Sequence[ActionTree]) -> ActionTree:
    """The tree of all branches and leaves, merged by name, in the order of first appearance."""
    branches: dict[str, list[str]] = {}
    for tree in trees:
        for branch, leaf in tree.names:
            leaves = branches.setdefault(branch, [])
            if leaf not in leaves:
                leaves.append(leaf)
    return ActionTree(branches)


class _IndexMaps(NamedTuple):
    """Index maps between one world's actions and classes and the joint ones."""

    joint_action: Tensor  # (n_world,) joint action of each world action
    world_action: Tensor  # (n,) world action of each joint one; n_world, out of range, if the world lacks it
    joint_label: Tensor  # (m_world + 1,) joint class of each world class; the last item maps -1 to -1


def _index_maps(world: ActionTree, joint: ActionTree, device: torch.device) -> _IndexMaps:
    joint_action = torch.tensor([joint.index(*name) for name in world.names], device=device)
    world_action = torch.full((joint.n,), world.n, device=device)
    world_action[joint_action] = torch.arange(world.n, device=device)
    label = joint_action[world.span(CLASSIFY)] - joint.span(CLASSIFY).start
    return _IndexMaps(joint_action, world_action, torch.cat([label, label.new_tensor([-1])]))


class JointVectorEnv:
    """Environments of several worlds as one batch, with the tensor interface of `ViewGraphVectorEnv`.

    The worlds' rows follow one another in the batch. Actions and labels are indices into the union of the
    worlds' trees; a row accepts only its own world's actions, and any other is an error. If some world has
    crops, a world without crops shows its frames instead, because its targets fill them.

    Attributes:
        parts: each world's own environments, by world name.
        places: the batch rows (a slice) of each world.
        tree: the union of the worlds' trees.
        num_envs: number of rows in the batch, B.
        device: device of all tensors.
    """

    def __init__(self, parts: Mapping[str, ViewGraphVectorEnv]) -> None:
        """Joins the worlds' environments.

        Raises:
            ConfigError: two worlds have frames of different sizes, or one is in gray and one in colour.
        """
        self.parts = dict(parts)
        envs = list(parts.values())
        sizes = {name: part.graph.size for name, part in parts.items()}
        if len(set(sizes.values())) > 1:
            each = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise ConfigError(
                f"Worlds played together need frames of one size, not {each} pixels; set env.size."
            )
        colours = {name: "gray" if part.graph.channels == 1 else "rgb" for name, part in parts.items()}
        if len(set(colours.values())) > 1:
            each = ", ".join(f"{name} {colour}" for name, colour in colours.items())
            raise ConfigError(
                f"Worlds played together need pictures of one colour, not {each}; set env.colour."
            )
        self.tree = union([part.tree for part in envs])
        self.device = envs[0].device
        self.num_envs = sum(part.num_envs for part in envs)
        ends = torch.tensor([part.num_envs for part in envs]).cumsum(0).tolist()
        self.places = {
            name: slice(end - part.num_envs, end)
            for (name, part), end in zip(parts.items(), ends, strict=True)
        }
        self._worlds = [
            (part, _index_maps(part.tree, self.tree, self.device), self.places[name])
            for name, part in parts.items()
        ]
        self._crops = any(part.graph.crops is not None for part in envs)

    def begin(self, seed: int) -> None:
        """Starts B episodes; row i draws the same ones as a single environment with seed `seed + i`."""
        for name, part in self.parts.items():
            part.begin(seed + self.places[name].start)

    def observe(self) -> dict[str, Tensor]:
        """`frames` uint8 (B, K C, S, S), `target` float32 (B, K, 5), and `crops` if any world has them."""
        seen = [part.observe() for part in self.parts.values()]
        shared = [name for name in seen[0] if name not in ("crops", "features")]
        observation = {name: torch.cat([one[name] for one in seen]) for name in shared}
        if "features" in seen[0]:
            found = [one["features"] for one in seen]
            most = max(one.shape[2] for one in found)
            # The frames of a world without crops have one cut, which stands for all.
            observation["features"] = torch.cat([one.repeat(1, 1, most // one.shape[2], 1) for one in found])
        elif self._crops:
            observation["crops"] = torch.cat([one.get("crops", one["frames"]) for one in seen])
        return observation

    @property
    def labels(self) -> Tensor:
        """(B,) int64 joint class of each target."""
        return torch.cat([maps.joint_label[part.labels] for part, maps, _ in self._worlds])

    def mask(self) -> Tensor:
        """(B, n) bool: the legal actions; another world's are False."""
        return self._to_joint([part.mask() for part in self.parts.values()])

    def nearer(self) -> Tensor:
        """(B, n) bool: the moves on a shortest path to a good view."""
        return self._to_joint([part.nearer() for part in self.parts.values()])

    def _to_joint(self, masks: Sequence[Tensor]) -> Tensor:
        """(B, n) bool joint mask from one mask (b, n_world) per world; missing actions are False."""
        joint = torch.zeros(self.num_envs, self.tree.n, dtype=torch.bool, device=self.device)
        for (_, maps, place), mask in zip(self._worlds, masks, strict=True):
            joint[place, maps.joint_action] = mask
        return joint

    def advance(self, actions: Tensor) -> Step:
        """Takes B joint actions (int64, (B,)); `row` indexes the starts of the row's own world."""
        steps = []
        for part, maps, place in self._worlds:
            # An action that the world lacks maps to an index out of range, so indexing raises.
            step = part.advance(maps.world_action[actions[place]])
            steps.append(step._replace(answer=maps.joint_label[step.answer]))
        return Step(*(torch.cat(column) for column in zip(*steps, strict=True)))

    def state(self) -> dict[str, Tensor]:
        """The state of all episodes, for `load_state`."""
        return {
            f"{world}/{name}": value
            for world, part in self.parts.items()
            for name, value in part.state().items()
        }

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Restores what `state` returned."""
        for world, part in self.parts.items():
            prefix = f"{world}/"
            part.load_state({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})


def shares(num_envs: int, worlds: int) -> list[int]:
    """Splits environments among worlds as evenly as possible; the first worlds get one more."""
    return [num_envs // worlds + (i < num_envs % worlds) for i in range(worlds)]


def play_recordings(
    worlds: Sequence[OpenWorld],
    *,
    num_envs: int,
    frames: int,
    device: str | torch.device = "cpu",
    pictures: Sequence[str] = ("frames", "crops"),
) -> ViewGraphVectorEnv | JointVectorEnv:
    """Environments of the training split, for one world or shared evenly among several.

    Observations hold the `pictures` named, and features, if there are any, in all variants.

    Raises:
        ConfigError: there are fewer environments than worlds, or the worlds' frames differ in size or colour.
        DataError: a world has no training episodes.
    """
    if num_envs < len(worlds):
        raise ConfigError(
            f"train.envs={num_envs} is too few for {len(worlds)} worlds; set it to at least {len(worlds)}."
        )
    parts = {
        world.name: ViewGraphVectorEnv(
            world.graph,
            world.rules,
            num_envs=share,
            frames=frames,
            backend=world.backend,
            device=device,
            pictures=pictures,
            variants=True,
        )
        for world, share in zip(worlds, shares(num_envs, len(worlds)), strict=True)
    }
    return JointVectorEnv(parts) if len(parts) > 1 else parts[worlds[0].name]
