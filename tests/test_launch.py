"""Runs begun, stopped and gone on with, on a world of a few pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activelsd import launch
from activelsd.build import build_device, build_shape
from activelsd.compose import load, resolve
from activelsd.config import RunConfig
from activelsd.envs.episode import PRESETS
from activelsd.envs.modelnet.cameras import Rings
from activelsd.envs.modelnet.orbit import with_moves
from activelsd.envs.settings import RulesSettings
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, RunError, UserError
from activelsd.train.run import Run
from activelsd.train.trainer import Trainer

QUICK = [
    *("env=modelnet", "device=cpu", "policy.trunk.features=8"),
    *("env.navigate=orbit_cw,orbit_ccw", "train.steps=80"),
    *("train.envs=4", "train.checkpoint_every=40", "train.log_every=40", "train.loggers=[]"),
]


@pytest.fixture(autouse=True)
def world(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ViewGraph:
    """Six objects, two classes: one dark, one bright."""
    objects, views = 6, 12
    bright = np.repeat(np.arange(objects) % 2 * 200, views).astype(np.uint8)
    graph = ViewGraph(
        frames=np.broadcast_to(bright[:, None, None], (objects * views, 32, 32)).copy(),
        moves=np.zeros((objects * views, 0), np.int32),
        move_names=(),
        classes=("bright", "dark"),
        targets=tuple(f"object_{i}" for i in range(objects)),
        labels=np.arange(objects) % 2,
        scenes=tuple(f"object_{i}" for i in range(objects)),
        scene_of=np.repeat(np.arange(objects, dtype=np.int32), views),
        view_names=tuple(f"{30 * (i % views)}" for i in range(objects * views)),
        start_view=np.arange(objects * views, dtype=np.int32),
        start_target=np.repeat(np.arange(objects, dtype=np.int32), views),
        start_split=np.repeat(np.array([0, 0, 1, 1, 2, 2], np.uint8), views),
    )
    graph = with_moves(graph, ("orbit_cw", "orbit_ccw"), [Rings.even(views, [30.0])] * objects)
    monkeypatch.setattr(launch, "open_graph", lambda config: graph)
    monkeypatch.chdir(tmp_path)
    return graph


def test_a_run_explains_itself_and_goes_on() -> None:
    config = resolve([*QUICK, "name=toy"])
    folder = launch.begin(config)
    assert folder.name.endswith("-toy")
    assert load(folder / "config.yaml") == config
    first = sorted(path.name for path in (folder / "checkpoints").iterdir())
    assert launch.resume(folder, ["train.steps=160"]) == folder
    assert load(folder / "config.yaml").train.steps == 160
    assert sorted(path.name for path in (folder / "checkpoints").iterdir())[-1] > first[-1]
    with pytest.raises(ConfigError, match=r"^train\.gamma cannot be changed here, a run goes on as it began"):
        launch.resume(folder, ["train.gamma=0.5"])


def test_a_run_whose_folders_moved_goes_on_and_classes_that_do_not_fit_leave_its_config_alone(
    world: ViewGraph, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = launch.begin(resolve([*QUICK, "env.cache=here"]))
    launch.resume(folder, [f"env.cache={tmp_path}", "train.steps=160"])
    moved = (folder / "config.yaml").read_text()
    assert load(folder / "config.yaml").worlds["modelnet"].cache == tmp_path
    other = replace(world, classes=("a", *world.classes[1:]))
    monkeypatch.setattr(launch, "open_graph", lambda config: other)
    with pytest.raises(RunError, match=f"only the world has a, the world lacks {world.classes[0]}"):
        launch.resume(folder, ["env.cache=elsewhere", "train.steps=240"])
    assert (folder / "config.yaml").read_text() == moved


def test_the_older_checkpoint_is_used_if_the_newest_is_damaged(caplog: pytest.LogCaptureFixture) -> None:
    folder = launch.begin(resolve([*QUICK, "train.checkpoint_every=40"]))
    older, newest = sorted((folder / "checkpoints").iterdir())
    for name in ("network.safetensors", "training.json"):
        whole = (newest / name).read_bytes()
        (newest / name).write_bytes(whole[: len(whole) // 2])
        assert Run(folder).checkpoint == older
        assert f"{newest / name} cannot be read" in caplog.text
        (newest / name).write_bytes(whole)
    (newest / "network.json").unlink()
    launch.resume(folder, ["train.steps=160"])
    assert int(Run(folder).checkpoint.name) == 160


def test_a_mistake_leaves_no_folder(
    world: ViewGraph, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    only_test = replace(world, start_split=np.full_like(world.start_split, 2))
    monkeypatch.setattr(launch, "open_graph", lambda config: only_test)
    with pytest.raises(UserError, match="'train' split has no episode"):
        launch.begin(resolve(QUICK))
    assert not list((tmp_path / "runs").iterdir())


def test_stopped_before_its_first_checkpoint_a_run_still_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(trainer: Trainer) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "train", stop)
        with pytest.raises(KeyboardInterrupt) as stopped:
            launch.begin(resolve(QUICK))
    assert str(stopped.value).startswith("Stopped; go on with: activelsd train --resume runs/")
    folder = Path(str(stopped.value).split()[-1])
    assert not (folder / "checkpoints").exists()
    launch.resume(folder, [])
    assert list((folder / "checkpoints").iterdir())


def test_sections_become_what_they_describe(world: ViewGraph) -> None:
    assert RulesSettings(preset="V2").rules() == PRESETS["V2"]
    changed = RulesSettings(preset="V0", wrong=-1.0, max_views=5).rules()
    assert changed == replace(PRESETS["V0"], wrong=-1.0, max_views=5)
    config: RunConfig = resolve([*(word for word in QUICK if "features" not in word), "policy=paper"])
    shape = build_shape(config.policy, world)
    assert (shape.trunk, shape.memory, shape.frames, shape.size, shape.crops) == (
        "alexnet",
        "stack",
        3,
        32,
        False,
    )
    assert build_device("cpu", None) == "cpu"


def test_cuda_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert build_device("auto", None) == "cpu"
    with pytest.raises(ConfigError, match="set device=cpu"):
        build_device("cuda", None)
    with pytest.raises(ConfigError, match=r"^train\.cuda_graphs=true is for a GPU"):
        launch.begin(resolve([*QUICK, "train.cuda_graphs=true"]))
