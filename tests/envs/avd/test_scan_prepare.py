"""Preparing scans: the graph they make, the cache, and going on after whatever interrupts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from activelsd.envs.avd.prepare import prepare
from activelsd.envs.avd.scan import MOVES, read_instances, read_scan
from activelsd.envs.crops import cut_out, squashed
from activelsd.envs.viewgraph import load_graph
from activelsd.errors import DataError
from tests.envs.avd.homes import INSTANCES, entry, name, photograph, ring, write_homes, write_map, write_scan

SIZE = 16


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_homes(tmp_path / "data", homes=2)


def folders(root: Path) -> list[Path]:
    return sorted(path for path in root.iterdir() if path.is_dir())


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_graph_holds_what_the_scans_do(root: Path, tmp_path: Path) -> None:
    graph = load_graph(prepare(folders(root), size=SIZE, cache=tmp_path / "cache"))
    scans = [read_scan(folder, read_instances(root)) for folder in folders(root)]
    assert graph.scenes == ("Home_001_1", "Home_002_1")
    assert graph.classes == INSTANCES
    assert graph.move_names == MOVES
    assert len(graph.frames) == sum(len(scan.files) for scan in scans) == 8
    assert graph.targets[:2] == ("Home_001_1/advil_liqui_gels", "Home_001_1/coca_cola_glass_bottle")
    assert graph.pair_of is not None
    assert graph.boxes is not None
    assert graph.crops is not None
    assert sorted(graph.pair_of[graph.pair_of >= 0].tolist()) == list(range(len(graph.boxes)))
    first, pair = 0, 0
    for scene, scan in enumerate(scans):
        for view, file in enumerate(scan.files):
            picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            v = first + view
            assert (graph.scene_of[v], graph.view_names[v]) == (scene, file.stem)
            np.testing.assert_array_equal(graph.frames[v], squashed(picture, SIZE))
            leads = scan.moves[view]
            np.testing.assert_array_equal(graph.moves[v], np.where(leads >= 0, leads + first, -1))
            for row in np.flatnonzero(scan.box_view == view):
                target = graph.targets.index(f"{scan.name}/{INSTANCES[scan.box_instance[row] - 1]}")
                assert graph.labels[target] == scan.box_instance[row] - 1
                assert graph.pair_of[v, target] == pair
                x0, y0, x1, y1 = scan.boxes[row] / [160, 90, 160, 90]
                expected = [(x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0]
                np.testing.assert_allclose(graph.boxes[pair], expected, rtol=1e-6)
                np.testing.assert_array_equal(graph.crops[pair], cut_out(picture, scan.boxes[row], SIZE))
                pair += 1
            assert (graph.pair_of[v] >= 0).sum() == (scan.box_view == view).sum()
        first += len(scan.files)
    assert pair == len(graph.crops)


def test_an_instance_that_no_box_shows_is_no_target(tmp_path: Path) -> None:
    write_map(tmp_path)
    write_scan(tmp_path / "Home_001_1", ring(3, {2: [[10, 10, 50, 50, 3, 1]]}))
    graph = load_graph(prepare(folders(tmp_path), size=SIZE, cache=tmp_path / "cache"))
    assert graph.targets == ("Home_001_1/red_bull",)
    assert graph.labels.tolist() == [2]
    write_scan(tmp_path / "Home_001_1", ring(3, {}))
    with pytest.raises(DataError, match="Home_001_1: no photograph shows an instance"):
        prepare([tmp_path / "Home_001_1"], size=SIZE, cache=tmp_path / "cache")


def test_what_is_there_is_taken_and_a_change_of_any_file_makes_another(root: Path, tmp_path: Path) -> None:
    cache, seen = tmp_path / "cache", list[tuple[int, int]]()
    first = prepare(folders(root), size=SIZE, cache=cache, progress=lambda *counts: seen.append(counts))
    assert seen == [(i, 8) for i in range(9)]
    assert prepare(folders(root), size=SIZE, cache=cache, progress=lambda *_: pytest.fail("again")) == first
    assert names(cache) == [first.name]
    made = {
        first,
        prepare(folders(root), size=2 * SIZE, cache=cache),
        prepare(folders(root)[:1], size=SIZE, cache=cache),
    }
    changed = [root / "instance_id_map.txt", *(root / "Home_001_1").glob("*.*")]
    changed.append(root / "Home_001_1" / "jpg_rgb" / name(2))
    for file in changed:
        os.utime(file, (0, file.stat().st_mtime + 10))
        made.add(prepare(folders(root), size=SIZE, cache=cache))
    assert len(made) == 3 + len(changed) == 3 + 5
    assert len(names(cache)) == len(made)


def test_threads_change_nothing(root: Path, tmp_path: Path) -> None:
    one, many = (prepare(folders(root), size=SIZE, cache=tmp_path / str(n), workers=n) for n in (1, 5))
    assert one.read_bytes() == many.read_bytes()


@pytest.mark.parametrize("at", [1, 4])
def test_a_broken_photograph_ends_it_by_name_and_leaves_nothing(root: Path, tmp_path: Path, at: int) -> None:
    broken = root / "Home_002_1" / "jpg_rgb" / name(at, "0002")
    broken.write_bytes(b"<html>")
    with pytest.raises(DataError, match=f"{broken.name} is not a whole picture"):
        prepare(folders(root), size=SIZE, cache=tmp_path / "cache")
    photograph(broken, size=(80, 45))
    with pytest.raises(DataError, match=r"pixels, and others of its scan .*; copy it again"):
        prepare(folders(root), size=SIZE, cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


SCRIPT = """
import sys, time
from pathlib import Path
from activelsd.envs import cache
from activelsd.envs.avd.prepare import prepare

cache._FLUSH_SECONDS = 0.0

def progress(done, total):
    print(done, flush=True)
    time.sleep(0.02)

prepare([Path(sys.argv[1])], size=16, cache=Path(sys.argv[2]), progress=progress)
"""


def test_what_is_killed_goes_on(tmp_path: Path) -> None:
    write_map(tmp_path / "data")
    boxes = {i: [[10 + i, 10, 50 + i, 50, 1 + i % 4, 1]] * (i % 2) for i in range(1, 31)}
    scan = write_scan(tmp_path / "data" / "Home_001_1", ring(30, boxes))
    cache, counts = tmp_path / "cache", list[int]()
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    for stop_at in (9, None):
        command = [sys.executable, "-c", SCRIPT, str(scan), str(cache)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as process:
            counts.clear()
            assert process.stdout is not None
            for line in process.stdout:
                counts.append(int(line))
                if counts[-1] == stop_at:
                    process.send_signal(signal.SIGKILL)
                    break
        assert process.returncode == (-signal.SIGKILL if stop_at else 0)
    assert counts[0] >= 8
    assert counts[-1] == 30
    (file,) = cache.glob("*")
    assert file.read_bytes() == prepare([scan], size=16, cache=tmp_path / "whole").read_bytes()


def test_photographs_without_boxes_are_frames_all_the_same(tmp_path: Path) -> None:
    write_map(tmp_path)
    annotations = {name(1): entry(), name(2): entry([[10, 10, 50, 50, 1, 1]]), name(3): entry()}
    write_scan(tmp_path / "Home_001_1", annotations)
    graph = load_graph(prepare(folders(tmp_path), size=SIZE, cache=tmp_path / "cache"))
    assert graph.frames.any(axis=(1, 2)).all()
    assert len({frame.tobytes() for frame in graph.frames}) == 3
