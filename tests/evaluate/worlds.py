"""Tiny worlds, untrained networks with opinions, and players that check how they are called."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.graphenv import tree_of
from activelsd.envs.vector import ViewGraphVectorEnv
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.protocol import EpisodeRow, Insider, Player
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.policy.memories import LSTM

CLASSES = ("cup", "door", "night_stand")
RULES = EpisodeRules(max_views=6)


def ring(
    objects: int = 9, views: int = 6, size: int = 16, moves: tuple[str, ...] = ("wall", "cw", "half")
) -> ViewGraph:
    """Rings of random pictures; the last of every three objects is for tests, the middle one for val.

    `cw` goes on by one view, `half` by half the ring, and `wall` leads on from one view and is blocked at
    all others.
    """
    rng = np.random.default_rng(5)
    # Coarse blocks, some pictures dark and some bright: networks that have learned nothing tell them apart.
    blocks = rng.integers(0, 256, (objects * views, 4, 4)) * rng.random((objects * views, 1, 1))
    frames = blocks.repeat(size // 4, 1).repeat(size // 4, 2)
    angle, first = np.arange(objects * views) % views, np.arange(objects * views) // views * views
    leads = {
        "cw": first + (angle + 1) % views,
        "half": first + (angle + views // 2) % views,
        "wall": np.where(angle == 2, first + 4, -1),
    }
    names = tuple(f"{CLASSES[i % 3]}/{i:02d}" for i in range(objects))
    return ViewGraph(
        frames=frames.astype(np.uint8),
        moves=np.stack([leads[move] for move in moves], 1).astype(np.int32),
        move_names=moves,
        classes=CLASSES,
        targets=names,
        labels=np.arange(objects) % 3,
        scenes=names,
        scene_of=np.repeat(np.arange(objects, dtype=np.int32), views),
        view_names=tuple(f"a{i}" for i in range(views)) * objects,
        start_view=np.arange(objects * views, dtype=np.int32),
        start_target=np.repeat(np.arange(objects, dtype=np.int32), views),
        start_split=np.repeat((np.arange(objects) // 3 % 3).astype(np.uint8), views),
    )


def rings(*lengths: int) -> ViewGraph:
    """Rings of unlike lengths as objects of one graph, `cw` once around; all for tests."""
    parts = [ring(1, views, moves=("half", "cw")) for views in lengths]
    first = np.repeat(np.cumsum([0, *lengths[:-1]]), lengths)
    object_of, count = np.repeat(np.arange(len(lengths)), lengths), len(first)
    names = tuple(f"cup/{i:02d}" for i in range(len(lengths)))
    return ViewGraph(
        frames=np.concatenate([part.frames for part in parts]),
        moves=(np.concatenate([part.moves for part in parts]) + first[:, None]).astype(np.int32),
        move_names=parts[0].move_names,
        classes=CLASSES,
        targets=names,
        labels=np.zeros(len(names), np.int64),
        scenes=names,
        scene_of=object_of.astype(np.int32),
        view_names=tuple(name for part in parts for name in part.view_names),
        start_view=np.arange(count, dtype=np.int32),
        start_target=object_of.astype(np.int32),
        start_split=np.full(count, 2, np.uint8),
    )


def network(graph: ViewGraph, memory: str = "pool", head: str = "tree", seed: int = 2) -> LSDNet:
    """Untrained, scaled so that every output says yes to some views and no to others; it likes to move."""
    torch.manual_seed(seed)
    frames = 3 if memory == "stack" else 1
    shape = NetworkShape(
        memory=memory, head=head, size=graph.size, trunk_settings={"features": 16}, frames=frames
    )
    net = LSDNet(tree_of(graph), shape)
    every = np.arange(len(graph.start_view))
    env = ViewGraphVectorEnv(graph, RULES, num_envs=len(every), frames=frames, playlist=every)
    env.begin(0)
    state, first, logits = net.initial_state(len(every)), torch.ones(1, len(every), dtype=torch.bool), []
    with torch.no_grad():
        if isinstance(net.memory, LSTM):
            # Else what it has seen says less than for how long it has looked.
            net.memory.cell.weight_ih.mul_(60.0)
        for _ in range(4):
            output = net({name: look[None] for name, look in env.observe().items()}, state, first)
            state, first = output.state, torch.zeros_like(first)
            logits.append(output.logits[0])
            env.advance(torch.full((len(every),), net.tree.n - 1))
        mean, std = torch.cat(logits).mean(0), torch.cat(logits).std(0)
        net.policy.weight.div_(std[:, None])
        net.policy.bias.copy_(-mean / std)
        if head == "tree":
            net.policy.bias[1] += 0.7
    return net


class Checked:
    """A player watched from outside: every call must be one that the protocol promises."""

    def __init__(self, player: Player, graph: ViewGraph) -> None:
        self.player, self.name, self.frames = player, player.name, player.frames
        self.graph, self.n = graph, tree_of(graph).n
        self.begun = self.acted = 0
        self._batch: int | None = None

    def begin(self, batch: int) -> None:
        assert batch >= 1
        self.begun += 1
        self._batch, self._over = batch, torch.ones(batch, dtype=torch.bool)
        self.player.begin(batch)

    def tell(self, views: Tensor, targets: Tensor) -> None:
        assert views.shape == targets.shape == (self._batch,)
        if isinstance(self.player, Insider):
            self.player.tell(views, targets)

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        b, s = self._batch, self.graph.size
        assert b is not None, "begin comes first"
        assert observation["frames"].shape == (b, self.frames, s, s)
        assert observation["frames"].dtype == torch.uint8
        assert observation["target"].shape == (b, self.frames, 5)
        assert not observation.keys() & {"label", "scene", "pose", "view"}
        assert mask.shape == (b, self.n)
        assert mask.dtype == first.dtype == torch.bool
        assert mask.any(1).all()
        assert torch.equal(first, self._over), "first is where the last answer ended an episode"
        assert torch.is_inference_mode_enabled()
        actions = self.player.act(observation, mask, first)
        assert actions.shape == (b,)
        assert actions.dtype == torch.int64
        assert mask.gather(1, actions[:, None]).all()
        self._over = actions < len(self.graph.classes)
        self._actions = actions
        self.acted += 1
        return actions

    def answer(self) -> Tensor:
        answers = self.player.answer()
        assert answers.shape == (self._batch,)
        assert answers.dtype == torch.int64
        assert ((answers >= 0) & (answers < len(self.graph.classes))).all()
        assert torch.equal(answers[self._over], self._actions[self._over]), "it names what it would name"
        return answers


class Scripted:
    """Does as a function of the views it has seen in this episode says; nothing else is looked at."""

    frames = 1

    def __init__(self, decide: Callable[[list[int], bool], int], name: str = "scripted") -> None:
        self.name, self._decide = name, decide

    def begin(self, batch: int) -> None:
        self._seen: list[list[int]] = [[] for _ in range(batch)]

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        sums = observation["frames"].flatten(1).sum(1).tolist()
        may_move = mask.all(1).tolist()
        actions = []
        for i, (look, begins, free) in enumerate(zip(sums, first.tolist(), may_move, strict=True)):
            self._seen[i] = [look] if begins else [*self._seen[i], look]
            actions.append(self._decide(self._seen[i], free))
        self._last = torch.tensor(actions)
        return self._last

    def answer(self) -> Tensor:
        return self._last.clamp(max=len(CLASSES) - 1)


def row(**changed: object) -> EpisodeRow:
    """An episode's row with two views, answered right."""
    values: dict[str, object] = {
        "player": "trained",
        "world": "rings",
        "backend": "random",
        "scene": "cup/00",
        "target": "cup/00",
        "label": "cup",
        "start": "a0",
        "views": 2,
        "answer": "cup",
        "right": True,
        "forced": False,
        "oracle_views": None,
        "difficulty": None,
        "path": ("a0", "a1"),
        "answers": ("door", "cup"),
    }
    return EpisodeRow(**(values | changed))  # type: ignore[arg-type]
