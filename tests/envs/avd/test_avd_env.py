"""The world as Gymnasium sees it, its settings, and where its episodes begin."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from activelsd import cli
from activelsd.compose import resolve
from activelsd.envs.avd.categories import by_category, category_of
from activelsd.envs.avd.homes import DEFAULT_SCANS
from activelsd.envs.avd.prepare import prepare
from activelsd.envs.avd.settings import MOVES, StartsSettings
from activelsd.envs.avd.splits import split_scans
from activelsd.envs.avd.starts import BoxScores, read_scores, starts, write_scores
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.oracle import shows_well
from activelsd.envs.start_filters import check_starts, frozen_list
from activelsd.envs.viewgraph import SPLITS, ViewGraph, load_graph
from activelsd.envs.world import make, make_vector, world_settings
from activelsd.errors import ConfigError, DataError
from tests.envs.avd.homes import INSTANCES, write_homes


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_homes(tmp_path_factory.mktemp("data"), homes=6)


@pytest.fixture(scope="module")
def prepared(root: Path, tmp_path_factory: pytest.TempPathFactory) -> ViewGraph:
    folders = sorted(path for path in root.iterdir() if path.is_dir())
    return load_graph(prepare(folders, size=16, cache=tmp_path_factory.mktemp("cache")))


def homes_of(graph: ViewGraph, split: str) -> set[str]:
    rows = np.flatnonzero(graph.start_split == SPLITS.index(split))
    assert all(
        graph.targets[graph.start_target[row]].startswith(graph.scenes[graph.scene_of[graph.start_view[row]]])
        for row in rows
    )
    return {graph.scenes[graph.scene_of[graph.start_view[row]]] for row in rows}


def test_it_is_a_whole_environment(root: Path) -> None:
    env = gymnasium.make("activelsd/AVD-v0", dataset={"path": root}, size=32, subset="test")
    check_env(env.unwrapped, skip_render_check=True)
    plain = env.unwrapped
    assert isinstance(plain, ViewGraphEnv)
    assert plain.tree.leaves == (INSTANCES, MOVES)
    observation, info = env.reset(seed=0)
    assert observation["crops"].shape == observation["frames"].shape == (1, 32, 32)
    assert observation["target"][0, 4] == 1, "the target is in sight at the start"
    assert (info["backend"], info["split"], info["scene"]) == ("avd", "test", "Home_006_1")
    assert info["oracle_views"] == plain.graph.oracle_views[plain.graph.find(info["episode_id"])]  # type: ignore[index]
    blocked = len(INSTANCES) + MOVES.index("forward")
    after, reward, terminated, _, info = env.step(blocked)
    assert not terminated
    assert (info["moved"], info["views"], reward) == (False, 2, 0.0)
    assert np.array_equal(after["frames"], observation["frames"])
    seen = [env.step(len(INSTANCES) + MOVES.index("rotate_cw"))[0] for _ in range(4)]
    assert np.array_equal(seen[-1]["frames"], observation["frames"])
    hidden = [look for look in seen if look["target"][0, 4] == 0]
    assert hidden
    assert all(not look["crops"].any() and not look["target"].any() for look in hidden)


def test_many_at_once_are_what_one_is(root: Path) -> None:
    world = {"path": root, "size": 32, "subset": "train", "rules": "V4"}
    vector = make_vector("avd", num_envs=3, **world)  # type: ignore[arg-type]
    single = make("avd", **world)  # type: ignore[arg-type]
    observation, infos = vector.reset(seed=5)
    alone, info = single.reset(seed=5)
    for name in ("frames", "target", "crops"):
        assert np.array_equal(observation[name][0], alone[name])
    assert infos["oracle_views"][0] == info["oracle_views"]
    assert infos["backend"][0] == "avd"
    *_, infos = vector.step(np.zeros(3, np.int64))
    assert infos["final_info"]["oracle_views"][0] == info["oracle_views"]


def test_homes_are_split_and_one_validates(prepared: ViewGraph) -> None:
    graph = starts(prepared, split_scans(list(prepared.scenes)), StartsSettings(shown_well=True))
    assert homes_of(graph, "test") == {"Home_006_1"}
    assert homes_of(graph, "val") == {"Home_005_1"}
    assert homes_of(graph, "train") == {f"Home_00{i}_1" for i in range(1, 5)}
    assert prepared.pair_of is not None
    assert len(graph.start_view) == (prepared.pair_of >= 0).sum()


def test_with_few_homes_a_tenth_of_the_targets_validates(prepared: ViewGraph) -> None:
    train = ["Home_001_1", "Home_002_1", "Home_003_1"]
    graph = starts(
        prepared, split_scans(list(prepared.scenes), train=train, test=["Home_006_1"]), StartsSettings()
    )
    assert homes_of(graph, "val") <= homes_of(graph, "train") == set(train)
    targets = {
        split: {graph.targets[t] for t in graph.start_target[graph.start_split == i]}
        for i, split in enumerate(SPLITS)
    }
    assert len(targets["train"]) == 10
    assert len(targets["val"]) == 2
    assert not targets["train"] & targets["val"]
    assert homes_of(graph, "test") == {"Home_006_1"}


def test_starts_are_filtered(prepared: ViewGraph) -> None:
    split = split_scans(list(prepared.scenes))
    assert prepared.boxes is not None
    assert prepared.pair_of is not None
    assert prepared.difficulty is not None
    hard = starts(prepared, split, StartsSettings())
    easy = starts(prepared, split, StartsSettings(shown_well=True, max_difficulty=1))
    small = starts(prepared, split, StartsSettings(shown_well=True, max_size=0.4))
    large = starts(prepared, split, StartsSettings(shown_well=True, min_size=0.4))
    for graph, good in (
        (hard, ~shows_well(prepared)),
        (easy, prepared.difficulty == 1),
        (small, prepared.boxes[:, 2:].max(1) <= 0.4),
        (large, prepared.boxes[:, 2:].max(1) >= 0.4),
    ):
        pairs = prepared.pair_of[graph.start_view, graph.start_target]
        assert sorted(pairs.tolist()) == np.flatnonzero(good).tolist()
    everywhere = starts(prepared, split, StartsSettings(visible=False, shown_well=True))
    assert len(everywhere.start_view) == 6 * 4 * 4, "every view of the target's own home"
    assert homes_of(everywhere, "test") == {"Home_006_1"}
    unclear = starts(prepared, split, StartsSettings(visible=False))
    assert len(everywhere.start_view) - len(unclear.start_view) == shows_well(prepared).sum() > 0
    with pytest.raises(
        DataError, match=r"The 'train' split has no episode left; relax the filters in env.starts"
    ):
        check_starts(starts(prepared, split, StartsSettings(min_size=0.99)))


def test_the_frozen_list_is_drawn_once_and_for_all(prepared: ViewGraph) -> None:
    whole = starts(prepared, split_scans(list(prepared.scenes)), StartsSettings(shown_well=True))
    one, again = frozen_list(whole, 1), frozen_list(whole, 1)
    assert np.array_equal(one.start_view, again.start_view)
    for i, split in enumerate(SPLITS):
        counts = np.bincount(one.start_target[one.start_split == i], minlength=len(one.targets))
        assert set(counts.tolist()) == ({0, 2} if split == "train" else {0, 1})
    assert frozen_list(whole, 9).start_view.tolist() == whole.start_view.tolist()


def test_categories_come_of_names(prepared: ViewGraph) -> None:
    assert category_of("coca_cola_glass_bottle") == category_of("red_bull") == "drink"
    assert category_of("mug_blue_3") == "mug"
    assert category_of("cup") == "cup"
    graph = by_category(prepared)
    assert graph.classes == ("can", "drink", "medicine")
    for label, target in zip(graph.labels, graph.targets, strict=True):
        assert graph.classes[label] == category_of(target.partition("/")[2])


def test_moves_may_be_fewer_and_in_another_order(prepared: ViewGraph) -> None:
    graph = prepared.with_moves(("rotate_ccw", "forward"))
    assert graph.move_names == ("rotate_ccw", "forward")
    assert np.array_equal(graph.moves, prepared.moves[:, [5, 0]])


def test_scores_survive_their_file_and_choose_the_starts(
    root: Path, prepared: ViewGraph, tmp_path: Path
) -> None:
    assert prepared.boxes is not None
    n = len(prepared.boxes)
    rng = np.random.default_rng(0)
    scores = BoxScores(rng.random(n, np.float32), np.arange(n) % 2 == 0)
    file = tmp_path / "scores.csv"
    write_scores(prepared, scores, file)
    read = read_scores(prepared, file)
    np.testing.assert_allclose(read.score, scores.score, rtol=1e-5)
    assert np.array_equal(read.right, scores.right)
    starts = {"scores": file, "threshold": 0.5, "per_target": None}
    graph = world_settings("avd", {"path": root, "size": 32, "starts": starts}).open()
    assert graph.pair_of is not None
    pairs = graph.pair_of[graph.start_view, graph.start_target]
    assert len(pairs)
    assert (scores.score[pairs] < 0.5).all()
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(
        DataError, match=r"scores.csv has no score for Home_006_1/.* in view .*; write it again"
    ):
        read_scores(prepared, file)
    file.write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match=r"scores.csv is not a table of scene, view, target, score, right"):
        read_scores(prepared, file)
    with pytest.raises(DataError, match=r"none.csv cannot be read"):
        read_scores(prepared, tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ({"navigate": ["foward"]}, "The AVD world has no move 'foward'; did you mean forward"),
        ({"task": "instances"}, "task=instances: must be 'instance' or 'category'; did you mean instance"),
        ({"test": ["Home_06_1"]}, "There is no scan 'Home_06_1'; did you mean Home_006_1"),
    ],
)
def test_what_is_misspelled_names_the_nearest(root: Path, option: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        world_settings("avd", {"path": root, "size": 32, **option}).open()


def test_settings_reach_the_world(root: Path) -> None:
    words = [f"env.dataset.path={root}", "env.size=32", "env.task=category", "env.navigate=forward,rotate_cw"]
    graph = resolve(["env=avd", *words, "env.starts.per_target=1"]).env.open()
    assert graph.classes == ("can", "drink", "medicine")
    assert graph.move_names == ("forward", "rotate_cw")
    assert (graph.start_split == SPLITS.index("test")).sum() == 4


class Writer(ModuleType):
    """Stands in for the writer of sample scans: homes of a few photographs, and what it was asked for."""

    def __init__(self) -> None:
        super().__init__("activelsd.envs.avd.writer")
        self.asked: list[tuple[Sequence[str], int, int, int]] = []

    def write_sample(
        self, root: Path, *, scans: Sequence[str], width: int, height: int, seed: int, progress: Any
    ) -> Path:
        self.asked.append((scans, width, height, seed))
        write_homes(root, homes=len(scans))
        (root / "sample.json").write_text(json.dumps({}))
        if progress is not None:
            progress(1, 1)
        return root


@pytest.fixture
def writer(monkeypatch: pytest.MonkeyPatch) -> Writer:
    fake = Writer()
    monkeypatch.setitem(sys.modules, fake.__name__, fake)
    return fake


def test_the_sample_is_made_once_and_called_what_it_is(
    writer: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["env=avd", f"env.cache={tmp_path}", "env.size=32"]
    assert cli.main(["prepare", *words, "env.dataset=sample"]) == 0
    said = capsys.readouterr().out
    assert f"{4 * len(DEFAULT_SCANS)} objects of 4 classes" in said
    assert f"{4 * len(DEFAULT_SCANS)} views of 32 pixels" in said
    assert cli.main(["prepare", *words]) == 0
    assert writer.asked == [(DEFAULT_SCANS, 480, 270, 0)]
    (sample,) = (path for path in tmp_path.iterdir() if path.is_dir())
    for world in ({}, {"path": sample}):  # it has the writer's note
        assert make("avd", cache=tmp_path, size=32, **world).backend == "avd-sample"
    assert not list(tmp_path.glob("*.partial"))


def test_a_published_split_asks_the_writer_for_all_its_scans(writer: Writer, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="Split 2 needs"):  # the stand-in names homes its own way
        world_settings("avd", {"split": "2", "cache": tmp_path}).open()
    scans, *_ = writer.asked[0]
    assert len(scans) == 14
    assert {"Home_003_1", "Office_001_1"} <= set(scans)


def test_sample_and_path_exclude_each_other(root: Path) -> None:
    with pytest.raises(ConfigError, match=r"env.dataset=sample and env.dataset.path exclude each other"):
        resolve(["env=avd", "env.dataset=sample", f"env.dataset.path={root}"])
    with pytest.raises(ConfigError, match=r"env.dataset.kind=smple: must be 'sample'"):
        resolve(["env=avd", "env.dataset=smple"])


TWICE = """
import sys, time
from pathlib import Path
from types import ModuleType
from activelsd.envs.avd import datasets
from activelsd.envs.avd.settings import ScansSettings

def write_sample(root, **_):
    root.mkdir()
    print("begun", flush=True)
    time.sleep(float(sys.argv[2]))
    (root / "made").touch()

fake = ModuleType("activelsd.envs.avd.writer")
fake.write_sample = write_sample
sys.modules[fake.__name__] = fake
scans = ScansSettings(scans=("Home_001_1", "Home_002_1"))
print(datasets.sample_scans(scans, Path(sys.argv[1])))
"""


def test_a_second_process_waits_for_the_sample_and_takes_it(tmp_path: Path) -> None:
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", TWICE, str(tmp_path)]
    options: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": env}
    with subprocess.Popen([*command, "3"], **options) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "begun\n"
        second = subprocess.run([*command, "0"], **options, check=True)
        (sample,) = tmp_path.iterdir()
        assert first.communicate()[0] == second.stdout == f"{sample}\n", "it was made once"
    assert second.stderr.startswith(f"Waiting for process {first.pid} (")
    assert (sample / "made").exists()
