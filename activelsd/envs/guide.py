"""Which moves lead nearer to a good look, for many episodes at once, beside the network."""

from __future__ import annotations

import torch
from torch import Tensor

from activelsd.envs.oracle import moves_to_go
from activelsd.envs.viewgraph import ViewGraph


class Guide:
    """The shortest ways of a graph to views that show its targets well."""

    def __init__(self, graph: ViewGraph, device: torch.device) -> None:
        """Find them; targets need boxes."""
        self._away = torch.from_numpy(moves_to_go(graph)).to(device)
        self._leads = torch.from_numpy(graph.moves).to(device).long()

    def nearer(self, views: Tensor, targets: Tensor) -> Tensor:
        """(B, moves) bool, of views and targets (B,); none where the view is one, or none can be reached."""
        leads = self._leads[views]
        away = self._away[leads, targets[:, None]]  # a blocked move finds some other view's: left out
        return (leads >= 0) & (away >= 0) & (away < self._away[views, targets][:, None])
