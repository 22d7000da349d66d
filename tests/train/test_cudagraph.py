"""Training on a GPU: nothing waits for it, a CUDA graph does what its kernels do, and runs resume."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import OpenWorld, union
from activelsd.errors import ConfigError
from activelsd.policy.heads import Epsilon
from activelsd.policy.lsdnet import NetworkShape
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.cudagraph import WARM_UPS, GraphedUpdate
from activelsd.train.parallel import ALONE, Group
from activelsd.train.run import Run
from activelsd.train.settings import Annealed, GA3CSettings, TrainSettings
from activelsd.train.statistics import Counts, Statistics
from activelsd.train.trainer import Trainer
from tests.graphs import ring_graph, room_graph

RINGS = [OpenWorld("rings", ring_graph(), PRESETS["V0"])]
ROOMS = [OpenWorld("rooms", room_graph(size=16), PRESETS["V4"])]
WORLDS = {"rings": RINGS, "rooms": ROOMS}
COMPILED = pytest.mark.skipif(shutil.which("c++") is None, reason="torch.compile needs a C++ compiler")
pytestmark = [  # of PyTorch about itself
    pytest.mark.filterwarnings("ignore:Synchronization debug mode is a prototype"),
    pytest.mark.filterwarnings("ignore:TensorFloat32 tensor cores"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script_method. is deprecated"),
    # Its compiler looks for the gradient of a memory's state, which is no leaf.
    pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf"),
]
GA3CS = {"optimiser": "tf_rmsprop", "optimiser_epsilon": 0.1, "loss": "sum", "trajectories": 4}
RICH = {"mirror": True, "dropout": 0.5, "terms": {"supervised": 1.0, "guided": 0.5}}


def trainer(
    folder: Path,
    worlds: list[OpenWorld],
    device: str,
    *,
    resume: bool = False,
    group: Group = ALONE,
    **changed: Any,
) -> Trainer:
    settings = TrainSettings(**{"steps": 2400, "envs": 16, "length": 5, "loggers": [], **changed})
    tree = union([tree_of(world.graph) for world in worlds])
    crops = any(world.graph.crops is not None for world in worlds)
    shape = NetworkShape(size=worlds[0].graph.size, trunk_settings={"features": 32}, crops=crops)
    run = Run(folder) if resume else Run.create(folder, "test", "")
    actors = on_recordings(worlds, settings, frames=1, device=device)
    return Trainer(run, tree, shape, settings, actors, seed=3, device=device, resume=resume, group=group)


def updates(made: Trainer, number: int) -> dict[str, float]:
    """Make some, and what was counted of the last."""
    for _ in range(number):
        counted = Statistics(made.actors.places)
        made._update(counted)
    return counted.read()


@pytest.mark.parametrize("worlds", [RINGS, ROOMS, RINGS + ROOMS], ids=["rings", "rooms", "both"])
def test_an_update_in_place_is_the_update(tmp_path: Path, worlds: list[OpenWorld]) -> None:
    """What a graph repeats, with what a CPU has: the same places for episodes, other numbers each time."""
    plain, placed = (trainer(tmp_path / name, worlds, "cpu", **RICH) for name in ("plain", "placed"))
    repeated = GraphedUpdate(_with_numbers(placed), placed.actors, torch.device("cpu"))  # type: ignore[arg-type]
    at = {name: value.data_ptr() for name, value in repeated._episodes.items()}
    for update in range(12):
        now = plain.settings.at(update / 12)
        expected = plain._once(now)
        repeated._now.copy_(torch.tensor(now))
        found = repeated.in_place()
        torch.testing.assert_close(found.values, expected.values)
    assert {name: value.data_ptr() for name, value in placed.actors.episodes().items()} == at
    for one, other in zip(plain.network.parameters(), placed.network.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def _with_numbers(made: Trainer) -> Any:
    """The update with numbers made of tensors; its optimiser takes none without a GPU."""

    def update(now: Annealed) -> Counts:
        return made._play_and_learn(now._replace(learning_rate=float(now.learning_rate)))

    return update


def test_a_run_goes_on_without_the_gpu_it_began_on(tmp_path: Path) -> None:
    made = trainer(tmp_path, RINGS, "cpu")
    state = made.actors.state()
    drawn = []
    for of_gpu in (1, 1, 2):
        state["generator"] = torch.full((16,), of_gpu, dtype=torch.uint8)  # as long as that of a GPU
        made.actors.load_state(state)
        drawn.append(made.actors.collect(Epsilon(0.5, 0.5)).actions)
    assert torch.equal(drawn[0], drawn[1])
    assert not torch.equal(drawn[0], drawn[2])


def test_a_graph_is_for_one_process(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="one process"):
        trainer(tmp_path, RINGS, "cpu", group=Group(0, 2), cuda_graphs=True)


@pytest.mark.gpu
@pytest.mark.parametrize("changed", [{}, RICH, {"amp": True}, {"optimiser": "rmsprop"}, GA3CS], ids=str)
@pytest.mark.parametrize("world", ["rings", "rooms"])
def test_an_update_waits_for_nothing(tmp_path: Path, world: str, changed: dict[str, Any]) -> None:
    made, counted = trainer(tmp_path, WORLDS[world], "cuda", cuda_graphs=False, **changed), Statistics()
    made._update(counted)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        made._update(counted)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert counted.read()["loss/total"] != 0


@pytest.mark.gpu
@pytest.mark.parametrize(
    "changed",
    [
        {},
        RICH,
        {"optimiser": "rmsprop"},
        GA3CS,
        {"amp": True},
        pytest.param({"compile": True}, marks=[COMPILED, pytest.mark.slow]),
        pytest.param({"compile": True, "amp": True}, marks=[COMPILED, pytest.mark.slow]),
    ],
    ids=str,
)
def test_a_graph_does_what_its_kernels_do(tmp_path: Path, changed: dict[str, Any]) -> None:
    """Also after the first replay, when epsilon, weights and rate are others, and as random numbers go on."""
    kernels, graph = (
        trainer(tmp_path / str(on), ROOMS, "cuda", cuda_graphs=on, **changed) for on in (False, None)
    )
    for update in range(WARM_UPS + 5):
        expected, found = updates(kernels, 1), updates(graph, 1)
        for name in ("reward", "views", "loss/total", "loss/entropy_branch", "gradient"):
            assert found[name] == pytest.approx(expected[name], rel=0.02, abs=0.02), (update, name)
    assert graph._once._graph is not None  # type: ignore[attr-defined]
    for one, other in zip(kernels.network.parameters(), graph.network.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0.02, atol=0.01)


@pytest.mark.gpu
@pytest.mark.parametrize("changed", [{}, {"optimiser": "rmsprop"}, GA3CS], ids=str)
def test_a_run_of_graphs_resumes(tmp_path: Path, changed: dict[str, Any]) -> None:
    whole = trainer(tmp_path / "whole", RINGS, "cuda", **changed)
    halved = trainer(tmp_path / "halved", RINGS, "cuda", **changed)
    updates(halved, 8)
    halved.save()
    again = trainer(halved.run.folder, RINGS, "cuda", resume=True, **changed)
    updates(whole, 8)
    expected, found = updates(whole, 5), updates(again, 5)
    assert found["reward"] == pytest.approx(expected["reward"], rel=0.02, abs=0.02)
    for one, other in zip(whole.network.parameters(), again.network.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0.02, atol=0.01)


@pytest.mark.gpu
def test_graphs_learn_to_look_before_they_answer(tmp_path: Path) -> None:
    """A world whose class shows on 3 of 12 views: answering well means walking there first."""
    world = OpenWorld("rings", ring_graph(objects=12, classes=3, telling=(3, 4, 5)), PRESETS["V4"])
    made = trainer(tmp_path, [world], "cuda", steps=60_000, envs=32, log_every=5_000)
    made.train()
    last = json.loads((made.run.folder / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["accuracy"] > 0.9  # from the first view no more than 1/4 + 3/4 * 1/3 = 0.5
    assert last["views"] > 2.0


@pytest.mark.gpu
def test_ga3c_plays_with_a_network_on_the_gpu(tmp_path: Path) -> None:
    settings = TrainSettings(steps=2000, loggers=[], log_every=1000)
    graph, chosen = ring_graph(), GA3CSettings(kind="threads", agents=4, envs_per_agent=4)
    made = Trainer(
        Run.create(tmp_path, "test", ""),
        tree_of(graph),
        NetworkShape(size=graph.size, trunk_settings={"features": 32}),
        settings,
        lambda network, seed: GA3CActors(
            lambda: ViewGraphEnv(graph, PRESETS["V0"], frames=1), network, chosen, settings.length, seed
        ),
        seed=3,
        device="cuda",
    )
    made.train()
    last = json.loads((made.run.folder / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["step"] >= 2000
