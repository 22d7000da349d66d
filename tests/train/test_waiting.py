"""Nothing of a rollout or an update waits for the device: no value is asked for, and nothing is copied to it.

All stands on the meta device, where there is no value to wait for: asking for one raises.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from activelsd.envs.episode import PRESETS
from activelsd.envs.joint import OpenWorld, play_recordings
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.train.actors.resident import ResidentActors
from activelsd.train.learner import Learner
from activelsd.train.settings import Annealed, TrainSettings
from activelsd.train.statistics import Statistics, counts
from activelsd.train.terms import needs_nearer
from tests.graphs import ring_graph, room_graph

WORLDS = {
    "rings": [OpenWorld("rings", ring_graph(), PRESETS["V0"])],
    "rooms": [OpenWorld("rooms", room_graph(size=16), replace(PRESETS["V4"], revisit=False))],
}
WORLDS["both"] = WORLDS["rings"] + WORLDS["rooms"]

MAKERS = (torch.tensor, torch.as_tensor, torch.from_numpy, Tensor.new_tensor)


class NothingComesIn(TorchFunctionMode):
    """Refuses to make a tensor of Python's values on the device, and to bring one from the host."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is Tensor.exponential_:
            kwargs = None  # meta tensors take no generator
        made = func(*args, **(kwargs or {}))
        if isinstance(made, Tensor) and made.is_meta:
            assert func not in MAKERS, "a tensor is made of Python's values"
            assert all(x.is_meta for x in args if isinstance(x, Tensor)), "a tensor comes from the host"
        return made


class Generator(torch.Generator):
    """One that says it is of the meta device, which has none of its own."""

    device = torch.device("meta")

    def __new__(cls, device: Any = None) -> Generator:
        return super().__new__(cls)


@pytest.fixture
def _on_meta(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the meta device lacks: generators, and the norm of a list of gradients at once."""
    clip = torch.nn.utils.clip_grad_norm_
    monkeypatch.setattr(torch, "Generator", Generator)
    monkeypatch.setattr(torch.nn.utils, "clip_grad_norm_", lambda p, norm, foreach: clip(p, norm))


@pytest.mark.usefixtures("_on_meta")
@pytest.mark.parametrize("world", sorted(WORLDS))
@pytest.mark.parametrize(
    "changed", [{}, {"mirror": True, "dropout": 0.5, "terms": {"supervised": 1.0, "guided": 0.5}}], ids=str
)
@pytest.mark.parametrize("annealed", ["numbers", "tensors"])
def test_nothing_waits_for_the_device(world: str, changed: dict[str, Any], annealed: str) -> None:
    settings = TrainSettings(**changed)
    env = play_recordings(WORLDS[world], num_envs=8, frames=1, device="meta")
    shape = NetworkShape(memory="pool", size=16, crops=world != "rings", trunk_settings={"features": 32})
    network = LSDNet(env.tree, shape).to("meta")
    actors = ResidentActors(
        env,
        network,
        settings.length,
        0,
        vary_crops=settings.vary_crops,
        mirror=settings.mirror,
        dropout=settings.dropout,
        nearer=needs_nearer(settings.terms),
    )
    learner, statistics, now = Learner(network, settings), Statistics(actors.places), settings.at(0.1)
    if annealed == "tensors":  # all but the optimiser's, which takes one in a CUDA graph only
        now = Annealed(*torch.zeros(len(now) - 1, device="meta").unbind(), now.learning_rate)
    for _ in range(2):
        with NothingComesIn():
            rollout = actors.collect(Epsilon(now.epsilon_branch, now.epsilon_leaf))
            losses = learner.update(rollout, now)
            statistics.add(counts(rollout, network, losses, actors.places))
    assert losses["loss/total"].is_meta
    assert learner.state()


@pytest.mark.parametrize(
    "wait",
    [
        lambda x: x[0].item(),
        lambda x: x.tolist(),
        lambda x: x.cpu(),
        lambda x: bool((x > 0).any()),
        lambda x: x.nonzero(),
        lambda x: x[x > 0],
        lambda x: torch.tensor([1.0], device=x.device),
        lambda x: torch.zeros(4).to(x.device),
        lambda x: x.copy_(torch.zeros(4)),
    ],
)
def test_waiting_would_be_seen(wait: Callable[[Tensor], Any]) -> None:
    there = torch.ones(4, device="meta")
    with pytest.raises((RuntimeError, NotImplementedError, AssertionError)), NothingComesIn():
        wait(there)
