"""Parts that break their contract: named in one sentence, exit code 2, and nothing left behind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor, nn

from activelsd import cli, registry
from activelsd.envs.settings import WorldSettings
from activelsd.policy.memories import Memory, State
from activelsd.train.terms import Term
from tests.graphs import ring_graph

RINGS = ring_graph(objects=12, classes=2, size=32)
SMALL = ("env.size=32", "policy.trunk.features=16", "train.envs=4", "train.steps=100", "threads=1")
SHAPES = ("env.dataset.train_per_class=3", "env.dataset.test_per_class=1", "env.dataset.classes=[cup,vase]")


class Rings(WorldSettings):
    """A sound world, for others to break."""

    about = "rings"

    @classmethod
    def moves(cls) -> tuple[str, ...]:
        return RINGS.move_names

    def graph(self, progress: Any = None) -> Any:
        return RINGS


class Gray(Rings):
    def graph(self, progress: Any = None) -> Any:
        return replace(RINGS, frames=np.zeros(RINGS.frames.shape, np.float32))


class Lost(Rings):
    def graph(self, progress: Any = None) -> Any:
        return replace(RINGS, labels=RINGS.labels + 5)


class Failing(Rings):
    def graph(self, progress: Any = None) -> Any:
        raise KeyError("camera")


class Empty(Rings):
    def graph(self, progress: Any = None) -> Any:
        return None


class Still(WorldSettings):
    """A world without moves."""


class Wide(nn.Module):
    def __init__(self, channels: int, size: int, features: int) -> None:
        super().__init__()
        self.features = features

    def forward(self, frames: Tensor) -> Tensor:
        return frames.flatten(1).float()


class Nameless(Wide):
    def __init__(self, channels: int, size: int, features: int) -> None:
        nn.Module.__init__(self)


class Growing(Memory):
    def __init__(self, features: int) -> None:
        super().__init__()
        self.outputs, self.shapes = features, {"kept": (features,)}

    def forward(self, features: Tensor, state: State, first: Tensor) -> tuple[Tensor, State]:
        return features, {"kept": state["kept"][:, :3]}


class Vector(Term):
    def forward(self, rollout: Any, output: Any) -> Tensor:
        return output.value


class Raising(Term):
    def forward(self, rollout: Any, output: Any) -> Tensor:
        raise RuntimeError("no such tensor")


class Unmade(Term):
    def __init__(self, network: Any) -> None:
        raise ValueError("needs crops")


@pytest.mark.parametrize(
    ("kind", "part", "words", "sentence"),
    [
        (
            "worlds",
            Gray,
            "env=part",
            "The world 'part' has a graph in which `frames` is float32 (144, 32, 32) and",
        ),
        (
            "worlds",
            Lost,
            "env=part",
            "The world 'part' has a graph in which `labels` must be from 0 to 1; mend it.",
        ),
        ("worlds", Failing, "env=part", "The world 'part' fails (KeyError: 'camera'); mend it."),
        (
            "worlds",
            Empty,
            "env=part",
            "The world 'part' has a graph in which there are no views: it is NoneType",
        ),
        (
            "worlds",
            Still,
            "env=part",
            "The world 'part' fails (NotImplementedError: Still has no moves()); mend it.",
        ),
        (
            "trunks",
            Wide,
            "policy.trunk=part",
            "The trunk 'part' returns (2, 1024) for N = 2 views and must return (N, 16)",
        ),
        ("trunks", Nameless, "policy.trunk=part", "The trunk 'part' cannot be made (AttributeError: "),
        (
            "memories",
            Growing,
            "policy.memory=part",
            "The memory 'part' returns (1, 2, 16) and the state {'kept': (2, 3)}",
        ),
        (
            "terms",
            Vector,
            "train.terms.part=1",
            "The loss term 'part' returns a tensor (5, 4) and must return a scalar",
        ),
        (
            "terms",
            Raising,
            "train.terms.part=1",
            "The loss term 'part' fails (RuntimeError: no such tensor); mend it.",
        ),
        (
            "terms",
            Unmade,
            "train.terms.part=1",
            "The loss term 'part' cannot be made (ValueError: needs crops); mend",
        ),
        ("orbit_moves", 30, "env.navigate=[part]", "The orbit move 'part' is no OrbitMove; mend it."),
    ],
)
def test_a_broken_part_is_named_and_leaves_nothing(
    kind: str,
    part: object,
    words: str,
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(getattr(registry, kind)._added, "part", part)
    world = () if words.startswith("env=") else ("env=modelnet", *SHAPES)
    assert cli.main(["train", *world, words, *SMALL, f"runs={tmp_path}/runs"]) == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert err.startswith(f"activelsd: {sentence}")
    assert not list(tmp_path.glob("runs/*"))


def test_a_sound_world_of_this_kind_trains(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(registry.worlds._added, "part", Rings)
    assert cli.main(["train", "env=part", *SMALL, f"runs={tmp_path}"]) == 0
    assert list(tmp_path.glob("*/checkpoints/*/network.safetensors"))
