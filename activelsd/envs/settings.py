"""What every world's settings are: the class that a world is, to the command line and to Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, runtime_checkable

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from activelsd import registry
from activelsd.errors import ConfigError, DataError, did_you_mean
from activelsd.sections import AbsolutePath, Colour, Section

if TYPE_CHECKING:  # settings are read, and complained of, before NumPy is imported
    import numpy as np
    from numpy.typing import NDArray

    from activelsd.envs.base import ActiveVisionEnv
    from activelsd.envs.episode import EpisodeRules
    from activelsd.envs.viewgraph import ViewGraph
    from activelsd.scenery.depths import Depths

_GEOMETRY = "env=modelnet knows them of meshes, points and the embedded shapes."

Progress = Callable[[int, int], None]
"""Called with what is done and what there is in all."""


def stage(progress: Progress | None, what: str) -> Progress:
    """Progress of a part that has a title and counts of its own; it is shown where `progress` can do so."""
    if isinstance(progress, Titled):
        return progress.stage(what)
    return lambda done, total: None


@runtime_checkable
class Titled(Protocol):
    """Progress that can be shown under another title."""

    def stage(self, what: str) -> Progress:
        """Progress under that title."""
        ...


PaperRules = Literal["V0", "V1", "V2", "V3", "V4", "V5", "V6"]


class RulesSettings(Section):
    """Rewards and ends: a row of the paper's Table 1, and what is changed of it."""

    shorthand: ClassVar[str | None] = "preset"

    preset: PaperRules = Field("V4", description="row of Table 1; V0 is the paper's best, V6 cannot move")
    move: float | None = Field(None, description="reward of a move; null: the preset's")
    blocked: float | None = Field(None, description="reward of a blocked move; null: the preset's")
    right: float | None = Field(None, description="reward of the right class; null: the preset's")
    wrong: float | None = Field(None, description="reward of a wrong class; null: the preset's")
    ends_on_right: bool | None = Field(None, description="the right class ends it; null: the preset's")
    ends_on_wrong: bool | None = Field(None, description="a wrong class ends it; null: the preset's")
    can_move: bool | None = Field(None, description="there are moves; null: the preset's")
    try_again: bool = Field(False, description="a blocked move stays legal, also at the same view")
    revisit: bool = Field(
        True, description="moves to views shown before are legal, also where another leads to a new one"
    )
    max_views: int | None = Field(
        None, ge=1, description="T, the most views of an episode; null: the preset's"
    )

    def rules(self) -> EpisodeRules:
        """The preset's rules with what is changed of them."""
        from activelsd.envs.episode import PRESETS

        return replace(PRESETS[self.preset], **self.model_dump(exclude={"preset"}, exclude_none=True))


def _as_rules(value: object) -> object:
    """A preset's name or an `EpisodeRules` as settings; anything else is returned as it is."""
    if isinstance(value, str):
        return {"preset": value}
    return plain(value)


def plain(value: object) -> object:
    """A dataclass, such as an `EpisodeRules`, as a dict; anything else is returned as it is."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


Rules = Annotated[RulesSettings, BeforeValidator(_as_rules)]


class WorldSettings(Section):
    """A world. A subclass says what there is to see, and everything else follows from it.

    A package brings one by an entry point of the group `activelsd.worlds`; the entry's name is the world's.

    Set by a subclass:
        about: what the world shows and where that comes from, for `activelsd envs`.
        simulated: its views are recorded from a simulator, by `activelsd record`.
        advice: what learns best there, as settings of the run by dotted key; presets and words win over it.
        advice_with: the same for one trunk, by its name, where the world is the run's only one.

    A subclass implements `moves` and `graph`, adds fields of its own, and may override `made_by` and `env`.
    """

    about: ClassVar[str] = ""
    simulated: ClassVar[bool] = False
    advice: ClassVar[Mapping[str, Any]] = {}
    advice_with: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    name: str = Field("", description="the world")
    size: int = Field(64, ge=32, le=512, description="side of frames and crops, in pixels")
    colour: Colour = Field("gray", description="channels of the pictures: gray, or rgb for colour")
    branches: dict[str, tuple[str, ...]] = Field(
        {}, description="moves that stand in branches of their own, by the branch's name"
    )
    navigate: tuple[str, ...] = Field((), description="the other moves, by name; []: all there are")
    cache: AbsolutePath | None = Field(
        None, description="folder of prepared views; null: $ACTIVELSD_CACHE or ~/.cache/activelsd"
    )
    rules: Rules = Field(RulesSettings(), description="rewards and ends")

    @field_validator("name")
    @classmethod
    def _registered(cls, name: str) -> str:
        """The name in the registry, which a subclass need not repeat."""
        return name or registry.worlds.name_of(cls) or cls.__name__

    @field_validator("branches")
    @classmethod
    def _known(cls, branches: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        for branch, names in branches.items():
            if branch in ("classify", "navigate"):
                whose = "the classes'" if branch == "classify" else "of env.navigate"
                raise ConfigError(
                    f"env.branches.{branch}: the branch '{branch}' is {whose}; name another for these moves."
                )
            cls._check(names)
        return {branch: names for branch, names in branches.items() if names}

    @field_validator("navigate")
    @classmethod
    def _all_moves(cls, names: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        cls._check(names)
        taken = [name for branch in info.data.get("branches", {}).values() for name in branch]
        for name in (all_names := [*taken, *names]):
            if all_names.count(name) > 1:
                raise ConfigError(f"The move '{name}' is named twice; name it once, in one branch.")
        return names or tuple(name for name in cls._moves() if name not in taken)

    @classmethod
    def _check(cls, names: Sequence[str]) -> None:
        for name in names:
            if name not in cls._moves():
                hint = did_you_mean(name, cls._moves())
                world = cls.__name__.removesuffix("Settings")
                raise ConfigError(f"The {world} world has no move '{name}'; {hint}")

    @classmethod
    def _moves(cls) -> Sequence[str]:
        with registry.worlds.blaming(registry.worlds.name_of(cls) or cls.__name__, "fails"):
            return cls.moves()

    @classmethod
    def moves(cls) -> Sequence[str]:
        """The names of all moves the world knows."""
        raise NotImplementedError(f"{cls.__name__} has no moves()")

    def graph(self, progress: Progress | None = None) -> ViewGraph:
        """The world's views, prepared now if they are not in the cache.

        Args:
            progress: called with what is done and what there is in all.

        Raises:
            UserError: the data is missing, broken, or does not fit the settings.
        """
        raise NotImplementedError(f"{type(self).__name__} has no graph()")

    def depths(self, progress: Progress | None = None) -> Depths:
        """The depths of all views of `graph`, in their order.

        Raises:
            ConfigError: the world does not know them.
        """
        raise ConfigError(f"env={self.name} does not know the depths of its views; {_GEOMETRY}")

    def panoramas(self, progress: Progress | None = None) -> NDArray[np.uint8]:
        """The distance panorama (see `scenery.panorama`) of every target of `graph`, (T, H, W).

        Raises:
            ConfigError: the world does not know the shapes of its targets.
        """
        raise ConfigError(f"env={self.name} does not know the shapes of its objects; {_GEOMETRY}")

    def made_by(self) -> str:
        """What makes the pictures, as `info["backend"]` and result files say it."""
        return self.name

    @property
    def stands_in(self) -> bool:
        """Whether the pictures stand in for those the world is named after."""
        return False

    def parts(self) -> Iterator[tuple[registry.Registry, str]]:
        """The parts found by name that the world is made of, with where they are found."""
        yield registry.worlds, self.name

    def open(self, progress: Progress | None = None) -> ViewGraph:
        """`graph`, with the moves asked for in their branches, and in the colour asked for.

        Raises:
            BrokenPartError: a world of another package fails, or its graph is not sound.
        """
        from activelsd.envs.soundness import check_graph

        with registry.worlds.blaming(self.name, "fails"):
            graph = self.graph(progress)
        if self.name in registry.worlds.own():
            # It has only the moves asked for, since its table and its oracle depend on them.
            return graph.in_colour(self.colour)
        try:
            check_graph(graph)
        except DataError as error:
            raise registry.worlds.broken(self.name, f"has a graph in which {error}") from None
        return graph.with_moves(self.move_branches).in_colour(self.colour)

    @property
    def move_branches(self) -> dict[str, tuple[str, ...]]:
        """The moves asked for by branch of the action tree."""
        return {"navigate": self.navigate, **self.branches} if self.navigate else dict(self.branches)

    def named_moves(self) -> Iterator[tuple[str, str]]:
        """(branch, name) of every move asked for."""
        return ((branch, name) for branch, names in self.move_branches.items() for name in names)

    @property
    def cache_folder(self) -> Path:
        """Where prepared views are kept."""
        from activelsd.envs.cache import default_cache

        return self.cache or default_cache()

    def env(
        self, *, split: str = "train", frames: int = 1, render_mode: str | None = None
    ) -> ActiveVisionEnv:
        """A single environment, as `gymnasium.make` makes it; a live world overrides this.

        Args:
            split: `train`, `val` or `test`.
            frames: K, how many views are stacked.
            render_mode: `rgb_array` or None.
        """
        from activelsd.envs.graphenv import ViewGraphEnv

        return ViewGraphEnv(
            self.open(),
            self.rules.rules(),
            split=split,
            frames=frames,
            backend=self.made_by(),
            render_mode=render_mode,
        )
