"""The one schema of all settings: a run's config."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal

from pydantic import ConfigDict, Field, SerializeAsAny, model_validator

from activelsd import registry
from activelsd.envs.settings import WorldSettings
from activelsd.errors import ConfigError
from activelsd.policy.settings import PolicySettings
from activelsd.sections import ByName, Section
from activelsd.train.settings import TrainSettings

Split = Literal["train", "val", "test"]
JOINT: Final = "joint"

_BY_NAME = ByName(registry.worlds.get, "name", WorldSettings)
World = Annotated[SerializeAsAny[WorldSettings], _BY_NAME]
"""A world's settings; their class follows from the name."""


class JointSettings(Section):
    """Several worlds for one network, each one's settings below its own name, as in `env.modelnet.size`.

    `env=modelnet,avd` names them; a world from a file is called like the file, so `env=modelnet,mine.yaml`
    calls the second `mine`. A key that names no world, as in `env.size`, is for every world that has it.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, World] = Field(init=False)
    member: ClassVar[ByName] = _BY_NAME

    name: Literal["joint"] = Field(JOINT, description="several worlds at once")

    @property
    def worlds(self) -> dict[str, WorldSettings]:
        """Each world's settings by its own name."""
        return self.__pydantic_extra__

    @property
    def size(self) -> int:
        """Side of every world's frames in pixels."""
        return next(iter(self.worlds.values())).size

    @model_validator(mode="after")
    def _worlds_fit(self) -> JointSettings:
        if len(self.worlds) < 2:
            raise ConfigError("A joint run needs two worlds or more; name them as in env=modelnet,avd.")
        if len({world.size for world in self.worlds.values()}) > 1:
            sizes = " and ".join(f"env.{name}.size={world.size}" for name, world in self.worlds.items())
            raise ConfigError(f"One network needs frames of one size, not {sizes}; set env.size.")
        if len({world.colour for world in self.worlds.values()}) > 1:
            colours = " and ".join(f"env.{name}.colour={world.colour}" for name, world in self.worlds.items())
            raise ConfigError(f"One network needs pictures of one colour, not {colours}; set env.colour.")
        return self


def _world_or_worlds(name: str) -> type[Section]:
    found: type[Section] = JointSettings if name == JOINT else registry.worlds.get(name)
    return found


class EvaluateSettings(Section):
    """How players are measured."""

    split: Split = Field("test", description="which objects are played")
    episodes_per_object: int | None = Field(
        None, ge=1, description="random starts of every object; null: every start once"
    )
    seed: int = Field(0, ge=0, description="of random starts, players that draw, recognisers and resampling")
    epochs: int | None = Field(
        None, ge=1, description="passes in which recognisers are trained; null: as many as each takes itself"
    )


class RunConfig(Section):
    """Everything that, with the code, repeats a run."""

    name: str | None = Field(
        None, pattern=r"^[\w.+-]+$", description="name of the run's folder; null: its worlds' names"
    )
    seed: int = Field(0, ge=0, description="of weights, episodes and actions")
    device: Literal["auto", "cpu", "cuda"] = Field("auto", description="auto: cuda where there is one")
    threads: int | None = Field(None, ge=1, description="PyTorch's threads; null: its own choice, all cores")
    runs: Path = Field(Path("runs"), description="folder of runs")
    env: Annotated[
        SerializeAsAny[WorldSettings | JointSettings], ByName(_world_or_worlds, "name", WorldSettings)
    ] = Field(description="the world, or worlds by name")
    policy: PolicySettings = Field(PolicySettings(), description="the network")
    train: TrainSettings = Field(TrainSettings(), description="how it learns")
    evaluate: EvaluateSettings = Field(EvaluateSettings(), description="how players are measured")

    @property
    def worlds(self) -> dict[str, WorldSettings]:
        """The settings of every world by its name: one, or those of a joint run."""
        return self.env.worlds if isinstance(self.env, JointSettings) else {self.env.name: self.env}

    @property
    def title(self) -> str:
        """What the run's folder is called, behind the time."""
        return self.name or "+".join(self.worlds)

    def parts(self) -> Iterator[tuple[registry.Registry, str]]:
        """Every part that is found by name, with where it is found."""
        for world in self.worlds.values():
            yield from world.parts()
        yield registry.trunks, self.policy.trunk.kind
        yield registry.memories, self.policy.memory.kind
        yield from ((registry.terms, name) for name in self.train.terms)
        yield from ((registry.loggers, name) for name in self.train.loggers)

    @model_validator(mode="after")
    def _parts_fit(self) -> RunConfig:
        if self.train.actors == "ga3c" and len(self.worlds) > 1:
            raise ConfigError("train.actors=ga3c plays one world; for several set train.actors=resident.")
        if sys.platform == "win32" and self.train.actors == "ga3c" and self.train.ga3c.kind == "processes":
            raise ConfigError(
                "train.ga3c.kind=processes needs Linux or macOS; set train.ga3c.kind=threads, or leave out"
                " train.actors=ga3c."
            )
        for switch in ("amp", "compile", "cuda_graphs"):
            if getattr(self.train, switch) and self.train.actors != "resident":
                raise ConfigError(
                    f"train.{switch}=true is for train.actors=resident, whose acting pass is the learning"
                    " pass; leave it out."
                )
        if self.train.actors == "ray":
            if self.train.vtrace is False:
                raise ConfigError(
                    "train.vtrace=false would leave the lag of train.actors=ray uncorrected; leave it out."
                )
            if self.train.ray.envs_per_worker < len(self.worlds):
                raise ConfigError(
                    f"train.ray.envs_per_worker={self.train.ray.envs_per_worker} leaves a world of"
                    f" {len(self.worlds)} without any; set it to at least that."
                )
        return self
