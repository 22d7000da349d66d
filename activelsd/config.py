"""The one schema of all settings: a run's config, its sections, and their text as YAML."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from activelsd.train.settings import TrainSettings

PaperRules = Literal["V0", "V1", "V2", "V3", "V4", "V5", "V6"]
Split = Literal["train", "val", "test"]
Place = Annotated[Path, AfterValidator(lambda path: path.expanduser().absolute())]
"""A path kept absolute, so that a run's config means the same from every folder."""


class Section(BaseModel):
    """A group of settings: frozen, and without room for a key it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class DatasetSettings(Section):
    """Which objects there are, and which of them are for training and which for testing."""

    path: Place | None = Field(
        None, description="folder or zip of meshes or of views; null: the embedded shapes"
    )
    split: Literal["official", "mvcnn", "lsdnet"] = Field(
        "official", description="which objects of the dataset"
    )
    classes: tuple[str, ...] | None = Field(None, min_length=2, description="only these; null: every class")
    train_per_class: int = Field(
        150, ge=2, description="embedded shapes: objects to train on, a tenth for val"
    )
    test_per_class: int = Field(20, ge=1, description="embedded shapes: objects to test on")
    seed: int = Field(0, ge=0, description="embedded shapes: which objects")


class RulesSettings(Section):
    """Rewards and ends: a row of the paper's Table 1, and what is changed of it."""

    preset: PaperRules = Field("V4", description="row of Table 1; V0 is the paper's best, V6 cannot move")
    move: float | None = Field(None, description="reward of a move; null: the preset's")
    blocked: float | None = Field(None, description="reward of a blocked move; null: the preset's")
    right: float | None = Field(None, description="reward of the right class; null: the preset's")
    wrong: float | None = Field(None, description="reward of a wrong class; null: the preset's")
    try_again: bool = Field(False, description="a blocked move stays legal, also at the same view")
    max_views: int | None = Field(
        None, ge=1, description="T, the most views of an episode; null: the preset's"
    )


class ModelNetSettings(Section):
    """Objects on an orbit of twelve cameras."""

    name: Literal["modelnet"] = Field("modelnet", description="the world")
    dataset: DatasetSettings = Field(DatasetSettings(), description="the objects")
    size: int = Field(64, ge=32, le=512, description="side of the frames in pixels")
    elevations: tuple[Annotated[float, Field(ge=-89, le=89)], ...] = Field(
        (30.0,), min_length=1, description="degrees above the object that cameras stand at, lowest first"
    )
    navigate: tuple[str, ...] = Field(
        ("orbit_cw", "orbit_ccw", "orbit_cw_90", "orbit_ccw_90"), min_length=1, description="moves, by name"
    )
    cache: Place | None = Field(
        None, description="folder of rendered views; null: $ACTIVELSD_CACHE or ~/.cache/activelsd"
    )
    rules: RulesSettings = Field(RulesSettings(), description="rewards and ends")


class ScansSettings(Section):
    """Which recorded walks there are, and which of them are for training and which for testing."""

    kind: Literal["sample"] | None = Field(
        None, description="sample: scans made here; null: those at the path, else the sample"
    )
    path: Place | None = Field(None, description="folder of scans, as of the Active Vision Dataset")
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
    width: int = Field(480, ge=96, le=1920, description="sample: of the photographs, in pixels")
    height: int = Field(270, ge=54, le=1080, description="sample: of the photographs, in pixels")
    seed: int = Field(0, ge=0, description="sample: which homes and things")

    @model_validator(mode="after")
    def _one_origin(self) -> ScansSettings:
        if self.kind is not None and self.path is not None:
            raise ValueError(
                "env.dataset=sample and env.dataset.path exclude each other; leave one of them out"
            )
        return self


class StartsSettings(Section):
    """Where episodes begin."""

    visible: bool = Field(True, description="only where the target is in sight")
    shown_well: bool = Field(False, description="also where the target is shown well already")
    max_difficulty: int = Field(5, ge=1, le=5, description="of the target's box there, 1 is easiest")
    min_size: float = Field(
        0.0, ge=0, le=1, description="of the box there: its larger side as a fraction of the frame"
    )
    max_size: float = Field(1.0, ge=0, le=1, description="of the box there")
    per_target: int | None = Field(
        20, ge=1, description="most starts of each target that validates or tests; null: all"
    )
    scores: Place | None = Field(
        None, description="table of a recogniser's scores: start where it is not sure and moving can help"
    )
    threshold: float = Field(0.9, gt=0, le=1, description="score from which the recogniser is sure")


class AVDSettings(Section):
    """Recorded walks through homes: the Active Vision Dataset, or sample scans of its format."""

    name: Literal["avd"] = Field("avd", description="the world")
    dataset: ScansSettings = Field(ScansSettings(), description="the scans")
    task: Literal["instance", "category"] = Field("instance", description="what is to be named")
    size: int = Field(64, ge=32, le=512, description="side of frames and crops in pixels")
    navigate: tuple[str, ...] = Field(
        ("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw"),
        min_length=1,
        description="moves, by name",
    )
    starts: StartsSettings = Field(StartsSettings(), description="where episodes begin")
    cache: Place | None = Field(
        None, description="folder of views and sample scans; null: $ACTIVELSD_CACHE or ~/.cache/activelsd"
    )
    rules: RulesSettings = Field(RulesSettings(), description="rewards and ends")


class ScenesSettings(Section):
    """Which simulated rooms there are: of each type AI2-THOR has 20 to train in, 5 for val, 5 to test in."""

    rooms: tuple[Literal["kitchen", "living_room", "bedroom", "bathroom"], ...] = Field(
        ("kitchen", "living_room", "bedroom", "bathroom"), min_length=1, description="types of rooms"
    )
    train: int = Field(20, ge=1, le=20, description="scenes of each type to train in")
    val: int = Field(2, ge=1, le=5, description="scenes of each type to validate in")
    test: int = Field(5, ge=1, le=5, description="scenes of each type to test in")


class SightsSettings(Section):
    """Where episodes begin."""

    min_pixels: float = Field(
        0.002, ge=0, le=1, description="least share of the frame that shows the target there"
    )
    shown_well: bool = Field(False, description="also where the target is shown well already")
    max_difficulty: int = Field(3, ge=1, le=3, description="1 easy, 2 moderate, 3 hard")
    per_target: int | None = Field(
        20, ge=1, description="most starts of each target that validates or tests; null: all"
    )


class THORSettings(Section):
    """Simulated rooms: AI2-THOR, or a stand-in for it."""

    name: Literal["thor"] = Field("thor", description="the world")
    backend: Literal["ai2thor", "standin"] = Field(
        "ai2thor", description="what makes the pictures; standin: furnished rooms rendered here"
    )
    executable: str | None = Field(None, description="AI2-THOR's player; null: the build its client has")
    x_displays: tuple[str, ...] = Field((), description="AI2-THOR: X displays, taken in turn; []: $DISPLAY")
    gpu_devices: tuple[int, ...] = Field((), description="AI2-THOR: GPUs to render on, taken in turn")
    live: bool = Field(
        False, description="ga3c: agents walk the simulator itself; else all train on recordings of it"
    )
    episodes_per_scene: int = Field(20, ge=1, description="live: episodes in a row that are of one scene")
    simulators: int | None = Field(
        None, ge=1, description="how many record; null: one AI2-THOR, or as many stand-ins as cores"
    )
    scenes: ScenesSettings = Field(ScenesSettings(), description="the rooms")
    classes: tuple[str, ...] = Field(
        (
            *("AlarmClock", "Apple", "Book", "Bowl", "Box", "Candle", "GarbageCan", "HousePlant", "Laptop"),
            *("SoapBottle", "Television", "Toaster"),
        ),
        min_length=2,
        description="types of objects to name",
    )
    size: int = Field(64, ge=32, le=512, description="side of frames and crops in pixels")
    width: int = Field(224, ge=64, le=1920, description="of the simulator's pictures, in pixels")
    height: int = Field(224, ge=64, le=1920, description="of the simulator's pictures, in pixels")
    field_of_view: float = Field(90.0, ge=20, le=150, description="degrees from top to bottom")
    step: float = Field(0.5, ge=0.05, le=1, description="metres between places")
    horizons: tuple[Annotated[float, Field(ge=-30, le=60)], ...] = Field(
        (-30.0, 0.0, 30.0), min_length=1, description="degrees down that the agent can look"
    )
    navigate: tuple[str, ...] = Field(
        (
            *("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw"),
            *("look_up", "look_down"),
        ),
        min_length=1,
        description="moves, by name",
    )
    starts: SightsSettings = Field(SightsSettings(), description="where episodes begin")
    cache: Place | None = Field(
        None, description="folder of recordings; null: $ACTIVELSD_CACHE or ~/.cache/activelsd"
    )
    rules: RulesSettings = Field(RulesSettings(), description="rewards and ends")


World = Annotated[ModelNetSettings | AVDSettings | THORSettings, Field(discriminator="name")]
"""A world's settings, told apart by its name."""

JOINT: Final = "joint"


class JointSettings(Section):
    """Several worlds for one network, each one's settings below its own name, as in `env.modelnet.size`.

    `env=modelnet,avd` names them by their presets, so `env=modelnet,mine.yaml` calls the second `mine`.
    A key that names no world, as in `env.size`, is meant for every world that has it.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, World] = Field(init=False)

    name: Literal["joint"] = Field(JOINT, description="several worlds at once")

    @property
    def worlds(self) -> dict[str, World]:
        """Each world's settings by its own name."""
        return self.__pydantic_extra__

    @property
    def size(self) -> int:
        """Side of every world's frames in pixels."""
        return next(iter(self.worlds.values())).size

    @model_validator(mode="after")
    def _worlds_fit(self) -> JointSettings:
        if len(self.worlds) < 2:
            raise ValueError("A joint run needs two worlds or more; name them as in env=modelnet,avd")
        if len({world.size for world in self.worlds.values()}) > 1:
            sizes = " and ".join(f"env.{name}.size={world.size}" for name, world in self.worlds.items())
            raise ValueError(f"One network needs frames of one size, not {sizes}; set env.size")
        return self


class PolicySettings(Section):
    """The network."""

    trunk: Literal["compact", "alexnet"] = Field("compact", description="what sees; alexnet is the paper's")
    memory: Literal["stack", "lstm", "pool"] = Field("pool", description="what is kept of earlier views")
    frames: int = Field(
        1, ge=1, le=12, description="K, the last views stacked as channels; the paper's 3 for stack"
    )
    head: Literal["tree", "flat"] = Field(
        "tree", description="branch then leaf, or one softmax over all actions"
    )
    features: int = Field(256, ge=8, description="width of the compact trunk's output")
    init: Place | None = Field(
        None, description="run or checkpoint to start from: all but the actions it does not know; null: fresh"
    )


class EvaluateSettings(Section):
    """How players are measured."""

    split: Split = Field("test", description="which objects are played")
    episodes_per_object: int | None = Field(
        None, ge=1, description="random starts of every object; null: every start once"
    )
    seed: int = Field(0, ge=0, description="of random starts, of baselines that draw, of resampling")


class RunConfig(Section):
    """Everything that, with the code, repeats a run."""

    name: str | None = Field(
        None, pattern=r"^[\w.+-]+$", description="of the run's folder; null: its worlds' names"
    )
    seed: int = Field(0, ge=0, description="fanned out to weights, episodes and actions")
    device: Literal["auto", "cpu", "cuda"] = Field("auto", description="auto: cuda where there is one")
    threads: int | None = Field(None, ge=1, description="PyTorch's threads; null: its own choice, all cores")
    runs: Path = Field(Path("runs"), description="folder of runs")
    env: World | JointSettings = Field(discriminator="name", description="the world, or worlds by name")
    policy: PolicySettings = Field(PolicySettings(), description="the network")
    train: TrainSettings = Field(TrainSettings(), description="how it learns")
    evaluate: EvaluateSettings = Field(EvaluateSettings(), description="how players are measured")

    @property
    def worlds(self) -> dict[str, World]:
        """The settings of every world by its name: one, or those of a joint run."""
        return self.env.worlds if isinstance(self.env, JointSettings) else {self.env.name: self.env}

    @property
    def title(self) -> str:
        """What the run's folder is called, behind the time."""
        return self.name or "+".join(self.worlds)

    @model_validator(mode="after")
    def _parts_fit(self) -> RunConfig:
        if self.policy.trunk == "alexnet" and self.env.size < 63:
            raise ValueError(
                f"policy.trunk=alexnet needs env.size of at least 63 pixels, not {self.env.size}"
            )
        if self.train.actors == "ga3c" and len(self.worlds) > 1:
            raise ValueError("train.actors=ga3c plays one world; for several set train.actors=resident")
        for switch in ("amp", "compile", "cuda_graphs"):
            if getattr(self.train, switch) and self.train.actors != "resident":
                raise ValueError(
                    f"train.{switch}=true is for train.actors=resident, whose acting pass is the learning"
                    " pass; leave it out"
                )
        if self.train.actors == "ray":
            if self.train.vtrace is False:
                raise ValueError(
                    "train.vtrace=false would leave the lag of train.actors=ray uncorrected; leave it out"
                )
            if self.train.ray.envs_per_worker < len(self.worlds):
                raise ValueError(
                    f"train.ray.envs_per_worker={self.train.ray.envs_per_worker} leaves a world of"
                    f" {len(self.worlds)} without any; set it to at least that"
                )
        return self


def worlds(schema: type[RunConfig] = RunConfig) -> dict[str, type[BaseModel]]:
    """The settings of every world, by its name."""
    sections = (model for model in _sections(schema.model_fields["env"]) if model is not JointSettings)
    return {model.model_fields["name"].default: model for model in sections}


def settings(schema: type[BaseModel], world: str, prefix: str = "") -> dict[str, FieldInfo]:
    """Every setting of a world by its dotted key."""
    found: dict[str, FieldInfo] = {}
    for name, field in schema.model_fields.items():
        section = _section(field, world)
        if section is None:
            found[prefix + name] = field
        else:
            found |= settings(section, world, f"{prefix}{name}.")
    return found


def defaults(schema: type[BaseModel], world: str) -> dict[str, Any]:
    """The schema's defaults as nested plain values, the bottom layer."""
    tree: dict[str, Any] = {}
    for name, field in schema.model_fields.items():
        section = _section(field, world)
        if section is not None:
            tree[name] = defaults(section, world)
            if isinstance(field.default, section):
                tree[name] |= field.default.model_dump()
        elif field.default is not PydanticUndefined:
            tree[name] = field.default
    return tree


def _sections(field: FieldInfo) -> list[type[BaseModel]]:
    return list(_models(field.annotation))


def _models(kind: object) -> Iterator[type[BaseModel]]:
    """The models of a union, however deep one stands inside another."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for inner in get_args(kind):
        yield from _models(inner)


def _section(field: FieldInfo, world: str) -> type[BaseModel] | None:
    sections = _sections(field)
    if len(sections) > 1:
        sections = [model for model in sections if model.model_fields["name"].default == world]
    return sections[0] if sections else None


def dump(config: BaseModel) -> str:
    """A config as YAML, with what each setting means behind it."""
    return "\n".join(_lines(config, "")) + "\n"


def _lines(section: BaseModel, indent: str) -> Iterator[str]:
    fields = type(section).model_fields
    for name, value in section:
        about = fields[name].description if name in fields else "a world"
        if isinstance(value, BaseModel):
            yield f"{indent}{name}:  # {about}"
            yield from _lines(value, indent + "  ")
        else:
            yield f"{indent}{name}: {_inline(section.model_dump(mode='json')[name])}  # {about}"


def _inline(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
    return text.removesuffix("...\n").strip()
