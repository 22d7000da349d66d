"""MVCNN: one trunk for every view, and the element-wise maximum over the views (Su et al. 2015).

https://arxiv.org/abs/1505.00880. Theirs is trained with all views of an object; here a set has one to all of
them, so that the same network also names objects by few views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from activelsd.envs.settings import Progress
from activelsd.evaluate.recognisers.interface import Recogniser, RecogniserSettings
from activelsd.evaluate.recognisers.objects import Objects
from activelsd.policy.lsdnet import make_trunk
from activelsd.policy.trunks import ViewTrunk


class MVCNNSettings(RecogniserSettings):
    """How MVCNN is trained."""

    updates: int = Field(2000, ge=0, description="updates at least")
    hidden: int = Field(512, ge=1, description="units behind the maximum")
    trained: float = Field(
        0.3,
        gt=0,
        le=1,
        description="share of the rate if a trunk is trained too, which may else learn nothing",
    )
    dropout: float = Field(0.5, ge=0, lt=1, description="of these units")


class MVCNN(Recogniser):
    """The run's kind of trunk for every view, the maximum, normalisation, two dense layers.

    A frozen trunk's recorded features are used; any other trunk is trained, from the weights that it is made
    with.
    """

    given = "images"
    published = 90.1
    Settings: ClassVar[type[RecogniserSettings]] = MVCNNSettings

    def __init__(
        self, objects: Objects, settings: RecogniserSettings, progress: Progress | None = None
    ) -> None:
        super().__init__(objects, settings, progress)
        assert isinstance(settings, MVCNNSettings)
        graph = objects.graph
        self._trunk: Any = None
        if graph.features is not None:
            self._seen: NDArray[np.generic] = graph.features[0]
            width = int(self._seen.shape[1])
        else:
            self._seen = graph.frames
            self._trunk = make_trunk(replace(objects.shape, frames=1, crops=False))
            width = self._trunk.embedding if isinstance(self._trunk, ViewTrunk) else self._trunk.features
        self.head = nn.Sequential(
            nn.LayerNorm(width),
            nn.Linear(width, settings.hidden),
            nn.ReLU(),
            nn.Dropout(settings.dropout),
            nn.Linear(settings.hidden, len(graph.classes)),
        )

    def looks_at(self) -> Sequence[NDArray[np.generic]]:
        """Features, or pictures."""
        return (self._seen,)

    def rates(self) -> list[dict[str, Any]]:
        """With a trunk that is trained too all learns slower, and the trunk slower still if it says so."""
        assert isinstance(self.settings, MVCNNSettings)
        rate = self.settings.rate
        if self._trunk is None:
            return [{"params": list(self.parameters()), "lr": rate}]
        rate *= self.settings.trained
        slow = self._trunk.rate if isinstance(self._trunk, ViewTrunk) else 1.0
        parts = ((self.head, rate), (self._trunk, rate * slow))
        return [{"params": list(part.parameters()), "lr": lr} for part, lr in parts]

    def forward(self, targets: Tensor, views: Tensor) -> Tensor:
        """See `Recogniser`."""
        present = views >= 0
        found = self._found(torch.from_numpy(self._seen[views[present].numpy()]).to(self.device))
        padded = found.new_full((*views.shape, found.shape[-1]), -torch.inf)
        padded[present.to(found.device)] = found
        logits: Tensor = self.head(padded.amax(1))
        return logits

    def _found(self, seen: Tensor) -> Tensor:
        """What the trunk finds in each of n pictures (n, [3,] S, S), or what it has found, float (n, F)."""
        if self._trunk is None:
            return seen.float()
        seen = seen[:, None] if seen.ndim == 3 else seen
        found: Tensor = self._trunk.embed(seen) if isinstance(self._trunk, ViewTrunk) else self._trunk(seen)
        return found
