"""B episodes on a `ViewGraph`, advanced by array indexing on the CPU or on the network's GPU."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.actions import CLASSIFY
from activelsd.envs.base import observation_space
from activelsd.envs.draws import draw, draw_key
from activelsd.envs.episode import WHOLE_FRAME, EpisodeRules
from activelsd.envs.graphenv import tree_of
from activelsd.envs.oracle import Guide
from activelsd.envs.viewgraph import ViewGraph

STATE = ("keys", "drawn", "row", "seen", "taken", "views", "blocked", "shown")
"""Attributes that, with the graph and the rules, fix how a `ViewGraphVectorEnv` continues."""


class Step(NamedTuple):
    """The results of B actions, before ended episodes are replaced."""

    reward: Tensor  # (B,) float32
    terminated: Tensor  # (B,) bool
    truncated: Tensor  # (B,) bool
    answer: Tensor  # (B,) int64 class answered, -1 for a move
    moved: Tensor  # (B,) bool
    views: Tensor  # (B,) int64 views seen when the action was taken
    row: Tensor  # (B,) int64 start row of the episode


class ViewGraphVectorEnv(VectorEnv[Any, NDArray[np.int64], NDArray[Any]]):
    """B environments that behave exactly like `ViewGraphEnv`, in SAME_STEP autoreset mode.

    Two interfaces share one state. Gymnasium's `reset` and `step` use NumPy and fill `info`. The resident
    trainer uses `begin`, `observe` and `advance`: their tensors are on `device` and never copied to the host.

    With a `playlist` of start rows, episodes are taken from it instead of drawn: environment i plays rows i,
    i+B, i+2B, … and then repeats the playlist's last row.

    `pictures` names what observations hold of frames and crops: a network that is given features needs fewer.
    With `variants`, features are those of all variants of a view.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    _keys: Tensor  # (B,) int64 key of each environment's stream of episodes
    _drawn: Tensor  # (B,) int64 number of episodes begun
    _blocked: Tensor  # (B, n) bool moves that were found blocked at the current view
    _shown: Tensor  # (B, T) int64 views of the episode so far, then -1; (B, 0) if the rules ignore them

    def __init__(
        self,
        graph: ViewGraph,
        rules: EpisodeRules,
        *,
        num_envs: int,
        split: str = "train",
        frames: int = 3,
        backend: str = "recording",
        device: str | torch.device = "cpu",
        playlist: NDArray[np.int64] | None = None,
        pictures: Sequence[str] = ("frames", "crops"),
        variants: bool = False,
    ) -> None:
        self.num_envs = num_envs
        self.graph, self.tree, self.rules = graph, tree_of(graph), rules
        self.device = torch.device(device)
        self.backend = backend
        self.single_observation_space = observation_space(
            graph.size,
            frames,
            crops=graph.crops is not None,
            channels=graph.channels,
            features=graph.features_shape,
        )
        self.single_action_space = gymnasium.spaces.Discrete(self.tree.n)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._k, self._pictures, self._variants = frames, frozenset(pictures), variants
        self._guide: Guide | None = None
        self._answers = self.tree.span(CLASSIFY)
        self._load(playlist if playlist is not None else graph.starts(split))
        self._listed = playlist is not None

    def _load(self, rows: NDArray[np.int64]) -> None:
        """Copies the graph's arrays to the device."""
        graph = self.graph

        def put(array: NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.asarray(array)).to(self.device)

        self._frames = put(graph.frames)
        self._moves = put(graph.moves).long()
        self._labels = put(graph.labels)
        self._start_view, self._start_target = put(graph.start_view).long(), put(graph.start_target).long()
        self._rows = put(rows)
        self._pairs = None
        # One extra row at the end stands for "out of sight": its box and crop are zeros.
        if graph.pair_of is not None and graph.boxes is not None:
            self._pairs = put(np.where(graph.pair_of >= 0, graph.pair_of, np.int32(len(graph.boxes))))
            boxes = torch.cat([put(graph.boxes), torch.ones(len(graph.boxes), 1, device=self.device)], 1)
            self._boxes = torch.cat([boxes, boxes.new_zeros(1, 5)])
        if graph.crops is not None:
            crops = put(graph.crops)
            self._crops = torch.cat([crops, crops.new_zeros(1, *crops.shape[1:])])
        self._features = [put(one) for one in graph.features or ()]
        self._whole = torch.tensor(WHOLE_FRAME, device=self.device)
        self._only_answers = torch.zeros(self.tree.n, dtype=torch.bool, device=self.device)
        self._only_answers[self._answers] = True
        self._remembers = bool((graph.moves < 0).any()) and not self.rules.try_again

    def begin(self, seed: int | list[int | None] | None = None) -> None:
        """Starts B episodes; environment i draws the same ones as a single environment with seed `seed + i`.

        A seed begins a new stream; with None, an existing stream continues.

        Raises:
            ValueError: a list of seeds does not have one item (or None) per environment.
        """
        b, device = self.num_envs, self.device
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + i for i in range(b)]
        if len(seeds) != b:
            raise ValueError(f"There are {b} environments but {len(seeds)} seeds; give one for each.")
        begun = hasattr(self, "_keys")
        keys = torch.tensor([draw_key(np_random(s)[0]) for s in seeds], device=device)
        fresh = torch.tensor([s is not None or not begun for s in seeds], device=device)
        self._keys = torch.where(fresh, keys, self._keys) if begun else keys
        self._row = torch.zeros(b, dtype=torch.int64, device=device)
        self._drawn = self._drawn.masked_fill(fresh, 0) if begun else torch.zeros_like(self._row)
        self._seen = torch.zeros(b, self._k, dtype=torch.int64, device=device)
        self._taken, self._views = torch.zeros_like(self._row), torch.ones_like(self._row)
        self._blocked = torch.zeros(b, self.tree.n, dtype=torch.bool, device=device)
        self._shown = self._row.new_zeros(b, 0 if self.rules.revisit else self.rules.max_views)
        self._replace(torch.ones(b, dtype=torch.bool, device=device))

    def _replace(self, ended: Tensor) -> None:
        """Replaces every ended episode by its environment's next one, without waiting for the device."""
        if self._listed:
            index = torch.arange(self.num_envs, device=self.device) + self._drawn * self.num_envs
            index = index.clamp(max=len(self._rows) - 1)
        else:
            index = draw(self._keys, self._drawn, len(self._rows))
        row = self._rows[index]
        self._row = torch.where(ended, row, self._row)
        self._seen = torch.where(ended[:, None], self._start_view[row][:, None], self._seen)
        self._target = self._start_target[self._row]
        self._taken = self._taken.masked_fill(ended, 0)
        self._views = self._views.masked_fill(ended, 1)
        if self._remembers:
            self._blocked = self._blocked & ~ended[:, None]
        if not self.rules.revisit:
            self._shown = torch.where(ended[:, None], -1, self._shown)
            self._shown[:, 0] = torch.where(ended, self._start_view[row], self._shown[:, 0])
        self._drawn = self._drawn + ended

    def state(self) -> dict[str, Tensor]:
        """The state of all episodes, for `load_state`."""
        return {name: getattr(self, f"_{name}") for name in STATE}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Restores what `state` returned."""
        for name in STATE:
            # Checkpoints of older versions do not hold the views shown, which nobody asked for then.
            if name in tensors or name != "shown" or not self.rules.revisit:
                setattr(self, f"_{name}", tensors[name].to(self.device))
        self._target = self._start_target[self._row]

    def observe(self) -> dict[str, Tensor]:
        """`frames` uint8 (B, K C, S, S), `target` float32 (B, K, 5), and `crops` if the graph has them.

        If the graph has features, also `features` float16 (B, K, F), or (B, K, W, F) for all variants.
        """
        observation = {}
        if "frames" in self._pictures:
            observation["frames"] = _pictures(self._frames, self._seen)
        shown = self._seen
        if self._pairs is None:
            observation["target"] = self._whole.expand(*self._seen.shape, 5)
        else:
            pairs = self._pairs[self._seen, self._target[:, None]]
            observation["target"] = _rows(self._boxes, pairs)
            if self.graph.crops is not None:
                shown = pairs
                if "crops" in self._pictures:
                    observation["crops"] = _pictures(self._crops, pairs)
        if self._features:
            found = [_rows(one, shown) for one in self._features[: None if self._variants else 1]]
            observation["features"] = torch.stack(found, 2) if self._variants else found[0]
        return observation

    @property
    def labels(self) -> Tensor:
        """(B,) int64 class of each target."""
        return self._labels[self._target]

    @property
    def targets(self) -> Tensor:
        """(B,) int64 target index of each episode."""
        return self._target

    def views_seen(self) -> Tensor:
        """(B, K) int64 indices of the stacked views, newest last."""
        return self._seen

    @property
    def drawn(self) -> Tensor:
        """(B,) int64 number of episodes that each environment has begun."""
        return self._drawn

    def mask(self) -> Tensor:
        """(B, n) bool: the legal actions."""
        if not self.rules.can_move:
            return self._only_answers.expand(self.num_envs, -1)
        may = (self._taken + 1 < self.rules.max_views)[:, None].expand(-1, self.tree.n)
        if self._remembers:
            may = may & ~self._blocked
        if not self.rules.revisit:
            may = may & ~self._returning(may)
        return self._only_answers | may

    def _returning(self, may: Tensor) -> Tensor:
        """(B, n) bool: moves to views shown before, where one of those that `may` be made leads elsewhere."""
        to = self._moves[self._seen[:, -1]]
        known = ((to[:, :, None] == self._shown[:, None]) & (to >= 0)[:, :, None]).any(-1)
        known = known & (may[:, self.tree.moves] & (to >= 0) & ~known).any(-1, keepdim=True)
        return torch.cat([torch.zeros_like(may[:, : self._answers.stop]), known], 1)

    def nearer(self) -> Tensor:
        """(B, n) bool: the moves on a shortest path to a good view; all False if targets have no boxes."""
        nearer = torch.zeros(self.num_envs, self.tree.n, dtype=torch.bool, device=self.device)
        if self._pairs is not None:
            if self._guide is None:  # computed only on demand: it takes a while
                self._guide = Guide(self.graph, self.device)
            nearer[:, self._answers.stop :] = self._guide.nearer(self._seen[:, -1], self._target)
        return nearer

    def advance(self, actions: Tensor) -> Step:
        """Takes B actions (int64, (B,)); episodes that end are replaced by the next ones at once."""
        rules = self.rules
        answers = self._only_answers[actions]
        answer = torch.where(answers, actions - self._answers.start, -1)
        right = answer == self.labels
        last = self._taken + 1 >= rules.max_views

        # Moves. The columns of the graph's `moves` are the actions that are not answers, in order.
        column = (actions - self._answers.stop).clamp(min=0)
        to = self._moves[self._seen[:, -1], column]
        tried = ~answers & ~last
        moved = tried & (to >= 0) if rules.can_move else torch.zeros_like(tried)
        here = torch.where(moved, to, self._seen[:, -1])
        pushed = torch.cat([self._seen[:, 1:], here[:, None]], 1)
        self._seen = torch.where(tried[:, None], pushed, self._seen)
        if not self.rules.revisit:
            at = self._views.clamp(max=rules.max_views - 1)[:, None]  # past the end nothing is tried
            self._shown = torch.where(tried[:, None], self._shown.scatter(1, at, here[:, None]), self._shown)

        # Rewards and ends, Table 1.
        answer_reward = torch.where(right, rules.right, rules.wrong)
        move_reward = torch.where(moved, rules.move, rules.blocked)
        reward = torch.where(answers, answer_reward, move_reward).float()
        terminated = answers & ((right & rules.ends_on_right) | (~right & rules.ends_on_wrong))
        truncated = last & ~terminated
        self._taken = self._taken + 1
        views, row = self._views, self._row
        self._views = self._views + tried
        if self._remembers:
            tries = torch.zeros_like(self._blocked).scatter_(1, actions[:, None], (tried & ~moved)[:, None])
            self._blocked = (self._blocked | tries) & ~moved[:, None]
        self._final = (self._seen, self._target, self._taken, self._blocked, self._shown)
        self._replace(terminated | truncated)
        return Step(reward, terminated, truncated, answer, moved, views, row)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Gymnasium's reset: begins B episodes; it has no options.

        Raises:
            ValueError: an option is given.
        """
        if options:
            raise ValueError(f"A batch has no reset option '{next(iter(options))}'; give no options.")
        super().reset(seed=next((s for s in seed if s is not None), None) if isinstance(seed, list) else seed)
        self.begin(seed)
        rows = self._row.tolist()
        return self._numpy(self.observe()), self._infos(rows, self._views, torch.zeros(self.num_envs) > 0)

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[dict[str, NDArray[Any]], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Gymnasium's step; if an episode ends, `final_obs` and `final_info` hold its last step."""
        step = self.advance(torch.as_tensor(actions, device=self.device).long())
        ended = step.terminated | step.truncated
        infos = self._infos(self._row.tolist(), self._views, step.moved & ~ended)
        if bool(ended.any()):
            self._add_finals(infos, step, ended.cpu().numpy())
        reward, terminated, truncated = (x.cpu().numpy() for x in step[:3])
        return self._numpy(self.observe()), reward, terminated, truncated, infos

    def _numpy(self, observation: dict[str, Tensor]) -> dict[str, NDArray[Any]]:
        # Copies, never views of the environment's own arrays: a caller may keep them and write to them.
        return {name: np.array(value.cpu().numpy(), order="C") for name, value in observation.items()}

    def _infos(
        self, rows: list[int], views: Tensor, moved: Tensor, of: NDArray[np.bool_] | None = None
    ) -> dict[str, Any]:
        """Gymnasium's dict of arrays for all environments, or for those in the mask `of`, bool (B,)."""
        episodes = [self.graph.episode(row) for row in rows]
        infos: dict[str, Any] = {
            "views": views.cpu().numpy().copy(),
            "moved": moved.cpu().numpy().copy(),
            "action_mask": self.mask().cpu().numpy().copy(),
            "backend": np.array([self.backend] * len(rows), object),
            "episode_id": np.array([e.id for e in episodes], object),
            "label": np.array([e.label for e in episodes]),
        }
        for name in ("scene", "target", "start", "split"):
            infos[name] = np.array([getattr(e, name) for e in episodes], object)
        if self.graph.oracle_views is not None:
            infos["oracle_views"] = self.graph.oracle_views[rows]
        of = np.ones(len(rows), bool) if of is None else of
        for values in infos.values():
            values[~of] = None if values.dtype == object else 0
        return infos | {f"_{name}": of.copy() for name in infos}

    def _add_finals(self, infos: dict[str, Any], step: Step, ended: NDArray[np.bool_]) -> None:
        """Adds the last observation and info of the episodes that ended in this step."""
        now = self._seen, self._target, self._taken, self._blocked, self._shown
        self._seen, self._target, self._taken, self._blocked, self._shown = self._final
        last = self._numpy(self.observe())
        infos["final_info"] = self._infos(step.row.tolist(), step.views, step.moved, ended)
        self._seen, self._target, self._taken, self._blocked, self._shown = now
        infos["final_obs"] = np.array(
            [{k: v[i] for k, v in last.items()} if ended[i] else None for i in range(self.num_envs)], object
        )
        infos["_final_obs"], infos["_final_info"] = ended.copy(), ended.copy()


def _rows(table: Tensor, index: Tensor) -> Tensor:
    """`table[index]`, by `index_select`: it copies whole rows, while indexing copies byte by byte."""
    return table.index_select(0, index.flatten()).view(*index.shape, *table.shape[1:])


def _pictures(table: Tensor, index: Tensor) -> Tensor:
    """(B, K C, S, S) of the pictures, (N, [C,] S, S), at an index (B, K)."""
    return _rows(table, index).flatten(1, -3)
