"""Preparing views: the graph they make, the cache, and going on after whatever interrupts."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from activelsd.envs import cache, digest, workers
from activelsd.envs.cache import PartialGraph
from activelsd.envs.modelnet.broken import BrokenObjects
from activelsd.envs.modelnet.cameras import Dodecahedron, Rings
from activelsd.envs.modelnet.orbit import with_moves
from activelsd.envs.modelnet.prepare import open_views, prepare, prepared_views, rigs_of
from activelsd.envs.viewgraph import SPLITS, load_graph, read_key
from activelsd.errors import ActiveLSDError, DataError
from tests.graphs import opened

SIZE = 32
RING = Rings.even(12, [30.0])


def shapes(train=3, test=2, classes=("cup", "vase")):
    return opened(None, train_per_class=train, test_per_class=test, classes=classes)


def prepared(dataset, cache, **options):
    return prepare(dataset, **{"size": SIZE, "rig": RING, "cache": cache, **options})


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_graph_is_a_ring_of_views_per_object(tmp_path):
    dataset = shapes()
    graph = open_views(prepared(dataset, tmp_path, rig=Rings.even(12, [30, 0.5])), dataset)
    objects = len(dataset.items)
    assert graph.frames.shape == (objects * 24, SIZE, SIZE)
    assert isinstance(graph.frames, np.memmap)
    assert graph.moves.shape == (objects * 24, 0)
    assert graph.targets == graph.scenes == tuple(item.name for item in dataset.items)
    assert [graph.classes[label] for label in graph.labels] == [item.category for item in dataset.items]
    assert graph.view_names[:2] == ("e30_a000", "e30_a030")
    assert graph.view_names[12:14] == ("e0.5_a000", "e0.5_a030")
    assert len(set(zip(graph.scene_of.tolist(), graph.view_names, strict=True))) == objects * 24
    for i, item in enumerate(dataset.items):
        views = dataset.source.views(item, size=SIZE, cameras=Rings.even(12, [30, 0.5]).cameras)
        np.testing.assert_array_equal(graph.frames[24 * i : 24 * i + 24], views)
        starts = np.flatnonzero(graph.start_target == i)
        assert graph.start_view[starts].tolist() == list(range(24 * i, 24 * i + 12))
        assert {SPLITS[s] for s in graph.start_split[starts]} == {item.split}
    assert names(tmp_path) == [prepared(dataset, tmp_path, rig=Rings.even(12, [30, 0.5])).name]


def test_what_is_there_is_taken_and_settings_live_side_by_side(tmp_path):
    seen = []
    first = prepared(shapes(), tmp_path, progress=lambda *counts: seen.append(counts))
    assert seen == [(i, 10) for i in range(11)]
    stamp = first.stat().st_mtime_ns
    assert prepared(shapes(), tmp_path, progress=lambda *_: pytest.fail("rendered again")) == first
    assert first.stat().st_mtime_ns == stamp
    others = {
        prepared(shapes(), tmp_path, size=16),
        prepared(shapes(), tmp_path, rig=Rings.even(12, [0])),
        prepared(shapes(train=4), tmp_path),
    }
    assert len(others | {first}) == len(names(tmp_path)) == 4


def test_a_file_that_cannot_be_read_is_made_anew(tmp_path):
    path = prepared(shapes(), tmp_path)
    whole = path.read_bytes()
    for data in (b"", b"something else", whole[: len(whole) // 2]):
        path.write_bytes(data)
        path.with_name(path.name + ".partial").write_bytes(data)
        assert prepared(shapes(), tmp_path) == path
        assert path.read_bytes() == whole
        assert names(tmp_path) == [path.name]


def test_processes_give_what_one_gives(tmp_path):
    dataset = shapes(train=20)
    alone_, crew = (prepared(dataset, tmp_path / str(n), workers=n) for n in (1, 2))
    assert alone_.read_bytes() == crew.read_bytes()


SCRIPT = """
import sys, time
from pathlib import Path
from activelsd.envs import cache
from activelsd.envs.modelnet.cameras import Rings
from activelsd.envs.modelnet.datasets import open_dataset
from activelsd.envs.modelnet.prepare import prepare
from activelsd.envs.modelnet.settings import DatasetSettings

cache._FLUSH_SECONDS = float(sys.argv[2])

def progress(done, total):
    print(done, flush=True)
    time.sleep(0.02)

prepare(
    open_dataset(DatasetSettings(train_per_class=30, test_per_class=2, classes=("cup", "vase"))),
    size=32, rig=Rings.even(12, [30.0]), cache=Path(sys.argv[1]), workers=2, progress=progress,
)
"""


@pytest.fixture
def script(tmp_path):
    """A program without a main guard, as users write them."""
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return lambda cache, flush: subprocess.Popen(
        [sys.executable, path, cache, str(flush)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=env,
    )


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_what_is_interrupted_goes_on(end, script, tmp_path):
    cache = tmp_path / "cache"
    flush = (
        60 if end == signal.SIGINT else 0
    )  # only Ctrl-C lets it mark what it has done since the last flush
    counts = []
    for stop_at in (9, None):
        with script(cache, flush) as process:
            for line in process.stdout:
                counts.append(int(line))
                if stop_at and counts[-1] >= stop_at:
                    process.send_signal(end)
                    break
            _, errors = process.communicate(timeout=60)
        if stop_at:
            assert process.returncode == -end, errors
            assert errors.count("Traceback") == (end == signal.SIGINT)  # its own, not that of every process
            kept = [name for name in names(cache) if not name.endswith(".lock")]
            assert len(kept) == 1
            assert kept[0].endswith(".h5.partial")
            counts.clear()
        else:
            assert process.returncode == 0, errors
            assert errors == ""
    assert counts[0] >= 8
    (file,) = cache.iterdir()
    assert file.read_bytes() == prepared(shapes(train=30), tmp_path / "whole").read_bytes()


def test_an_interruption_before_anything_is_done_leaves_nothing(tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepared(shapes(), tmp_path, progress=interrupt)
    assert names(tmp_path) == []


def broken_set(root, at, counts=(("train", 20), ("test", 4))):
    """A data set of a class, with meshes at some places that are cut short."""
    root = meshes(root, *(f"cup/{folder}/{folder}_{i:02d}.off" for folder, n in counts for i in range(n)))
    whole = sorted(root.rglob("*.off"), key=lambda path: (path.parent.name == "test", path))
    broken = [whole[i] for i in at]
    for path in broken:
        path.write_text("OFF4 2 0\n0 0 0\n1 0")
    return root, broken


def test_broken_meshes_are_all_named_before_any_is_rendered(tmp_path):
    root, broken = broken_set(tmp_path / "net", range(0, 44, 16), (("train", 40), ("test", 4)))
    checked, rendered = [], []

    class Shown:
        def __call__(self, done, total):
            rendered.append(done)

        def stage(self, what):
            return lambda done, total: checked.append((what, done, total))

    for n in (1, 2):
        with pytest.raises(
            BrokenObjects, match=r"3 objects of .*/net are broken; .*skip_broken=true:"
        ) as caught:
            prepared(opened(root), tmp_path / "cache", workers=n, progress=Shown())
        lines = str(caught.value).splitlines()[1:]
        assert lines == [
            f"  {path} ends after 1 of 4 vertices; copy it again or remove it." for path in broken
        ]
        assert checked[-1] == ("Checking objects", 44, 44)
        assert not rendered
        assert not (tmp_path / "cache").exists()
    broken_set(tmp_path / "net", range(25), (("train", 40), ("test", 4)))
    with pytest.raises(BrokenObjects, match=r"^25 objects (.|\n)*\n  and 5 more$"):
        prepared(opened(root), tmp_path / "cache")


def test_one_broken_mesh_is_one_sentence(tmp_path):
    root, (broken,) = broken_set(tmp_path / "net", [3])
    with pytest.raises(BrokenObjects) as caught:
        prepared(opened(root), tmp_path / "cache")
    sentence = f"{broken} ends after 1 of 4 vertices; copy it again or remove it, or leave it out by"
    assert str(caught.value) == f"{sentence} env.dataset.skip_broken=true."


def views_without_broken(root, cache, **options):
    how = {"size": SIZE, "rig": RING, "cache": cache, "skip_broken": True}
    return prepared_views(opened(root), **(how | options))


def test_broken_objects_are_left_out_if_asked_for(tmp_path, caplog, monkeypatch):
    root, (first, second) = broken_set(tmp_path / "net", [2, 21])
    with caplog.at_level("WARNING", "activelsd"):
        graph = views_without_broken(root, tmp_path / "cache")
    assert graph.left_out == (f"cup/{first.stem}", f"cup/{second.stem}")
    assert len(graph.targets) == 22
    assert not set(graph.left_out) & set(graph.targets)
    assert caplog.messages[-1].startswith(
        f"2 of 24 objects of {root} are left out, since they are broken:\n  "
    )
    assert str(first) in caplog.messages[-1]
    splits = {name: SPLITS[graph.start_split[12 * i]] for i, name in enumerate(graph.targets)}
    assert splits == {item.name: item.split for item in opened(root).items if item.name in graph.targets}

    # They are known from now on: nothing is written, also not where nothing can be.
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()}
    monkeypatch.setattr(cache, "alone", lambda path: pytest.fail("nothing is to be made"))
    again = views_without_broken(root, tmp_path / "cache")
    assert again.left_out == graph.left_out
    assert stamps == {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()}
    monkeypatch.undo()

    # A mended one is in it again, and the others are copied.
    meshes(root, first.relative_to(root).as_posix())
    counts = []
    more = views_without_broken(root, tmp_path / "cache", progress=lambda *step: counts.append(step))
    assert more.left_out == (f"cup/{second.stem}",)
    assert counts == [(22, 23), (23, 23)]


def test_objects_that_lack_pictures_are_left_out_too(tmp_path):
    root = tmp_path / "views"
    for folder, name in (("train", "a"), ("train", "b"), ("train", "c"), ("test", "d")):
        (root / "cup" / folder).mkdir(parents=True, exist_ok=True)
        for i in range(6):
            if (name, i) not in {("b", 2), ("c", 1)}:
                cv2.imwrite(str(root / f"cup/{folder}/{name}_{i}.png"), np.full((24, 24), 40 * i, np.uint8))
    with pytest.raises(
        BrokenObjects, match=r"2 objects of (.|\n)*'b' in .* lacks view 2;(.|\n)*'c' .* view 1;"
    ):
        opened(root)
    graph = prepared_views(
        opened(root, skip_broken=True), size=SIZE, rig=RING, cache=tmp_path / "cache", skip_broken=True
    )
    assert graph.left_out == ("cup/b", "cup/c")
    assert graph.targets == ("cup/a", "cup/d")


def test_a_class_of_broken_objects_only_is_refused(tmp_path):
    root, _ = broken_set(tmp_path / "net", range(20, 24))
    with pytest.raises(DataError, match=r"Class 'cup' of .* has no test objects but broken ones: mend some"):
        views_without_broken(root, tmp_path / "cache")


def test_what_is_rendered_is_kept_when_others_break(tmp_path):
    """Pictures break as they are read; the next run begins with what was read, whatever is mended."""
    root = tmp_path / "views"
    for folder in ("train", "test"):
        (root / "cup" / folder).mkdir(parents=True)
        for name in "abcd":
            for i in range(12):
                path = root / f"cup/{folder}/{name}{folder}_{i:03d}.png"
                cv2.imwrite(str(path), np.full((24, 24), 10 * i + ord(name) % 7, np.uint8))
    odd = [root / f"cup/train/{name}train_000.png" for name in "bc"]
    for path in odd:
        cv2.imwrite(str(path), np.zeros((24, 30), np.uint8))
    with pytest.raises(
        BrokenObjects, match=r"2 objects of .*\n.*btrain_000\.png is 30 x 24 .*\n.*ctrain_000"
    ):
        prepared(opened(root), tmp_path / "cache")
    assert [name.rpartition(".")[2] for name in names(tmp_path / "cache")] == ["partial"]
    for path in root.glob("cup/train/b*"):
        path.unlink()
    cv2.imwrite(str(odd[1]), np.zeros((24, 24), np.uint8))
    counts = []
    path = prepared(opened(root), tmp_path / "cache", progress=lambda *step: counts.append(step))
    assert counts == [(6, 7), (7, 7)]
    assert names(tmp_path / "cache") == [path.name]
    assert path.read_bytes() == prepared(opened(root), tmp_path / "whole").read_bytes()


def test_a_file_that_is_there_needs_no_right_to_write(tmp_path, monkeypatch):
    path = prepared(shapes(), tmp_path)
    monkeypatch.setattr(cache, "alone", lambda path: pytest.fail("no lock is needed"))
    assert prepared(shapes(), tmp_path) == path


def test_a_data_set_with_a_long_name(tmp_path):
    root = meshes(tmp_path / ("n" * 240), "cup/train/a.off", "cup/test/b.off")
    path = prepared(opened(root), tmp_path / "cache")
    assert len(path.name) < 200
    assert prepared(opened(root), tmp_path / "cache") == path


def test_a_process_that_dies_is_told_and_what_is_done_is_kept(tmp_path, monkeypatch):
    started, start = [], workers.start
    monkeypatch.setattr(workers, "start", lambda *a, **k: started.append(start(*a, **k)) or started[-1])

    def kill(done, total):
        if done == 5:
            started[0].kill()

    dataset = shapes(train=20)
    with pytest.raises(ActiveLSDError, match=r"The process that prepared .* ended by itself \(code -9\)"):
        prepared(dataset, tmp_path, workers=2, progress=kill)
    assert all(process.returncode is not None for process in started)
    seen = []
    path = prepared(dataset, tmp_path, workers=2, progress=lambda done, _: seen.append(done))
    assert seen[0] >= 5
    assert path.read_bytes() == prepared(dataset, tmp_path / "b").read_bytes()


def test_a_second_process_at_the_same_cache_waits(script, tmp_path):
    """Two at once: one renders, the other says whom it waits for; both end well."""
    cache = tmp_path / "cache"
    with script(cache, 0) as first:
        assert first.stdout.readline() == "0\n"
        first.send_signal(signal.SIGSTOP)  # however long the second takes to start
        with script(cache, 0) as second:
            warning = second.stderr.readline()
            first.send_signal(signal.SIGCONT)
            said, more = second.communicate(timeout=60)
        warning += more
        assert first.wait(timeout=60) == second.returncode == 0
    assert said == ""
    (line,) = warning.splitlines()
    assert line.startswith(f"Waiting for process {first.pid} (")
    assert "script.py" in line
    assert line.endswith(f"which is preparing {next(cache.iterdir())}.")
    assert len(names(cache)) == 1


def test_who_waits_goes_on_for_one_that_was_killed(script, tmp_path):
    cache = tmp_path / "cache"
    with script(cache, 0) as first, script(tmp_path / "other", 0) as other:
        for line in first.stdout:
            if int(line) == 9:
                first.send_signal(signal.SIGSTOP)  # it must not end before the second waits for it
                break
        with script(cache, 0) as second:
            warning = second.stderr.readline()
            first.kill()
            counts, rest = second.communicate(timeout=60)
        assert second.returncode == 0, rest
        assert f"process {first.pid} " in warning
        other.communicate(timeout=60)
    counts = [int(count) for count in counts.split()]
    assert counts[0] >= 8
    assert counts == list(range(counts[0], 65))
    (file,) = cache.iterdir()
    assert file.read_bytes() == next((tmp_path / "other").iterdir()).read_bytes()


def test_views_rendered_by_others(tmp_path):
    for folder in ("train", "test"):
        (tmp_path / "net/cup" / folder).mkdir(parents=True)
        for i in range(12):
            picture = np.full((48, 48), 20 * i, np.uint8)
            cv2.imwrite(str(tmp_path / f"net/cup/{folder}/cup_{folder}_{i + 1:03d}.png"), picture)
    dataset = opened(tmp_path / "net")
    graph = load_graph(prepared(dataset, tmp_path / "cache", workers=2))
    assert graph.frames[:12].mean((1, 2)).tolist() == [20 * i for i in range(12)]
    assert graph.view_names[11] == "e30_a330"
    with pytest.raises(DataError, match=r"holds pictures, and only their names can tell elevations"):
        prepared(dataset, tmp_path / "cache", rig=Rings.even(12, [0, 30]))


def test_objects_with_rings_of_their_own(tmp_path, caplog):
    """16 views, 8, and 4 over 3: frames, starts and moves follow, also if frames are copied."""
    names = {
        "a": [f"{i}.png" for i in range(16)],
        "b": [f"{i}.png" for i in range(1, 9)],
        "c": [f"e0_a{90 * i}.png" for i in range(4)] + [f"e30_a{120 * i}.png" for i in range(3)],
    }
    for split, name in ((s, n) for s in ("train", "test") for n in names):
        folder = tmp_path / "net/cup" / split / f"{name}{split}"
        folder.mkdir(parents=True)
        for i, file in enumerate(names[name]):
            cv2.imwrite(str(folder / file), np.full((8, 8), 10 * i, np.uint8))
    dataset = opened(tmp_path / "net")
    rigs = rigs_of(dataset, RING)
    graph = open_views(prepared(dataset, tmp_path / "cache"), dataset)
    assert "7 views of 2, 8 views of 2, 16 views of 2; 'cup/ctrain' has 7." in caplog.text
    counts = [16, 8, 7] * 2
    assert np.bincount(graph.scene_of).tolist() == counts
    assert np.bincount(graph.start_target).tolist() == [16, 8, 4] * 2
    assert graph.frames.mean((1, 2)).tolist() == [10 * i for n in counts for i in range(n)]
    assert graph.view_names[16:18] == ("e30_a000", "e30_a045")
    low, high = (
        tuple(f"{e}_a{d:03d}" for d in range(0, 360, step)) for e, step in (("e0", 90), ("e30", 120))
    )
    assert graph.view_names[24:31] == low + high
    moved = with_moves(graph, ["orbit_ccw_90", "orbit_up"], rigs)
    assert moved.moves[[0, 16, 24, 28]].tolist() == [[4, -1], [18, -1], [25, 28], [29, -1]]
    shutil.rmtree(tmp_path / "net/cup/train/atrain")
    counted = []
    less = opened(tmp_path / "net")
    path = prepared(less, tmp_path / "cache", progress=lambda *now: counted.append(now))
    assert counted == [(5, 5)]
    assert path.read_bytes() == prepared(less, tmp_path / "fresh").read_bytes()


def test_a_rig_that_pictures_were_not_taken_with_is_refused(tmp_path):
    for split in ("train", "test"):
        (tmp_path / f"net/cup/{split}").mkdir(parents=True)
        for i in range(8):
            cv2.imwrite(str(tmp_path / f"net/cup/{split}/{split}_{i}.png"), np.zeros((8, 8), np.uint8))
    dataset = opened(tmp_path / "net")
    for rig, sentence in (
        (Rings.even(16, [30.0]), r"'cup/train' in .* has 8 pictures, not 16; leave out env\.azimuths"),
        (Dodecahedron(), r"'cup/train' in .* has 8 pictures, not one for each of a dodecahedron's 20"),
    ):
        with pytest.raises(DataError, match=sentence):
            prepared(dataset, tmp_path / "cache", rig=rig)
    assert prepared(dataset, tmp_path / "cache", rig=Rings.even(8, [30.0])).exists()
    (tmp_path / "net/cup/train/train_3.png").unlink()
    (item, _) = opened(tmp_path / "net", skip_broken=True).items
    assert item.fault
    assert rigs_of(replace(dataset, items=(item,)), Dodecahedron()) == [Dodecahedron()]


def test_cameras_on_a_dodecahedron(tmp_path):
    dataset = shapes(train=2, test=1, classes=("cup",))
    graph = open_views(prepared(dataset, tmp_path, rig=Dodecahedron()), dataset)
    assert len(graph.frames) == len(graph.start_view) == 60
    assert len(set(graph.view_names[:20])) == 20


def test_a_cache_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(
        DataError, match=r"The cache .*/file cannot be written \(.*\); make room there or choose"
    ):
        prepared(shapes(), tmp_path / "file")


def test_a_disk_that_fills_up_keeps_what_is_done(tmp_path, monkeypatch):
    put, written = PartialGraph._write_all, []

    def full(self, data):
        written.append(len(data))
        if len(written) > 4:
            raise OSError(errno.ENOSPC, "No space left on device")
        put(self, data)

    monkeypatch.setattr(PartialGraph, "_write_all", full)
    monkeypatch.setattr(cache, "_FLUSH_SECONDS", 0.0)
    with pytest.raises(DataError, match=r"cannot be written .No space left on device.; make room"):
        prepared(shapes(), tmp_path)
    monkeypatch.undo()
    assert [name.rpartition(".")[2] for name in names(tmp_path)] == ["partial"]
    seen = []
    prepared(shapes(), tmp_path, progress=lambda done, _: seen.append(done))
    assert seen[0] == 2


def test_a_change_of_code_or_data_is_another_file(tmp_path, monkeypatch):
    dataset = shapes(train=2, test=1)
    path = prepared(dataset, tmp_path)
    assert read_key(path)["dataset"] == dict(dataset.origin)
    changed = [replace(item, stamp="other") for item in dataset.items]
    assert prepared(replace(dataset, items=tuple(changed)), tmp_path) != path
    monkeypatch.setattr("activelsd.envs.modelnet.prepare.code_digest", lambda *_: "other")
    counts = []
    assert prepared(dataset, tmp_path, progress=lambda done, _: counts.append(done)) != path
    assert counts[0] == 0, "what other code made is not taken"
    monkeypatch.undo()
    assert prepared(dataset, tmp_path) == path


def meshes(root, *names):
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"OFF4 2 0\n0 0 0\n1 0 {len(name)}\n0 1 0.{ord(name[-5])}\n0 0 1\n3 0 1 2\n3 0 1 3\n")
    return root


def test_what_is_rendered_is_used_whatever_is_chosen(tmp_path):
    """Only new and changed objects are rendered; the frames are those of a fresh cache."""
    folders = [f"{category}/{folder}" for category in ("bowl", "cup", "vase") for folder in ("train", "test")]
    root = meshes(tmp_path / "net", *(f"{folder}/{i}.off" for folder in folders for i in range(4)))
    rendered = {}

    def step(name, **options):
        dataset, counts = opened(root, **options), []
        path = prepared(dataset, tmp_path / "cache", progress=lambda done, _: counts.append(done))
        rendered[name] = max(0, len(counts) - 1)
        fresh = prepared(dataset, tmp_path / name)
        assert path.read_bytes() == fresh.read_bytes()
        graph = open_views(path, dataset)
        assert graph.targets == tuple(item.name for item in dataset.items)
        assert [graph.classes[label] for label in graph.labels] == [item.category for item in dataset.items]
        assert [SPLITS[s] for s in graph.start_split[::12]] == [item.split for item in dataset.items]

    step("all")
    step("again")
    step("mvcnn", split="mvcnn")
    step("lsdnet", split="lsdnet")
    step("two", classes=["bowl", "vase"])
    meshes(root, "cup/test/9.off")
    step("more")
    (root / "bowl/train/0.off").write_text("OFF3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    step("changed")
    (root / "cup/test/1.off").unlink()
    step("less")
    assert rendered == {
        "all": 24, "again": 0, "mvcnn": 0, "lsdnet": 0, "two": 0, "more": 1, "changed": 1, "less": 0
    }  # fmt: skip


def test_more_shapes_and_other_classes_render_what_is_new(tmp_path):
    prepared(shapes(train=3), tmp_path)
    counts = []
    prepared(shapes(train=4, classes=("cup",)), tmp_path, progress=lambda *step: counts.append(step))
    assert counts == [(5, 6), (6, 6)]
    counts.clear()
    prepared(shapes(train=4, classes=("cup",)), tmp_path, size=16, progress=lambda *step: counts.append(step))
    assert counts[0] == (0, 6)


def test_processes_start_light():
    code = "import sys, activelsd.envs.workers, activelsd.envs.modelnet.sources; print(*sys.modules)"
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, check=True)
    assert not {"torch", "cv2", "h5py", "trimesh", "matplotlib"} & set(loaded.stdout.split())


def test_a_change_of_a_source_is_seen(tmp_path, monkeypatch):
    """The module that makes the views is among those that a cache depends on."""
    path, source = prepared(shapes(), tmp_path), digest._source
    changed = tmp_path / "sources.py"
    changed.write_text(source("activelsd.envs.modelnet.sources").read_text().replace("np.stack", "np.array"))
    monkeypatch.setattr(
        digest, "_source", lambda name: changed if name == "activelsd.envs.modelnet.sources" else source(name)
    )
    digest.code_digest.cache_clear()
    assert prepared(shapes(), tmp_path) != path
    digest.code_digest.cache_clear()
