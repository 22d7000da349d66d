"""Players whose moves follow a fixed schedule, and whose network recognises: what a learned choice must beat.

They know where the cameras stand, which observations do not say, and nothing of the target.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.evaluate.players import Trained
from activelsd.policy.heads import ActionDistribution
from activelsd.policy.lsdnet import LSDNet

QUARTERS = ("orbit_ccw_90", "orbit_cw_90")
"""Moves by a quarter-turn, the preferred one first."""

_METRES_PER_DEGREE = 1e-3  # a whole turn on the spot counts less than a step


class Places:
    """How far apart the views of a graph are."""

    def __init__(self, graph: ViewGraph, device: torch.device) -> None:
        """Reads the cameras' directions or poses. Raises ConfigError if they are not known of every view."""
        if graph.directions is not None:
            azimuth, elevation = np.radians(graph.directions.astype(np.float64)).T
            flat = np.cos(elevation)
            places = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], 1)
            turns = np.zeros((len(places), 0))
        elif graph.poses is not None:
            places = graph.poses[:, :2].astype(np.float64)
            turns = graph.poses[:, 2::2].astype(np.float64)  # the heading, and in simulated rooms the tilt
        else:
            raise ConfigError(
                "This world does not say where its cameras stand; leave out spread and quarter."
            )
        unknown = int((~np.isfinite(places).all(1)).sum())
        if unknown:
            raise ConfigError(
                f"It is not known where {unknown} of {len(places)} views were taken; leave out spread and"
                " quarter."
            )
        self._around = graph.directions is not None
        self._places, self._turns = (torch.from_numpy(x).to(device) for x in (places, np.nan_to_num(turns)))

    def apart(self, one: Tensor, other: Tensor) -> Tensor:
        """Between views, int64 (...), of the same scene: degrees around the object, or metres in a room.

        In a room another heading at the same place counts too, but less than any step.
        """
        here, there = self._places[one], self._places[other]
        if self._around:
            cosine: Tensor = (here * there).sum(-1).clamp(-1, 1)
            return cosine.acos().rad2deg()
        turned: Tensor = ((self._turns[one] - self._turns[other] + 180) % 360 - 180).abs().sum(-1)
        metres: Tensor = (here - there).norm(dim=-1)
        return metres + _METRES_PER_DEGREE * turned


class Spread(Trained):
    """Makes the move that leads farthest from all views seen, the first of several; stops as the network.

    How far a view is from those seen is how far it is from the nearest of them, see `Places`.
    """

    name = "spread"

    def __init__(self, network: LSDNet, graph: ViewGraph, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        self._places = Places(graph, network.device)
        self._leads_to = torch.from_numpy(graph.moves.astype(np.int64)).to(network.device)

    def begin(self, batch: int) -> None:
        """Clears the memory and the views seen."""
        super().begin(batch)
        self._shown = torch.full((batch, 1), -1, device=self.network.device)  # views in order, then -1
        self._count = torch.zeros(batch, dtype=torch.int64, device=self.network.device)

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Takes the view that every episode is at; see `protocol.Insider`."""
        self._views = views

    def look(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> ActionDistribution:
        """Adds the view to those seen. See `Trained`."""
        policy = super().look(observation, mask, first)
        self._count = torch.where(first, 0, self._count)
        if int(self._count.max()) == self._shown.shape[1]:
            self._shown = pad(self._shown, (0, 1), value=-1)
        shown = self._shown.masked_fill(first[:, None], -1)
        self._shown = shown.scatter(1, self._count[:, None], self._views[:, None])
        self._count = self._count + 1
        return policy

    def move(self, mask: Tensor) -> Tensor:
        """See `Trained`."""
        legal, to = mask[:, self.moves], self._leads_to[self._views]
        apart = self._places.apart(to.clamp(min=0)[:, :, None], self._shown.clamp(min=0)[:, None])
        gaps = apart.masked_fill(self._shown[:, None] < 0, torch.inf).amin(-1).round(decimals=3)
        gaps = gaps.masked_fill(to < 0, -1.0).masked_fill(~legal, -2.0)  # what is blocked shows nothing new
        return gaps.argmax(1) + int(self.moves.start)


class Quarter(Spread):
    """Goes on by a quarter-turn while that shows a new view, then as `spread`."""

    name = "quarter"

    def __init__(self, network: LSDNet, graph: ViewGraph, seed: int = 0) -> None:
        super().__init__(network, graph, seed)
        found = [graph.move_names.index(name) for name in QUARTERS if name in graph.move_names]
        if not found:
            raise ConfigError(
                f"{self.name} needs the move {' or '.join(QUARTERS)}, and this world's are"
                f" {', '.join(graph.move_names)}; leave it out here."
            )
        self._quarter = found[0]

    def move(self, mask: Tensor) -> Tensor:
        """See `Trained`."""
        action = int(self.moves.start) + self._quarter
        to = self._leads_to[self._views, self._quarter]
        new = (to >= 0) & ~(to[:, None] == self._shown).any(1)
        return torch.where(new & mask[:, action], action, super().move(mask))
