"""The ModelNet world: objects with cameras all around."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator

from activelsd import registry
from activelsd.envs.settings import Progress, Rules, RulesSettings, WorldSettings
from activelsd.errors import ConfigError
from activelsd.sections import AbsolutePath, Section

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from activelsd.envs.modelnet.cameras import Rig
    from activelsd.envs.viewgraph import ViewGraph
    from activelsd.scenery.depths import Depths

AZIMUTHS, ELEVATION = 12, 30.0
"""Cameras of a ring, and degrees above the horizontal plane, unless others are asked for."""


class DatasetSettings(Section):
    """Which objects there are, and which of them are for training and which for testing."""

    path: AbsolutePath | None = Field(
        None, description="folder or zip of meshes, point clouds or views; null: the embedded shapes"
    )
    split: Literal["official", "mvcnn", "lsdnet"] = Field(
        "official", description="which objects train and test"
    )
    classes: tuple[str, ...] | None = Field(None, min_length=2, description="only these; null: every class")
    up: Literal["auto", "x", "y", "z"] = Field(
        "auto", description="axis of meshes and points that points up; auto: y for glTF, else z"
    )
    skip_broken: bool = Field(False, description="leave out objects that cannot be read, and name them")
    train_per_class: int = Field(
        150, ge=2, description="embedded shapes: objects to train on, a tenth for val"
    )
    test_per_class: int = Field(20, ge=1, description="embedded shapes: objects to test on")
    seed: int = Field(0, ge=0, description="embedded shapes: seed of the objects")


class ModelNetSettings(WorldSettings):
    """Look at an object from a ring of cameras, step around it, and name it.

    Observation and info are `ActiveVisionEnv`'s; the target fills the frame. Actions: the dataset's classes
    in alphabetical order, then the moves. An episode begins at one of the views of the first elevation of
    an object of the split, drawn uniformly.

    Example:
        >>> gymnasium.make("activelsd/World-v0", world="modelnet", navigate=["orbit_cw", "orbit_ccw"])
    """

    about: ClassVar[str] = "embedded shapes (16 classes), or meshes, points or views at env.dataset.path"

    advice_with: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        # Such a trunk names most objects at the first look; without a price the agent looks on for little.
        "timm:NAME": {
            "env.rules.preset": "V5",
            "env.rules.move": -0.03,
            "env.navigate": ["orbit_cw", "orbit_ccw", "orbit_cw_90", "orbit_ccw_90", "orbit_opposite"],
        }
    }

    dataset: DatasetSettings = Field(DatasetSettings(), description="the objects")
    # Going to and fro between two views shows nothing new.
    rules: Rules = Field(RulesSettings(revisit=False), description="rewards and ends")
    azimuths: int = Field(AZIMUTHS, ge=2, le=360, description="cameras of a ring, evenly spaced")
    elevations: tuple[Annotated[float, Field(ge=-89, le=89)], ...] = Field(
        (ELEVATION,), min_length=1, description="elevations of the cameras in degrees, lowest first"
    )
    cameras: Literal["ring", "dodecahedron"] = Field(
        "ring", description="where they stand: rings, or a dodecahedron's 20 vertices"
    )
    navigate: tuple[str, ...] = Field(
        ("orbit_cw", "orbit_ccw", "orbit_cw_90", "orbit_ccw_90"), min_length=1, description="moves, by name"
    )

    @field_validator("elevations")
    @classmethod
    def _lowest_first(cls, elevations: tuple[float, ...]) -> tuple[float, ...]:
        rising = sorted(set(elevations))
        if list(elevations) != rising:
            named, right = (",".join(f"{x:g}" for x in some) for some in (elevations, rising))
            raise ConfigError(
                f"env.elevations=[{named}] must rise, since orbit_up goes to the next; write [{right}]."
            )
        return elevations

    @field_validator("cameras")
    @classmethod
    def _one_rig(cls, cameras: str, info: ValidationInfo) -> str:
        rings = (info.data.get("azimuths", AZIMUTHS), info.data.get("elevations", (ELEVATION,)))
        if cameras == "dodecahedron" and rings != (AZIMUTHS, (ELEVATION,)):
            raise ConfigError(
                "env.cameras=dodecahedron has 20 cameras of its own; leave out env.azimuths and"
                " env.elevations."
            )
        return cameras

    @classmethod
    def moves(cls) -> Sequence[str]:
        """Every orbit move there is, those of installed packages among them."""
        return registry.orbit_moves.names()

    def made_by(self) -> str:
        """`modelnet`, or `modelnet-points` for point clouds drawn as discs."""
        from activelsd.envs.modelnet.datasets import kind_at

        path = self.dataset.path
        return "modelnet-points" if path is not None and kind_at(path) == "points" else "modelnet"

    def parts(self) -> Iterator[tuple[registry.Registry, str]]:
        """The world and its orbit moves."""
        yield from super().parts()
        yield from ((registry.orbit_moves, name) for _, name in self.named_moves())

    def rig(self) -> Rig:
        """The cameras around every object."""
        from activelsd.envs.modelnet.cameras import Dodecahedron, Rings

        if self.cameras == "dodecahedron":
            return Dodecahedron()
        return Rings.even(self.azimuths, self.elevations)

    def graph(self, progress: Progress | None = None) -> ViewGraph:
        """The objects' views, rendered now if they are not in the cache."""
        from activelsd.envs.modelnet.datasets import open_dataset
        from activelsd.envs.modelnet.orbit import move_tables, with_moves
        from activelsd.envs.modelnet.prepare import prepared_views, rigs_of

        dataset, rig = open_dataset(self.dataset, self.colour), self.rig()
        rigs = {item.name: own for item, own in zip(dataset.items, rigs_of(dataset, rig), strict=True)}
        # What does not fit is refused before minutes of rendering.
        move_tables([name for _, name in self.named_moves()], list(rigs.values()))
        graph = prepared_views(
            dataset,
            size=self.size,
            rig=rig,
            cache=self.cache_folder,
            skip_broken=self.dataset.skip_broken,
            progress=progress,
        )
        return with_moves(graph, self.move_branches, [rigs[name] for name in graph.scenes])

    def depths(self, progress: Progress | None = None) -> Depths:
        """The depths of the objects' views, rendered now if they are not in the cache."""
        import numpy as np

        from activelsd.scenery.depths import Depths

        rig = self.rig()
        graph = self._drawn("depth", self.size, rig, progress)
        cameras = np.array([list(camera) for camera in rig.cameras], np.float64)
        return Depths(graph.frames, np.tile(cameras, (len(graph.scenes), 1)))

    def panoramas(self, progress: Progress | None = None) -> NDArray[np.uint8]:
        """The objects' distance panoramas, rendered now if they are not in the cache."""
        from activelsd.envs.modelnet.cameras import Rings
        from activelsd.scenery.panorama import COLUMNS

        return self._drawn("panorama", COLUMNS, Rings.even(1, [0.0]), progress).frames

    def _drawn(
        self, shows: Literal["depth", "panorama"], size: int, rig: Rig, progress: Progress | None
    ) -> ViewGraph:
        """Other views of the objects than pictures. Raises ConfigError if there are only pictures of them."""
        from activelsd.envs.modelnet.datasets import open_dataset
        from activelsd.envs.modelnet.prepare import prepared_views
        from activelsd.envs.modelnet.sources import Drawn

        dataset = open_dataset(self.dataset, self.colour)
        if not isinstance(dataset.source, Drawn):
            raise ConfigError(
                f"{dataset.origin['from']} holds pictures, which tell no {shows} of objects; use meshes,"
                " points or the embedded shapes for that."
            )
        return prepared_views(
            dataset,
            size=size,
            rig=rig,
            cache=self.cache_folder,
            shows=shows,
            skip_broken=self.dataset.skip_broken,
            progress=progress,
        )
