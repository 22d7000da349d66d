"""Simulated rooms walked live: the simulator makes every picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.base import Observation
from activelsd.envs.episode import Episode, View
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.thor.lattice import Pose
from activelsd.envs.thor.prepare import recorded_rooms
from activelsd.envs.thor.recordings import view_maker, walkable_room
from activelsd.envs.thor.room import WalkableRoom
from activelsd.envs.thor.settings import THORSettings
from activelsd.errors import SimulatorLost


class LiveTHOREnv(ViewGraphEnv):
    """Episodes of `THORSettings` played in the simulator itself.

    Recordings say where episodes begin and where moves lead, so a blocked move is known without asking. If
    the simulator is lost, the episode is truncated, `info["cut"]` says why, and `reset` starts another
    simulator.
    """

    def __init__(
        self, world: THORSettings, *, split: str, frames: int, render_mode: str | None = None
    ) -> None:
        """Record the scenes on first use. See `WorldSettings.env` for the arguments."""
        super().__init__(
            recorded_rooms(world, pictures=False),
            world.rules.rules(),
            split=split,
            frames=frames,
            backend=world.made_by(),
            render_mode=render_mode,
        )
        self._world, self._camera = world, view_maker(world)
        self._scene = ""
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
        """As the base; the simulator's agent is put there."""
        episode = super().draw_episode(options)
        if self._room is None:
            self._room = walkable_room(self._world)
        if episode.scene != self._scene:
            self._room.enter(episode.scene)
            self._scene = episode.scene
        if not self._stand(self._view):
            raise SimulatorLost(f"the agent does not stand where {episode.scene} was recorded")
        return episode

    def starts(self) -> NDArray[np.int64]:
        """Those of the scene where it is, but for every so many episodes."""
        starts, graph = super().starts(), self.graph
        if self._drawn % self._world.episodes_per_scene == 0:
            return starts
        here: NDArray[np.int64] = starts[
            graph.scene_of[graph.start_view[starts]] == graph.scene_of[self._view]
        ]
        return here

    def look(self) -> View:
        """What the simulator shows."""
        _, _, target = self.graph.targets[self._target].partition("/")
        return self._camera.view(self._event, target)

    def try_move(self, name: str) -> bool:
        """Follow the edge of that name; the simulator may refuse, and then is not asked again."""
        before = self._view
        if not super().try_move(name):
            return False
        if self._stand(self._view):
            return True
        self._refused.add(self._view)
        self._shown.discard(self._view)
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
