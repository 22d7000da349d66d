"""What a recogniser is: a network that is trained on a world's objects and names sets of their views."""

from __future__ import annotations

import hashlib
import inspect
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from activelsd.envs.digest import code_digest
from activelsd.envs.settings import Progress
from activelsd.evaluate.recognisers.objects import Objects
from activelsd.sections import Section

_CHUNK = 128
"""Objects that are named at once."""


class RecogniserSettings(Section):
    """How a recogniser is trained; one with other settings has a subclass."""

    epochs: int = Field(30, ge=1, description="passes over the training objects")
    updates: int = Field(1000, ge=0, description="updates at least: few objects are passed over more often")
    batch: int = Field(32, ge=1, description="objects in a batch")
    rate: float = Field(1e-3, gt=0, description="learning rate at first; it falls to 0 along half a cosine")
    decay: float = Field(1e-4, ge=0, description="weight decay, apart from the gradient as in AdamW")
    smoothing: float = Field(0.1, ge=0, lt=1, description="label smoothing")


class ShapeSettings(RecogniserSettings):
    """How a recogniser of shapes is trained, which learns in fewer passes than one of pictures."""

    epochs: int = Field(15, ge=1, description="passes over the training objects")


class Training(NamedTuple):
    """How a training went."""

    seconds: float
    epoch: int  # whose weights are kept, from 1
    losses: Sequence[float]  # mean of each epoch
    val: Sequence[float]  # accuracy after each epoch on validation objects; empty if there are none


class Recogniser(nn.Module):
    """Names objects by sets of their views.

    A subclass defines `forward` and `looks_at`, and `fit` if it is not trained by gradients. Its constructor
    raises ConfigError if the world does not have what it needs.

    Set by a subclass:
        given: what it is given of an object, as tables say it.
        published: its accuracy in per cent in the paper's Table 2; None if it is not there.
        whole: it is given the whole shape, and no views.
        Settings: the class of its settings.
    """

    given: ClassVar[str] = "images"
    published: ClassVar[float | None] = None
    whole: ClassVar[bool] = False
    Settings: ClassVar[type[RecogniserSettings]] = RecogniserSettings

    def __init__(
        self, objects: Objects, settings: RecogniserSettings, progress: Progress | None = None
    ) -> None:
        """Take the objects and make fresh weights from torch's global generator.

        Args:
            objects: to be trained on, and to be named.
            settings: of the class `Settings`.
            progress: called while what it looks at is prepared.
        """
        super().__init__()
        self.objects, self.settings = objects, settings

    @abstractmethod
    def forward(self, targets: Tensor, views: Tensor) -> Tensor:
        """Logits (B, C) of objects `targets` (B,) seen in `views` (B, N), int64, -1 for none, on the CPU."""

    @abstractmethod
    def looks_at(self) -> Sequence[NDArray[np.generic]]:
        """The arrays that it looks at, which its weights depend on."""

    def fit(self, *, seed: int, progress: Progress | None = None) -> Training:
        """Train on the objects of `train` and keep the epoch that names most of `val`.

        Args:
            seed: of all draws.
            progress: called with the batches done and all of them.
        """
        from activelsd.evaluate.recognisers.fitting import fit

        return fit(self, seed=seed, progress=progress)

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return next(self.parameters()).device

    @property
    def counts(self) -> tuple[int, ...]:
        """How many views the sets have that it is measured with: all, 3 and 1; (0,) for the whole shape."""
        most = self.objects.views.shape[1]
        return (0,) if self.whole else tuple(dict.fromkeys((most, min(3, most), 1)))

    def rates(self) -> list[dict[str, Any]]:
        """Its parameters in groups as optimisers take them, with their learning rates."""
        return [{"params": list(self.parameters()), "lr": self.settings.rate}]

    def size(self) -> int:
        """The number of parameters that are trained."""
        return sum(one.numel() for one in self.parameters() if one.requires_grad)

    @torch.inference_mode()
    def probabilities(self, targets: Tensor, views: Tensor) -> Tensor:
        """Probabilities (n, C) of the classes of objects (n,) seen in sets of views (n, N), on the CPU."""
        self.eval()
        chunks = zip(torch.split(targets, _CHUNK), torch.split(views, _CHUNK), strict=True)
        return torch.cat([self(*chunk).float().softmax(-1).cpu() for chunk in chunks])

    def digest(self, seed: int) -> str:
        """Tells apart trainings that end in other weights: by the data, the settings, the seed, the code."""
        module, told = type(self).__module__, self.settings.model_dump(mode="json")
        code = inspect.getsource(type(self)) if module == "__main__" else code_digest(module)
        said = (type(self).__qualname__, told, seed, code, self.objects.graph.classes)
        content = hashlib.sha256(repr((said, self.objects.shape, self.size())).encode())
        for array in (*self.objects.contents(), *self.looks_at()):
            content.update(repr((array.shape, array.dtype)).encode())
            for start in range(0, len(array), 4096):
                content.update(np.ascontiguousarray(array[start : start + 4096]).tobytes())
        return content.hexdigest()[:20]
