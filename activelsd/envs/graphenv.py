"""A single environment on a `ViewGraph`: the recorded backend of `ActiveVisionEnv`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.actions import ActionTree
from activelsd.envs.base import ActiveVisionEnv
from activelsd.envs.draws import draw, draw_key
from activelsd.envs.episode import Episode, EpisodeRules, View
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import DataError


def tree_of(graph: ViewGraph) -> ActionTree:
    """The action tree of a graph's classes and moves. Raises DataError if the graph has no moves."""
    if not graph.move_names:
        raise DataError("This graph of views has no moves; name at least one in `navigate`.")
    return ActionTree.answer_or_move(graph.classes, graph.branches)


class ViewGraphEnv(ActiveVisionEnv):
    """Draws episodes uniformly from a split's starts. See `ActiveVisionEnv` for spaces and info."""

    knows_moves = True

    def __init__(
        self,
        graph: ViewGraph,
        rules: EpisodeRules,
        *,
        split: str = "train",
        frames: int = 3,
        backend: str = "recording",
        render_mode: str | None = None,
    ) -> None:
        super().__init__(
            tree_of(graph),
            rules,
            size=graph.size,
            frames=frames,
            crops=graph.crops is not None,
            channels=graph.channels,
            features=graph.features_shape,
            backend=backend,
            render_mode=render_mode,
        )
        self.graph = graph
        self._starts = graph.starts(split)
        self._column = {name: i for i, name in enumerate(graph.move_names)}
        self._key: int | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Resets as the base does; a seed begins a new stream of episodes, with None the stream continues."""
        if seed is not None:
            self._key = None
        return super().reset(seed=seed, options=options)

    def draw_episode(self, options: dict[str, Any]) -> Episode:
        """Begins the stream's next episode, or the one whose id is `options["episode"]`."""
        if self._key is None:
            self._key, self._drawn = draw_key(self.np_random), 0
        if "episode" in options:
            row = self.graph.find(options["episode"])
        else:
            key, count, starts = np.array([self._key]), np.array([self._drawn]), self.starts()
            row = int(starts[draw(key, count, len(starts))[0]])
            self._drawn += 1
        self._view, self._target = int(self.graph.start_view[row]), int(self.graph.start_target[row])
        self._shown = {self._view}
        return self.graph.episode(row)

    def starts(self) -> NDArray[np.int64]:
        """Start rows that the next episode is drawn from."""
        return self._starts

    def look(self) -> View:
        """The recorded view."""
        graph = self.graph
        crop = None if graph.crops is None else graph.crop(self._view, self._target)
        features = None if graph.features is None else graph.features_of(self._view, self._target)
        return View(graph.frames[self._view], graph.target_box(self._view, self._target), crop, features)

    def try_move(self, name: str) -> bool:
        """Follows the edge with that name, if there is one."""
        to = int(self.graph.moves[self._view, self._column[name]])
        if to >= 0:
            self._view = to
            self._shown.add(to)
        return to >= 0

    def action_mask(self) -> NDArray[np.bool_]:
        """See the base; without `revisit` moves to views shown before are left out if another is left."""
        mask = super().action_mask()
        if not self.rules.revisit:
            legal, to = mask[self.tree.moves], self.graph.moves[self._view]
            known = np.isin(to, list(self._shown))
            if (legal & ~known & (to >= 0)).any():
                legal &= ~known  # which is a part of the mask
        return mask
