"""The objects of a world as recognisers see them: each with its class, its split, and all its views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.settings import WorldSettings
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import ConfigError
from activelsd.policy.lsdnet import NetworkShape


@dataclass(frozen=True, kw_only=True, eq=False)
class Objects:
    """T objects with up to N views each.

    Attributes:
        graph: the world's views, with the features of the run's trunk if that is frozen.
        world: the world's settings, which know more of the objects than pictures show.
        shape: of the run's network, whose kind of trunk recognisers of pictures use.
    """

    graph: ViewGraph
    world: WorldSettings
    shape: NetworkShape

    def __post_init__(self) -> None:
        """Raise ConfigError if targets do not fill their frames, as in rooms."""
        if self.graph.pair_of is not None:
            raise ConfigError(
                f"Recognisers name an object by views of it alone, and env={self.world.name} shows rooms;"
                " leave them out, or take a run of env=modelnet."
            )

    @cached_property
    def views(self) -> Tensor:
        """int64 (T, N), the views of every object; rows of those with fewer end in -1."""
        scene = np.full(len(self.graph.targets), -1)
        scene[self.graph.start_target] = self.graph.scene_of[self.graph.start_view]
        counts = np.bincount(self.graph.scene_of, minlength=len(self.graph.scenes))
        order = np.argsort(self.graph.scene_of, kind="stable")
        firsts = np.cumsum(counts) - counts
        columns = np.arange(counts.max())
        places = np.minimum(firsts[scene][:, None] + columns, len(order) - 1)
        return torch.from_numpy(np.where(columns < counts[scene][:, None], order[places], -1))

    @cached_property
    def labels(self) -> Tensor:
        """int64 (T,), the class of every object."""
        return torch.from_numpy(np.array(self.graph.labels, np.int64))

    def of(self, split: str) -> Tensor:
        """int64 (n,), the objects of a split in order; none if it is empty."""
        rows = self.graph.start_split == SPLITS.index(split)
        return torch.from_numpy(np.unique(self.graph.start_target[rows]).astype(np.int64))

    def contents(self) -> Sequence[NDArray[np.generic]]:
        """Arrays that tell apart the objects' views, classes and splits, but not what the views show."""
        graph = self.graph
        return (self.views.numpy(), graph.labels, graph.start_target, graph.start_split)


def draw_sets(views: Tensor, generator: torch.Generator, count: int | None = None) -> Tensor:
    """Draws a set of views of every object, each view at most once.

    Args:
        views: int64 (B, N), as `Objects.views`.
        generator: of the draws.
        count: how many views a set has, or all there are if that is fewer; None: one to all, uniformly.

    Returns:
        int64 (B, N), in random order; -1 behind the last view of a set.
    """
    keys = torch.rand(views.shape, generator=generator).masked_fill(views < 0, 2.0)
    shuffled = views.gather(1, keys.argsort(1))
    there = (views >= 0).sum(1)
    if count is None:
        sizes = (torch.rand(len(views), generator=generator) * there).long() + 1
    else:
        sizes = there.clamp(max=count)
    return shuffled.masked_fill(torch.arange(views.shape[1]) >= sizes[:, None], -1)
