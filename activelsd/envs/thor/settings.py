"""The AI2-THOR world: simulated rooms, or a stand-in for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field

from activelsd.envs.settings import Progress, Rules, RulesSettings, WorldSettings
from activelsd.sections import Section

if TYPE_CHECKING:
    from activelsd.envs.base import ActiveVisionEnv
    from activelsd.envs.viewgraph import ViewGraph

AI2THOR, STANDIN = "ai2thor", "standin"

MOVES = (
    *("forward", "backward", "left", "right", "rotate_cw", "rotate_ccw"),
    *("look_up", "look_down"),
)
RoomType = Literal["kitchen", "living_room", "bedroom", "bathroom"]


class ScenesSettings(Section):
    """Which simulated rooms there are: of each type AI2-THOR has 20 to train in, 5 for val, 5 to test in."""

    rooms: tuple[RoomType, ...] = Field(
        ("kitchen", "living_room", "bedroom", "bathroom"), min_length=1, description="types of rooms"
    )
    train: int = Field(20, ge=1, le=20, description="scenes of each type to train in")
    val: int = Field(2, ge=1, le=5, description="scenes of each type to validate in")
    test: int = Field(5, ge=1, le=5, description="scenes of each type to test in")


class SightsSettings(Section):
    """Where episodes begin."""

    min_pixels: float = Field(
        0.002, ge=0, le=1, description="least share of the frame's pixels that show the target"
    )
    shown_well: bool = Field(False, description="also views that show the target well already")
    max_difficulty: int = Field(
        3, ge=1, le=3, description="greatest difficulty of the start: 1 easy, 2 moderate, 3 hard"
    )
    per_target: int | None = Field(20, ge=1, description="most starts per target in val and test; null: all")


class THORSettings(WorldSettings):
    """Look for an object in a simulated room, walk to a view that shows what it is, and name its type.

    Observation and info are `ActiveVisionEnv`'s: `frames` are whole pictures, the box of the target is
    around the pixels of its mask in fractions of them, and `crops` show its surroundings cut from the
    full-resolution picture; box and crop are zeros where the target is out of sight. Actions: the types of
    objects in alphabetical order, then the moves. A move into a wall or thing, or beyond the last horizon,
    is blocked: it stays and costs. Episodes begin where recordings of the split's scenes say that a target
    is in sight and not yet shown well, drawn uniformly; `live`, so many in a row are of one scene, since
    loading another takes a while.

    Example:
        >>> gymnasium.make("activelsd/World-v0", world="thor", backend="standin", subset="test")
    """

    about: ClassVar[str] = "rooms of AI2-THOR, or of its stand-in by env.backend=standin"
    simulated: ClassVar[bool] = True
    advice: ClassVar[Mapping[str, Any]] = {
        "train.steps": 1_800_000,  # a quarter of an hour on two cores
        "train.learning_rate": 7e-4,  # at the default's 2e-3 first looks gain more than moves do
        "train.gamma": 0.99,  # steps are short: a better view is several away
        "train.mirror": True,  # rooms are few: mirrored ones double them
        "train.dropout": 0.5,  # or views of training rooms seem surer than those of new ones
        "train.terms.guided": 0.5,  # reward alone teaches the way too slowly in training rooms
        "train.ga3c.timeout_s": 400,  # a simulator that was lost starts anew meanwhile
    }

    backend: Literal["ai2thor", "standin"] = Field(
        "ai2thor", description="what makes the pictures; standin: furnished rooms rendered here"
    )
    executable: str | None = Field(None, description="AI2-THOR's player; null: the build its client has")
    x_displays: tuple[str, ...] = Field((), description="AI2-THOR: X displays, taken in turn; []: $DISPLAY")
    gpu_devices: tuple[int, ...] = Field((), description="AI2-THOR: GPUs to render on, taken in turn")
    live: bool = Field(
        False, description="ga3c: agents walk the simulator itself; else all train on recordings of it"
    )
    episodes_per_scene: int = Field(20, ge=1, description="live: episodes in a row in one scene")
    simulators: int | None = Field(
        None, ge=1, description="how many record; null: one AI2-THOR, or as many stand-ins as cores"
    )
    scenes: ScenesSettings = Field(ScenesSettings(), description="the rooms")
    classes: Annotated[tuple[str, ...], AfterValidator(lambda names: tuple(sorted(names)))] = Field(
        (
            *("AlarmClock", "Apple", "Book", "Bowl", "Box", "Candle", "GarbageCan", "HousePlant", "Laptop"),
            *("SoapBottle", "Television", "Toaster"),
        ),
        min_length=2,
        description="types of objects to name",
    )
    width: int = Field(224, ge=64, le=1920, description="size of the simulator's pictures in pixels")
    height: int = Field(224, ge=64, le=1920, description="size of the simulator's pictures in pixels")
    field_of_view: float = Field(90.0, ge=20, le=150, description="vertical field of view in degrees")
    step: float = Field(0.5, ge=0.05, le=1, description="distance between neighbouring places in metres")
    horizons: Annotated[
        tuple[Annotated[float, Field(ge=-30, le=60)], ...], AfterValidator(lambda x: tuple(sorted(x)))
    ] = Field(
        (-30.0, 0.0, 30.0),
        min_length=1,
        description="angles below the horizon that the agent can look at, in degrees",
    )
    starts: SightsSettings = Field(SightsSettings(), description="where episodes begin")
    rules: Rules = Field(
        RulesSettings(move=-0.01, blocked=-0.03, wrong=-1.0, max_views=20), description="rewards and ends"
    )

    @classmethod
    def moves(cls) -> Sequence[str]:
        """A step in four directions, a turn in two, and a tilt up and down."""
        return MOVES

    def made_by(self) -> str:
        """The backend."""
        return self.backend

    @property
    def stands_in(self) -> bool:
        """Whether rooms are rendered in AI2-THOR's stead."""
        return self.backend == STANDIN

    def graph(self, progress: Progress | None = None) -> ViewGraph:
        """The rooms' views, recorded now if they are not in the cache."""
        from activelsd.envs.thor.prepare import recorded_rooms

        return recorded_rooms(self, progress)

    def env(
        self, *, split: str = "train", frames: int = 1, render_mode: str | None = None
    ) -> ActiveVisionEnv:
        """See `WorldSettings`; with `live` the environment walks the simulator, else it plays recordings."""
        if not self.live:
            return super().env(split=split, frames=frames, render_mode=render_mode)
        from activelsd.envs.thor.env import LiveTHOREnv

        return LiveTHOREnv(self, split=split, frames=frames, render_mode=render_mode)
