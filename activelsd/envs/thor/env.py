"""The AI2-THOR world: find out what an object in a simulated room is, as registered with Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.base import Observation
from activelsd.envs.cache import default_cache
from activelsd.envs.episode import Episode, EpisodeRules, View, as_rules
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.oracle import shows_well, with_oracle
from activelsd.envs.start_filters import check_starts, frozen_list
from activelsd.envs.thor.lattice import MOVES, Pose
from activelsd.envs.thor.recordings import RecordingSettings, recordings
from activelsd.envs.thor.room import WalkableRoom
from activelsd.envs.thor.scenes import CLASSES, ROOM_TYPES, scenes
from activelsd.envs.thor.simulators import AI2THOR, SimulatorSettings, check_backend
from activelsd.envs.viewgraph import SPLITS, ViewGraph, join, load_graph
from activelsd.errors import ConfigError, SimulatorLost, did_you_mean

if TYPE_CHECKING:
    from activelsd.envs.vector import ViewGraphVectorEnv

PER_ROOM_TYPE = {"train": 20, "val": 2, "test": 5}
"""Scenes of each type of room, by split."""


def recording_settings(
    *,
    backend: str = AI2THOR,
    executable: str | None = None,
    x_displays: Sequence[str] = (),
    gpu_devices: Sequence[int] = (),
    classes: Sequence[str] = CLASSES,
    size: int = 64,
    width: int = 224,
    height: int = 224,
    field_of_view: float = 90.0,
    step: float = 0.5,
    horizons: Sequence[float] = (-30.0, 0.0, 30.0),
) -> RecordingSettings:
    """What recordings depend on.

    Args:
        backend: `ai2thor`, or `standin` for the furnished rooms in its stead.
        executable: of AI2-THOR's player; None for the build that its client downloads.
        x_displays: X displays for it; processes take them in turn. None: the one of the environment.
        gpu_devices: numbers of the GPUs that it renders on; processes take them in turn.
        classes: types of objects to ask for.
        size: side of frames and crops in pixels.
        width: of the simulator's pictures, in pixels.
        height: of the simulator's pictures, in pixels.
        field_of_view: of the camera, degrees from top to bottom.
        step: between places, in metres.
        horizons: degrees down that the agent can look.

    Raises:
        ConfigError: the backend is unknown.
    """
    check_backend(backend)
    return RecordingSettings(
        SimulatorSettings(
            backend=backend,
            executable=executable,
            width=width,
            height=height,
            field_of_view=field_of_view,
            step=step,
            x_displays=tuple(x_displays),
            gpu_devices=tuple(gpu_devices),
        ),
        tuple(sorted(horizons)),
        tuple(sorted(classes)),
        size,
    )


_RECORDING = frozenset(signature(recording_settings).parameters)


def thor_graph(
    *,
    rooms: Sequence[str] = ROOM_TYPES,
    train: int = PER_ROOM_TYPE["train"],
    val: int = PER_ROOM_TYPE["val"],
    test: int = PER_ROOM_TYPE["test"],
    navigate: Sequence[str] = MOVES,
    min_pixels: float = 0.002,
    shown_well: bool = False,
    max_difficulty: int = 3,
    per_target: int | None = 20,
    simulators: int | None = None,
    cache: str | Path | None = None,
    pictures: bool = True,
    progress: Callable[[int, int], None] | None = None,
    **recording: Any,
) -> ViewGraph:
    """The views of simulated rooms with the moves asked for, recorded now or taken from the cache.

    Args:
        rooms: types of rooms, out of `scenes.ROOM_TYPES`.
        train: scenes of each type of room to train in, at most 20.
        val: scenes of each type to validate in, at most 5.
        test: scenes of each type to test in, at most 5.
        navigate: names of moves, out of `lattice.MOVES`.
        min_pixels: least share of the frame that shows the target at the start.
        shown_well: also start where the target is shown well, see `oracle.shows_well`.
        max_difficulty: of the start: 1 easy, 2 moderate, 3 hard, see `record.difficulties`.
        per_target: at most so many starts of each target that validates or tests; None for all.
        simulators: how many record side by side; None for one of AI2-THOR, or as many stand-ins as cores.
        cache: folder of recordings; None for `default_cache()`.
        pictures: False for a table of what is seen where, its frames and crops zeros that take no room.
        progress: called with the scenes that are recorded and all.
        **recording: what is recorded, and how: see `recording_settings`.

    Raises:
        DataError: a scene cannot be recorded, or no start is left.
        ConfigError: a move, backend, class or type of room is unknown.
        UserError: AI2-THOR is not there, or cannot be started here.
    """
    for move in navigate:
        if move not in MOVES:
            raise ConfigError(f"The THOR world has no move '{move}'; {did_you_mean(move, MOVES)}")
    settings = recording_settings(**recording)
    chosen = [
        (name, split)
        for split, count in zip(SPLITS, (train, val, test), strict=True)
        for room in rooms
        for name in scenes((room,), split)[:count]
    ]
    files = recordings(
        settings,
        [name for name, _ in chosen],
        cache=default_cache() if cache is None else Path(cache),
        simulators=simulators,
        progress=progress,
    )
    parts = [load_graph(file) for file in files]
    graph = join(parts) if pictures else _table(parts)
    graph = starts(
        graph,
        dict(chosen),
        min_pixels=min_pixels,
        shown_well=shown_well,
        max_difficulty=max_difficulty,
    )
    check_starts(graph)
    if per_target is not None:
        graph = frozen_list(graph, per_target)
    return with_oracle(graph.with_moves(navigate))


def starts(
    graph: ViewGraph,
    split_of: Mapping[str, str],
    *,
    min_pixels: float,
    shown_well: bool,
    max_difficulty: int,
) -> ViewGraph:
    """The graph with its starts: views that show a target, and not yet well.

    Args:
        graph: as recorded.
        split_of: the split of every scene.
        min_pixels: see `thor_graph`, as are the next two.
        shown_well: also where the target is shown well already.
        max_difficulty: of the start.
    """
    assert graph.pair_of is not None
    assert graph.pixels is not None
    assert graph.difficulty is not None
    good = (graph.pixels >= min_pixels) & (graph.difficulty <= max_difficulty)
    if not shown_well:
        good &= ~shows_well(graph)
    view, target = np.nonzero(np.append(good, False)[graph.pair_of])
    numbers = np.array([SPLITS.index(split_of[scene]) for scene in graph.scenes], np.uint8)
    return replace(
        graph,
        start_view=view.astype(np.int32),
        start_target=target.astype(np.int32),
        start_split=numbers[graph.scene_of[view]],
    )


def _table(parts: Sequence[ViewGraph]) -> ViewGraph:
    """Recordings joined without reading what is large in them."""
    size = parts[0].size
    bare = [replace(one, frames=one.frames[:, :0, :0], crops=None) for one in parts]
    graph = join(bare)
    assert graph.boxes is not None
    frames, crops = (
        np.broadcast_to(np.uint8(0), (rows, size, size)) for rows in (len(graph.moves), len(graph.boxes))
    )
    return replace(graph, frames=frames, crops=crops)


class THOREnv(ViewGraphEnv):
    """Look for an object in a simulated room, walk to where it can be told, and name its type.

    Observation and info are `ActiveVisionEnv`'s: `frames` are whole pictures, the box of the target is around
    the pixels of its mask in fractions of them, and `crops` show its surroundings cut from the
    full-resolution picture; box and crop are zeros where the target is out of sight. Actions: the types of
    objects in alphabetical order, then the moves of `navigate`. A move into a wall or thing, or beyond the
    last horizon, is blocked: it stays and costs, without asking the simulator. Rewards and ends follow
    `rules`. Episodes begin where recordings of the subset's scenes say that a target is in sight and not yet
    shown well, drawn uniformly; so many in a row are of one scene, since loading another takes a while.

    With `live` the simulator makes every picture; without, they are taken from the recordings. Where the
    simulator is lost, the episode is truncated, `info["cut"]` says why, and `reset` starts another simulator.

    Example:
        >>> env = gymnasium.make("activelsd/THOR-v0", backend="standin", subset="test")
    """

    def __init__(
        self,
        *,
        subset: str = "train",
        rules: str | Mapping[str, Any] | EpisodeRules = "V0",
        frames: int = 1,
        live: bool = True,
        episodes_per_scene: int = 20,
        render_mode: str | None = None,
        **world: Any,
    ) -> None:
        """Record the scenes on first use.

        Args:
            subset: `train`, `val` or `test`.
            rules: a preset of Table 1 by name, or rules of your own, also as a dict of their fields.
            frames: K, how many views are stacked.
            live: whether the simulator makes the pictures.
            episodes_per_scene: how many in a row are of one scene.
            render_mode: `rgb_array` or None.
            **world: see `thor_graph` and `recording_settings`.
        """
        super().__init__(
            thor_graph(**world, pictures=not live),
            as_rules(rules),
            split=subset,
            frames=frames,
            backend=world.get("backend", AI2THOR),
            render_mode=render_mode,
        )
        self._settings = recording_settings(**{k: v for k, v in world.items() if k in _RECORDING})
        self._live, self._scene, self._stay = live, "", episodes_per_scene
        self._room: WalkableRoom | None = None
        self._refused: set[int] = set()  # views where the agent did not land

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """As the base; where the simulator is lost meanwhile, another begins."""
        while True:
            try:
                return super().reset(seed=seed, options=options)
            except SimulatorLost:  # noqa: PERF203  the client gives up by an error of its own
                self._scene = ""

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """As the base; an episode whose simulator is lost is truncated."""
        try:
            return super().step(action)
        except SimulatorLost as lost:
            self._scene = ""
            return self._observation(), 0.0, False, True, self._info(moved=False) | {"cut": str(lost)}

    def draw_episode(self, options: dict[str, Any]) -> Episode:
        """As the base; live, the agent is put there."""
        episode = super().draw_episode(options)
        if self._live:
            if self._room is None:
                self._room = self._settings.room()
            if episode.scene != self._scene:
                self._room.enter(episode.scene)
                self._scene = episode.scene
            if not self._stand(self._view):
                raise SimulatorLost(f"the agent does not stand where {episode.scene} was recorded")
        return episode

    def starts(self) -> NDArray[np.int64]:
        """Those of the scene where it is, but for every so many episodes."""
        starts, graph = super().starts(), self.graph
        if self._drawn % self._stay == 0:
            return starts
        here: NDArray[np.int64] = starts[
            graph.scene_of[graph.start_view[starts]] == graph.scene_of[self._view]
        ]
        return here

    def look(self) -> View:
        """What the simulator shows, or the recorded view."""
        if not self._live:
            return super().look()
        _, _, target = self.graph.targets[self._target].partition("/")
        return self._settings.camera.view(self._event, target)

    def try_move(self, name: str) -> bool:
        """Follow the edge of that name; live, the simulator may refuse and then is not asked again."""
        before = self._view
        if not super().try_move(name):
            return False
        if not self._live or self._stand(self._view):
            return True
        self._refused.add(self._view)
        self._view = before
        if not self._stand(before):
            raise SimulatorLost("the agent cannot go back to where it was")
        return False

    def close(self) -> None:
        """Stop the simulator."""
        if self._room is not None:
            self._room.simulator.stop()
            self._room, self._scene = None, ""

    def _stand(self, view: int) -> bool:
        assert self._room is not None
        assert self.graph.poses is not None
        event = None if view in self._refused else self._room.stand(Pose.recorded(self.graph.poses[view]))
        if event is not None:
            self._event = event
        return event is not None


def make_vector(
    num_envs: int,
    *,
    subset: str = "train",
    rules: str | Mapping[str, Any] | EpisodeRules = "V0",
    frames: int = 1,
    **world: Any,
) -> ViewGraphVectorEnv:
    """B copies of `THOREnv` on the recordings, advanced together; see `ViewGraphVectorEnv`."""
    # A process that plays a single environment need not wait for PyTorch.
    from activelsd.envs.vector import ViewGraphVectorEnv

    return ViewGraphVectorEnv(
        thor_graph(**world),
        as_rules(rules),
        num_envs=num_envs,
        split=subset,
        frames=frames,
        backend=world.get("backend", AI2THOR),
    )
