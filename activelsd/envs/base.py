"""The Gymnasium environment of all worlds: rules, rewards, ends, stacking; a backend looks and moves."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from typing import Any, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.actions import CLASSIFY, ActionTree
from activelsd.envs.episode import Episode, EpisodeRules, View
from activelsd.errors import ConfigError, did_you_mean

Observation = dict[str, NDArray[Any]]


def observation_space(
    size: int, frames: int, *, crops: bool, channels: int = 1, features: tuple[int, int] | None = None
) -> gymnasium.spaces.Dict:
    """The observations of every world: `frames` (K C, S, S), `target` (K, 5), optionally `crops` (K C, S, S).

    With `features`, (W, F), also those of a frozen trunk for W variants of every view, float16 (K, W, F).

    Raises:
        ConfigError: `frames` is less than 1.
    """
    if frames < 1:
        raise ConfigError(f"frames={frames} stacks no view; set it to at least 1.")
    spaces: dict[str, gymnasium.Space[Any]] = {
        "frames": gymnasium.spaces.Box(0, 255, (frames * channels, size, size), np.uint8),
        "target": gymnasium.spaces.Box(0.0, 1.0, (frames, 5), np.float32),
    }
    if crops:
        spaces["crops"] = gymnasium.spaces.Box(0, 255, (frames * channels, size, size), np.uint8)
    if features is not None:
        spaces["features"] = gymnasium.spaces.Box(-np.inf, np.inf, (frames, *features), np.float16)
    return gymnasium.spaces.Dict(spaces)


class ActiveVisionEnv(gymnasium.Env[Observation, np.int64]):
    """An agent looks at a target, moves to better views, and names the target's class.

    Every step is either an answer (an action of the `classify` branch) or a move (any other action). A move
    gives the next view, a blocked move repeats the view, and an answer does not change it. A blocked move
    is not legal again at the same view, unless the rules allow it. If the rules forbid to revisit views, a
    move to one that the episode has shown is illegal as long as another leads to a new one; this needs an
    environment that `knows_moves`. The T-th action is the last: only answers are legal then.
    `info["action_mask"]` marks the legal actions. An agent that repeats a blocked move is blocked again; one
    that moves at the last action ends the episode without an answer.

    Observation: `Dict` of `frames` uint8 (K C, S, S), K views of C channels each (1 in gray; 3, red, green
    and blue, in colour), newest last, with K copies of the first view at reset; `target` float32 (K, 5), the
    box as fractions of the frame and whether it is in sight; `crops` uint8 (K C, S, S) if `crops` is on. It
    contains no label, pose or scene.

    Info: `views` seen so far, `moved` (the last action changed the view), `action_mask` bool (n,), and about
    the episode `episode_id` (pass it to `reset(options={"episode": id})` to replay), `scene`, `target`,
    `label`, `start`, `split` and, if known, `oracle_views`; `backend` names the source of the images. If a
    simulator fails, the episode is truncated and `cut` says why; such an episode must not be learned from.

    A backend implements:
        draw_episode: chooses an episode with `self.np_random` and puts the agent at its start.
        look: returns the view at the agent's place.
        try_move: makes a move; returns False if it is blocked.

    Set by the constructor:
        tree: the actions and their names.
        rules: rewards and ends.
        backend: source of the images, for example `modelnet` or `standin`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012
    reset_options: tuple[str, ...] = ("episode",)
    """Names that `reset` accepts in `options`; a backend that reads more adds them."""
    knows_moves = False
    """Whether it is known before a move to which view it leads; `action_mask` can heed `revisit` then."""

    def __init__(
        self,
        tree: ActionTree,
        rules: EpisodeRules,
        *,
        size: int,
        frames: int,
        crops: bool,
        channels: int = 1,
        features: tuple[int, int] | None = None,
        backend: str,
        render_mode: str | None = None,
    ) -> None:
        """Build for a tree of actions, rules, and pictures of a size.

        Raises:
            ConfigError: the rules forbid to revisit views, and where moves lead is not known beforehand.
        """
        if not rules.revisit and not self.knows_moves:
            raise ConfigError(
                f"env.rules.revisit=false needs recorded views, since {backend} does not know to which view a"
                " move leads; leave it true, or record the views."
            )
        self.tree = tree
        self.rules = rules
        self.backend = backend
        self.render_mode = render_mode
        # Gymnasium's types say that a Dict holds spaces; its elements are arrays.
        space = observation_space(size, frames, crops=crops, channels=channels, features=features)
        self.observation_space = cast("gymnasium.Space[Observation]", space)
        self.action_space = gymnasium.spaces.Discrete(tree.n)
        self._answers = tree.span(CLASSIFY)
        self._crops, self._features = crops, features is not None
        self._seen: deque[View] = deque(maxlen=frames)
        self._episode: Episode | None = None

    @abstractmethod
    def draw_episode(self, options: dict[str, Any]) -> Episode:
        """Chooses an episode and puts the agent at its start; `options["episode"]` is an id to replay."""

    @abstractmethod
    def look(self) -> View:
        """The view at the agent's place."""

    @abstractmethod
    def try_move(self, name: str) -> bool:
        """Makes a move; returns False and changes nothing if it is blocked."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode: `views` is 1, and all K stacked views are copies of the first.

        Raises:
            ConfigError: there is no option of that name.
        """
        for name in options or {}:
            if name not in self.reset_options:
                hint = did_you_mean(name, self.reset_options)
                raise ConfigError(f"There is no reset option '{name}'; {hint}")
        super().reset(seed=seed)
        self._episode = self.draw_episode(options or {})
        self._taken, self._views = 0, 1
        self._blocked: set[int] = set()
        view = self.look()
        for _ in range(self._seen.maxlen or 1):
            self._seen.append(view)
        return self._observation(), self._info(moved=False)

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Answers or moves.

        Raises:
            ResetNeeded: `reset` was not called yet.
            InvalidAction: the tree has no such action.
        """
        if self._episode is None:
            raise gymnasium.error.ResetNeeded("Call reset before the first step.")
        rules, action = self.rules, int(action)
        if not 0 <= action < self.tree.n:
            raise gymnasium.error.InvalidAction(
                f"There is no action {action}; actions are 0 to {self.tree.n - 1}."
            )
        last = self._taken + 1 >= rules.max_views
        self._taken += 1
        if self._answers.start <= action < self._answers.stop:
            moved = False
            right = action - self._answers.start == self._episode.label
            reward = rules.right if right else rules.wrong
            terminated = rules.ends_on_right if right else rules.ends_on_wrong
        else:
            moved = rules.can_move and not last and self.try_move(self.tree.names[action][1])
            reward = rules.move if moved else rules.blocked
            terminated = False
            self._blocked = set() if moved or rules.try_again else self._blocked | {action}
            if not last:
                self._views += 1
                self._seen.append(self.look())
        return self._observation(), reward, terminated, last and not terminated, self._info(moved=moved)

    def render(self) -> NDArray[np.uint8] | None:
        """The newest frame as RGB (S, S, 3) in mode `rgb_array`."""
        if self.render_mode is None or not self._seen:
            return None
        from activelsd.envs.colour import channels_last, in_colour  # playing does without OpenCV

        return np.ascontiguousarray(in_colour(channels_last(self._seen[-1].frame), "rgb"))

    def action_mask(self) -> NDArray[np.bool_]:
        """bool (n,): the legal actions; only answers if the rules forbid moves or this action is the last."""
        mask = np.ones(self.tree.n, bool)
        mask[list(self._blocked)] = False
        if not self.rules.can_move or self._taken + 1 >= self.rules.max_views:
            mask[:] = False
            mask[self._answers] = True
        return mask

    def _observation(self) -> Observation:
        observation: Observation = {
            "frames": _stacked([view.frame for view in self._seen]),
            "target": np.stack([view.target for view in self._seen]),
        }
        if self._crops:
            observation["crops"] = _stacked([view.crop for view in self._seen if view.crop is not None])
        if self._features:
            observation["features"] = np.stack([v.features for v in self._seen if v.features is not None])
        return observation

    def _info(self, *, moved: bool) -> dict[str, Any]:
        episode = self._episode
        assert episode is not None
        info: dict[str, Any] = {
            "views": self._views,
            "moved": moved,
            "action_mask": self.action_mask(),
            "backend": self.backend,
            "episode_id": episode.id,
            "scene": episode.scene,
            "target": episode.target,
            "label": episode.label,
            "start": episode.start,
            "split": episode.split,
        }
        if episode.oracle_views is not None:
            info["oracle_views"] = episode.oracle_views
        return info


def _stacked(pictures: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """(K C, S, S) of K pictures, (S, S) or (C, S, S)."""
    return np.stack(pictures).reshape(-1, *pictures[0].shape[-2:])
