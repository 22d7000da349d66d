"""The Active Vision Dataset world: recorded walks through homes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, model_validator

from activelsd.envs.settings import Progress, WorldSettings
from activelsd.errors import ConfigError
from activelsd.sections import AbsolutePath, Section

if TYPE_CHECKING:
    from activelsd.envs.viewgraph import ViewGraph

MOVES = ("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw")
SAMPLE_NOTE = "sample.json"
"""File beside sample scans that says what they were made from."""

HARDEST = 5
"""The data set grades boxes from 1, the easiest, to this."""


class ScansSettings(Section):
    """Which recorded walks there are, and which of them are for training and which for testing."""

    shorthand: ClassVar[str | None] = "kind"

    kind: Literal["sample"] | None = Field(
        None, description="sample: scans made here; null: those at the path, else the sample"
    )
    path: AbsolutePath | None = Field(None, description="folder of scans, as of the Active Vision Dataset")
    split: Literal["homes", "1", "2", "3"] = Field(
        "homes", description="1 to 3 are published; homes tests on the last quarter of the homes"
    )
    train: tuple[str, ...] | None = Field(
        None, min_length=1, description="scans to train on; null: the split's"
    )
    test: tuple[str, ...] | None = Field(
        None, min_length=1, description="scans to test on; null: the split's"
    )
    scans: tuple[str, ...] | None = Field(
        None,
        min_length=2,
        description="sample: names of the scans; null: the published split's, or twenty",
    )
    width: int = Field(480, ge=96, le=1920, description="sample: size of the photographs in pixels")
    height: int = Field(270, ge=54, le=1080, description="sample: size of the photographs in pixels")
    seed: int = Field(0, ge=0, description="sample: seed of the homes and things")

    @model_validator(mode="after")
    def _one_origin(self) -> ScansSettings:
        if self.kind is not None and self.path is not None:
            raise ConfigError(
                "env.dataset=sample and env.dataset.path exclude each other; leave one of them out."
            )
        return self


class StartsSettings(Section):
    """Where episodes begin."""

    visible: bool = Field(True, description="only views that show the target")
    shown_well: bool = Field(False, description="also views that show the target well already")
    max_difficulty: int = Field(
        HARDEST, ge=1, le=HARDEST, description="greatest difficulty of the target's box, 1 is easiest"
    )
    min_size: float = Field(
        0.0, ge=0, le=1, description="least larger side of the box, as a fraction of the frame"
    )
    max_size: float = Field(1.0, ge=0, le=1, description="greatest larger side of the box")
    per_target: int | None = Field(20, ge=1, description="most starts per target in val and test; null: all")
    scores: AbsolutePath | None = Field(
        None, description="table of a recogniser's scores: start only where it is unsure and moving can help"
    )
    threshold: float = Field(0.9, gt=0, le=1, description="score at which the recogniser counts as sure")

    @property
    def needs_a_box(self) -> bool:
        """Whether a filter judges by the target's box, which must be in sight for that."""
        return self.visible or self.max_difficulty < HARDEST or self.min_size > 0 or self.max_size < 1


class AVDSettings(WorldSettings):
    """Look for an object in a recorded home, walk to a view that shows what it is, and name it.

    Observation and info are `ActiveVisionEnv`'s: `frames` are whole photographs squashed to a square, the
    box of the target is in fractions of them, and `crops` show its surroundings cut from the
    full-resolution photograph; box and crop are zeros where the target is out of sight. Actions: the
    instances in order of their id (or the categories in alphabetical order), then the moves. A move that
    the recording does not have is blocked: it stays and costs. An episode begins at a view and with a
    target of the split's scans, drawn uniformly.

    Example:
        >>> gymnasium.make("activelsd/World-v0", world="avd", dataset={"path": "ActiveVisionDataset"})
    """

    about: ClassVar[str] = (
        "sample scans (rendered rooms), or scans of the Active Vision Dataset at env.dataset.path"
    )
    advice: ClassVar[Mapping[str, Any]] = {
        "train.gamma": 0.99,  # steps are short: a better view is several away
        "train.mirror": True,  # rooms are few: mirrored ones double them
        "train.dropout": 0.5,  # or views of training homes seem surer than those of new ones
    }

    dataset: ScansSettings = Field(ScansSettings(), description="the scans")
    task: Literal["instance", "category"] = Field("instance", description="what is to be named")
    starts: StartsSettings = Field(StartsSettings(), description="where episodes begin")

    @classmethod
    def moves(cls) -> Sequence[str]:
        """A step in four directions, and a turn in two."""
        return MOVES

    def made_by(self) -> str:
        """`avd` for photographs of real homes, `avd-sample` for the rendered rooms in their stead."""
        from activelsd.envs.avd.datasets import is_sample

        return "avd-sample" if is_sample(self.dataset.path) else "avd"

    @property
    def stands_in(self) -> bool:
        """Whether sample scans are shown."""
        return self.made_by() != "avd"

    def graph(self, progress: Progress | None = None) -> ViewGraph:
        """The scans' views, made now if they are not in the cache; sample scans are made before."""
        from activelsd.envs.avd.categories import by_category
        from activelsd.envs.avd.datasets import sample_scans, scans_in
        from activelsd.envs.avd.prepare import prepare
        from activelsd.envs.avd.splits import split_scans
        from activelsd.envs.avd.starts import read_scores, starts, starts_by_score
        from activelsd.envs.start_filters import episodes
        from activelsd.envs.viewgraph import load_graph

        data, cache = self.dataset, self.cache_folder
        found = scans_in(data.path or sample_scans(data, cache, progress=progress))
        chosen = split_scans(list(found), data.split, train=data.train, test=data.test)
        folders = [found[name] for name in chosen.scans]
        file = prepare(folders, size=self.size, colour=self.colour, cache=cache, progress=progress)
        graph = load_graph(file)
        graph = starts(graph, chosen, self.starts)
        if self.starts.scores is not None:
            scores = read_scores(graph, self.starts.scores)
            graph = starts_by_score(graph, scores, self.starts.threshold)
        graph = episodes(graph, self.starts.per_target, self.move_branches)
        return by_category(graph) if self.task == "category" else graph
