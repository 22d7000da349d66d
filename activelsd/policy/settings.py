"""The settings of the network, and of its parts that are found by name."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, SerializeAsAny

from activelsd import registry
from activelsd.sections import AbsolutePath, ByName, Part, Section


class TrunkSettings(Part):
    """A trunk that is as wide as asked for: the compact one, and others without settings of their own."""

    kind: str = Field("compact", description="compact, alexnet (the paper's), or one of another package")
    features: Annotated[int, Field(ge=8)] = Field(256, description="width of its output")


class AlexNetSettings(Part):
    """The paper's trunk, whose width is fixed."""


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
    init: AbsolutePath | None = Field(
        None,
        description="run or checkpoint to take the weights of known actions from; null: fresh weights",
    )
