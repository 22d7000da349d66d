"""The settings of the network, and of its parts that are found by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, SerializeAsAny, model_validator

from activelsd import registry
from activelsd.errors import ConfigError
from activelsd.sections import AbsolutePath, ByName, Part, Section


class TrunkSettings(Part):
    """A trunk that is as wide as asked for: the compact one, and others without settings of their own."""

    kind: str = Field(
        "compact", description="compact, alexnet (the paper's), timm:NAME, or one of another package"
    )
    features: Annotated[int, Field(ge=8)] = Field(256, description="width of its output")


class AlexNetSettings(Part):
    """The paper's trunk, whose width is fixed."""


class TimmSettings(Part):
    """A net of timm, with weights from a file; a neck that is always trained stands behind it."""

    advice: ClassVar[Mapping[str, Any]] = {
        "policy.certainty": True,
        "train.dropout": 0.5,
        "train.mirror": True,
    }

    features: Annotated[int, Field(ge=8)] = Field(512, description="width of its output, the neck's")
    weights: AbsolutePath | None = Field(
        None, description="file of weights, or the folder that holds it; null: fresh weights"
    )
    download: bool = Field(False, description="without a file: let timm download the weights")
    freeze: Literal["all", "none"] | Annotated[int, Field(ge=1)] = Field(
        "all", description="what is not trained: all, none, or that many stages from the input"
    )
    rate: float = Field(0.1, gt=0, le=1, description="learning rate of what is trained of it, of the heads'")
    input: Annotated[int, Field(ge=32, le=1024)] | None = Field(
        None, description="side to which views are scaled for it, in pixels; null: its own"
    )
    variants: int = Field(
        4, ge=1, le=16, description="frozen: how many cuts of every crop are recorded to vary it by"
    )

    def check(self) -> None:
        """Raise ConfigError if there are no weights where they should be."""
        if self.weights is not None:
            from activelsd.policy.weights import find_weights  # settings are read before PyTorch is imported

            find_weights(self.weights)

    @model_validator(mode="after")
    def _not_fresh_and_frozen(self) -> TimmSettings:
        if self.weights is None and not self.download and self.freeze != "none":
            raise ConfigError(
                f"{self.kind} has no weights, and fresh ones must not be frozen; name a file by"
                " policy.trunk.weights=FILE, or set policy.trunk.freeze=none to train it from nothing."
            )
        return self


class MemorySettings(Part):
    """A memory without settings of its own."""

    kind: str = Field("pool", description="stack, lstm, pool (the maximum over views), or another package's")


def _trunk(name: str) -> type[Section]:
    return registry.trunks.settings(name) or TrunkSettings


def _memory(name: str) -> type[Section]:
    return registry.memories.settings(name) or MemorySettings


Trunk = Annotated[SerializeAsAny[Part], ByName(_trunk, "kind", Part)]
Memory = Annotated[SerializeAsAny[Part], ByName(_memory, "kind", Part)]


class PolicySettings(Section):
    """The network."""

    trunk: Trunk = Field(TrunkSettings(), description="what sees")
    memory: Memory = Field(MemorySettings(), description="what is kept of earlier views")
    frames: int = Field(
        1, ge=1, le=12, description="K, the last views stacked as channels; the paper's 3 for stack"
    )
    head: Literal["tree", "flat"] = Field(
        "tree", description="branch then leaf, or one softmax over all actions"
    )
    certainty: bool = Field(
        False, description="moving and stopping may depend on how sure of the class the network is"
    )
    init: AbsolutePath | None = Field(
        None,
        description="run or checkpoint to take the weights of known actions from; null: fresh weights",
    )
