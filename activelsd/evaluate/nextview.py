"""Players that go where depth would tell most, as 3D ShapeNets chooses its next view (Wu et al. 2015).

They begin with one depth view, keep voxels, name by the recogniser `shapenets`, and answer when it is sure of
a class. Theirs completes the unseen part by Gibbs sampling in its deep belief net; here the training objects
that disagree least with the seen voxels stand for what there may be.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.recognisers.interface import Recogniser
from activelsd.evaluate.recognisers.shapenets import ShapeNets
from activelsd.evaluate.stops import SURE
from activelsd.policy.lsdnet import LSDNet
from activelsd.scenery.voxels import SIDE, SURFACE, UNSEEN

COMPLETIONS = 5
"""Training objects that stand for what there may be."""

TAU = 0.01
"""Fraction of the seen voxels in disagreement by which a completion counts e times less than another."""

_CHUNK = 128


class NextView:
    """Moves to the view with the least score among those that a move leads to and it has not seen.

    It answers when it is sure of a class, or no move leads to such a view. A subclass defines `scores`.

    Attributes:
        net: the recogniser.
        grids: uint8 (B, SIDE³), what every episode has seen, as `scenery.voxels` has it.
    """

    name = ""
    frames = 1
    recogniser = "shapenets"

    def __init__(self, network: LSDNet, graph: ViewGraph, seed: int = 0) -> None:
        self._classes, self._columns = network.tree.span(CLASSIFY), network.tree.moves
        self._leads_to = torch.from_numpy(graph.moves.astype("int64"))

    def take(self, recogniser: Recogniser) -> None:
        """See `protocol.Recognising`."""
        assert isinstance(recogniser, ShapeNets)
        self.net = recogniser.eval()

    def begin(self, batch: int) -> None:
        """Forgets all that was seen."""
        self.grids = torch.zeros(batch, SIDE**3, dtype=torch.uint8)
        self._seen = torch.zeros(batch, len(self.net.cameras.levels), dtype=torch.bool)

    def tell(self, views: Tensor, targets: Tensor) -> None:
        """Takes the view that every episode is at; see `protocol.Insider`."""
        self._views = views.cpu()

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        """Returns the likeliest class, or the move to the best next view."""
        begins = first.cpu()
        self.grids[begins], self._seen[begins] = UNSEEN, False
        self.grids = self.grids.maximum(self.net.states(self._views[:, None]))
        self._seen.scatter_(1, self.net.camera_of[self._views][:, None], True)
        found = probabilities(self.net, self.grids)
        self._answer = found.argmax(-1).to(mask.device)

        after = self._leads_to[self._views]
        cameras = self.net.camera_of[after.clamp(min=0)]
        fresh = mask[:, self._columns].cpu() & (after >= 0) & ~self._seen.gather(1, cameras)
        goes = (found.amax(-1) < SURE) & fresh.any(1)
        scores = torch.full(fresh.shape, torch.inf)
        rows, columns = (fresh & goes[:, None]).nonzero(as_tuple=True)
        if len(rows):
            scores[rows, columns] = self.scores(rows, cameras[rows, columns])
        moves = scores.argmin(1) + int(self._columns.start)
        return torch.where(goes.to(mask.device), moves.to(mask.device), self._answer + self._classes.start)

    def answer(self) -> Tensor:
        """Returns the likeliest class given all that was seen, int64 (B,)."""
        return self._answer

    @abstractmethod
    def scores(self, rows: Tensor, cameras: Tensor) -> Tensor:
        """Scores (n,) of going on to cameras (n,) in the episodes `rows` (n,); the least is the best."""


class MostUnseen(NextView):
    """Goes where the most unseen voxels come into sight, if there is nothing but the surface seen so far."""

    name = "most_unseen"

    def scores(self, rows: Tensor, cameras: Tensor) -> Tensor:
        """See `NextView`."""
        return -self.net.coarse.unseen_in_sight(self.grids[rows], cameras).float()


class ExpectedEntropy(NextView):
    """Goes where the least entropy of the class is to be expected, going by similar training objects."""

    name = "expected_entropy"

    def begin(self, batch: int) -> None:
        """Forgets all that was seen; reads the training objects at first."""
        super().begin(batch)
        self._known = Completions(self.net)

    def scores(self, rows: Tensor, cameras: Tensor) -> Tensor:
        """See `NextView`."""
        # The completions depend on the episode alone, not on the camera.
        different, which = torch.unique(rows, return_inverse=True)
        objects, weights = self._known.nearest(self.grids[different])
        states = self._known.states(objects[which], cameras)
        return expected_entropies(self.net, self.grids[rows], states, weights[which])


class Completions:
    """The training objects, to be found by a part of their voxels."""

    def __init__(self, net: ShapeNets) -> None:
        objects = net.objects
        self._net, train = net, objects.of("train")
        own = objects.views[train]
        self._views = torch.full((len(train), len(net.cameras.levels)), -1)
        there = (own >= 0).nonzero(as_tuple=True)
        self._views[there[0], net.camera_of[own[there]]] = own[there]
        states = (_sample(net.states(some)) for some in torch.split(own, _CHUNK))
        self._surface = torch.cat([one == SURFACE for one in states]).float()

    def nearest(self, grids: Tensor) -> tuple[Tensor, Tensor]:
        """The objects that disagree least with what is seen of grids (B, SIDE³), and their weights, (B, K).

        Disagreement is the fraction of the seen voxels that are surface in one and not in the other.
        """
        sample = _sample(grids)
        seen, surface = (sample != UNSEEN).float(), (sample == SURFACE).float()
        apart = surface.sum(1, keepdim=True) + (seen - 2 * surface) @ self._surface.T
        least = (apart / seen.sum(1, keepdim=True).clamp(min=1)).topk(
            min(COMPLETIONS, len(self._surface)), largest=False
        )
        return least.indices, (-least.values / TAU).softmax(-1)

    def states(self, objects: Tensor, cameras: Tensor) -> Tensor:
        """What objects (n, K) would tell to cameras (n,), uint8 (n, K, SIDE³)."""
        views = self._views[objects, cameras[:, None]]
        return self._net.states(views.reshape(-1, 1)).view(*objects.shape, -1)


def expected_entropies(net: ShapeNets, grids: Tensor, states: Tensor, weights: Tensor) -> Tensor:
    """The entropy of the class to be expected after one more view, (n,).

    Args:
        net: the recogniser.
        grids: uint8 (n, SIDE³), what is seen so far.
        states: uint8 (n, K, SIDE³), what the view would tell of each of K completions.
        weights: (n, K), of the completions; they add up to 1.
    """
    after = grids[:, None].maximum(states)
    return (weights * entropies(probabilities(net, after.flatten(0, 1))).view(weights.shape)).sum(1)


def entropies(probabilities: Tensor) -> Tensor:
    """Entropies (n,) of distributions (n, C), in nats."""
    summed: Tensor = torch.special.entr(probabilities).sum(-1)
    return summed


@torch.inference_mode()
def probabilities(net: ShapeNets, grids: Tensor) -> Tensor:
    """Probabilities (n, C) of the classes of grids (n, SIDE³), on the CPU."""
    return torch.cat([net.classify(some).softmax(-1).cpu() for some in torch.split(grids, _CHUNK)])


def _sample(grids: Tensor) -> Tensor:
    """Every second voxel along each side, (n, (SIDE / 2)³): enough to tell shapes apart."""
    return grids.view(-1, SIDE, SIDE, SIDE)[:, ::2, ::2, ::2].flatten(1)
