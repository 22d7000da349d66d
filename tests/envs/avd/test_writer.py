"""Sample scans: the files of the format, boxes of what is visible, moves that agree with positions."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import loadmat

from activelsd.envs.avd import writer
from activelsd.envs.avd.boxes import difficulty, visible_boxes
from activelsd.envs.avd.homes import DEFAULT_SCANS, HEADINGS, INSTANCES, MOVES, Home, parsed
from activelsd.envs.avd.writer import write_sample
from activelsd.errors import CacheError, ConfigError, DataError

SCANS = ("Home_003_1", "Office_001_2")
SIZE = {"width": 64, "height": 36}  # pixels
BACK = {"forward": "backward", "backward": "forward", "left": "right", "right": "left"} | {
    "rotate_cw": "rotate_ccw",
    "rotate_ccw": "rotate_cw",
}


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    return write_sample(tmp_path_factory.mktemp("sample") / "avd", scans=SCANS, workers=1, **SIZE)


@pytest.fixture(scope="module")
def home():
    return Home(SCANS[0], 0)


def annotations(root, scan=SCANS[0]):
    return json.loads((root / scan / "annotations.json").read_text())


def poses(root, scan=SCANS[0]):
    """Position in millimetres and direction by file name."""
    content = loadmat(root / scan / "image_structs.mat")
    scale = content["scale"].item()
    return {
        row["image_name"].item(): (row["world_pos"][:, 0] * scale, row["direction"][:, 0])
        for row in content["image_structs"][0]
    }


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_files_of_the_format(sample):
    names = dict(line.split() for line in (sample / "instance_id_map.txt").read_text().splitlines())
    assert names["background"] == "0"
    assert sorted(map(int, names.values())) == list(range(34))
    for scan in SCANS:
        entries = annotations(sample, scan)
        assert set(entries) == {path.name for path in (sample / scan / "jpg_rgb").iterdir()}
        depths = {f"{name[:13]}03.png" for name in entries}
        assert depths == {path.name for path in (sample / scan / "high_res_depth").iterdir()}
        assert len(entries) % 12 == 0
        assert len(entries) >= 12 * 34
        present = (sample / scan / "present_instance_names.txt").read_text().split()
        assert len(present) == 24
        assert set(present) <= set(names)
        seen = {box[4] for entry in entries.values() for box in entry["bounding_boxes"]}
        assert seen <= {int(names[name]) for name in present}
        line = (sample / scan / "cameras.txt").read_text().splitlines()[3].split()
        focal = 64 * 1070 / 1920
        np.testing.assert_allclose([float(x) for x in line[4:8]], (focal, focal, 32, 18), rtol=1e-4)
    assert not list(sample.glob(".*"))


def test_file_names_carry_place_scene_scan_and_index(sample):
    assert parsed("Home_001_1").image(1, "01") == "000110000010101"
    for scan, start in zip(SCANS, ("00031", "10012"), strict=True):
        names = sorted(annotations(sample, scan))
        assert all(len(name) == 19 and name.startswith(start) and name.endswith("0101.jpg") for name in names)
        assert [int(name[5:11]) for name in names] == list(range(1, len(names) + 1))


def test_pictures_are_photographs_of_the_size(sample):
    name = next(iter(annotations(sample)))
    colour = cv2.imread(str(sample / SCANS[0] / "jpg_rgb" / name))
    depth = cv2.imread(str(sample / SCANS[0] / "high_res_depth" / f"{name[:13]}03.png"), cv2.IMREAD_UNCHANGED)
    assert colour.shape == (36, 64, 3)
    assert depth.shape == (36, 64)
    assert depth.dtype == np.uint16
    assert np.ptp(colour) > 60


def test_boxes_and_depth_are_those_of_the_visible_pixels(sample, home):
    """Looked at again: the extents of every instance's pixels, and the depth the camera has."""
    entries = list(annotations(sample).items())
    checked = 0
    for index in range(0, len(entries), 37):
        name, entry = entries[index]
        picture = home.look(home.camera(index // HEADINGS, index % HEADINGS, 64, 36))
        ids = home.instance_of[picture.things]
        for x0, y0, x1, y1, instance, _ in entry["bounding_boxes"]:
            rows, columns = np.nonzero(ids == instance)
            assert (x0, y0, x1, y1) == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
            checked += 1
        boxed = {box[4] for box in entry["bounding_boxes"]}
        assert all((ids == i).sum() == 0 for i in set(range(1, 34)) - boxed)  # at this size a pixel is a lot
        png = sample / SCANS[0] / "high_res_depth" / f"{name[:13]}03.png"
        depth = cv2.imread(str(png), cv2.IMREAD_UNCHANGED)
        assert np.abs(depth / 1000 - picture.depth).max() <= 0.00051
    assert checked > 20


def test_depth_agrees_with_positions(sample):
    """A surface seen from two points is at one place: the walls' extents are the same from everywhere."""
    content = loadmat(sample / SCANS[0] / "image_structs.mat")
    metres = content["scale"].item() / 1000
    f = 64 * 1070 / 1920
    u, v = np.meshgrid(np.arange(64) + 0.5 - 32, np.arange(36) + 0.5 - 18)
    rays = np.stack([u / f, v / f, np.ones_like(u)], axis=-1).reshape(-1, 3)
    reach = []
    for row in content["image_structs"][0]:
        name = row["image_name"].item()
        png = sample / SCANS[0] / "high_res_depth" / f"{name[:13]}03.png"
        depth = cv2.imread(str(png), cv2.IMREAD_UNCHANGED).reshape(-1, 1) / 1000
        world = (rays * depth - row["t"][:, 0] * metres) @ row["R"]  # X = R' (x - t)
        np.testing.assert_allclose(-row["R"].T @ row["t"], row["world_pos"], atol=1e-6)
        seen = world[depth[:, 0] > 0]
        reach.append((seen.min(axis=0), seen.max(axis=0)))
    low, high = np.min([r[0] for r in reach], axis=0), np.max([r[1] for r in reach], axis=0)
    room = Home(SCANS[0], 0).room.plan
    assert high[1] == pytest.approx(0.0, abs=0.01)  # the floor; y points down
    for axis, side in ((0, room.width), (2, room.depth)):
        assert low[axis] == pytest.approx(0.0, abs=0.15)  # or the depth of a window
        assert high[axis] == pytest.approx(side, abs=0.15)


def test_moves_agree_with_positions(sample):
    entries, where = annotations(sample), poses(sample)
    blocked = 0
    for name, entry in entries.items():
        place, ahead = where[name]
        for move in MOVES:
            if not entry[move]:
                blocked += 1
                continue
            there, looking = where[entry[move]]
            assert entries[entry[move]][BACK[move]] == name  # steps can be taken back
            if move in ("rotate_cw", "rotate_ccw"):
                np.testing.assert_allclose(there, place)
                cross = ahead[0] * looking[2] - ahead[2] * looking[0]
                sine = cross / np.hypot(ahead[0], ahead[2]) / np.hypot(looking[0], looking[2])
                assert sine == pytest.approx(-0.5 if move == "rotate_cw" else 0.5, abs=1e-6)
                continue
            step = (there - place)[[0, 2]]
            assert np.linalg.norm(step) == pytest.approx(300.0)
            np.testing.assert_allclose(looking, ahead)
            x, z = ahead[[0, 2]] / np.hypot(ahead[0], ahead[2])
            way = {"forward": (x, z), "backward": (-x, -z), "left": (-z, x), "right": (z, -x)}[move]
            assert step @ way / 300 > np.cos(np.radians(31))
    assert blocked > 0


def test_instances_are_the_same_everywhere_and_spread_over_homes():
    homes = [Home(scan, 0) for scan in DEFAULT_SCANS]
    models = {}
    for home in homes:
        for thing, i in zip(home.room.things, home.instance_of[:-1], strict=True):
            if i:
                mesh, paint, materials = thing.model.mesh, thing.model.paint, thing.model.materials
                made = mesh.vertices.tobytes() + paint.tobytes() + repr(materials).encode()
                models.setdefault(INSTANCES[i - 1], []).append(made)
    assert set(models) == set(INSTANCES)
    for seen in models.values():
        assert len(seen) >= 3
        assert len(set(seen)) == 1
    trained, tested = ({n for home in part for n in home.present} for part in (homes[:14], homes[15:]))
    assert trained == tested == set(INSTANCES)


def test_two_scans_of_a_home_share_the_furniture():
    one, other = Home("Home_004_1", 0), Home("Home_004_2", 0)

    def places(home):
        return [thing[1:] for thing in home.room.things[: home.room.furniture]]

    assert places(one) == places(other)
    assert one.present != other.present
    assert places(one) != places(Home("Home_004_1", 1))


def test_same_bytes_by_processes_and_resumed(sample, tmp_path, monkeypatch):
    """A scan that is whole stays, one that was cut off is made anew; all as if made in one go."""
    root = tmp_path / "again"
    monkeypatch.setattr(writer, "_complete", stop_at("Office_001_2", writer._complete))
    with pytest.raises(KeyboardInterrupt):
        write_sample(root, scans=SCANS, workers=1, **SIZE)
    assert (root / "Home_003_1").is_dir()
    assert not (root / "Office_001_2").exists()
    monkeypatch.undo()
    stamp = (root / "Home_003_1").stat().st_mtime_ns
    steps = []
    write_sample(root, scans=SCANS, workers=2, progress=lambda *step: steps.append(step), **SIZE)
    assert (root / "Home_003_1").stat().st_mtime_ns == stamp
    total = sum(len(annotations(root, scan)) for scan in SCANS)
    assert steps[0] == (len(annotations(root)), total)
    assert steps[-1] == (total, total)
    assert files(root) == files(sample)


def stop_at(scan, complete):
    def completed(root, sample, job, boxes):
        if job.name == scan:
            raise KeyboardInterrupt
        complete(root, sample, job, boxes)

    return completed


def test_what_cannot_be_is_refused(sample, tmp_path):
    with pytest.raises(ConfigError, match="'Home_1' cannot be a scan"):
        write_sample(tmp_path, scans=["Home_1"])
    with pytest.raises(DataError, match="other settings"):
        write_sample(sample, scans=SCANS, seed=1, **SIZE)
    (tmp_path / "letter.txt").write_text("mine")
    with pytest.raises(DataError, match="holds other things"):
        write_sample(tmp_path, scans=SCANS, **SIZE)


@given(st.integers(1, 1920), st.integers(1, 1080))
def test_difficulty_is_the_datasets_rule(one, other):
    larger, smaller = max(one, other), min(one, other)
    expected = 5
    for number, (most, least) in ((4, (50, 30)), (3, (100, 50)), (2, (200, 75)), (1, (300, 100))):
        if larger >= most and smaller >= least:
            expected = number
    assert difficulty(one, other, 1920) == expected
    assert difficulty(other, one, 1920) == expected


def test_difficulty_scales_with_the_width():
    assert difficulty(75, 25, 480) == 1
    assert difficulty(74, 25, 480) == 2
    assert difficulty(12, 8, 480) == 5


def test_boxes_are_half_open_and_leave_out_specks():
    ids = np.zeros((270, 480), np.int32)
    ids[10:20, 30:70] = 5
    ids[100:102, 100:104] = 7  # 8 of at least 12.5 pixels
    ids[260:270, 470:480] = 2
    assert visible_boxes(ids) == [[470, 260, 480, 270, 2, 5], [30, 10, 70, 20, 5, 4]]


def test_what_cannot_be_written_is_the_users_to_mend(tmp_path):
    """Also in a process that was started for it, whose errors come back as sentences."""
    part = {"name": SCANS[0], "folder": str(tmp_path / "full" / ".part"), "first": 0, "last": 1}
    with (
        writer.photographer({"seed": 0, **SIZE}) as photograph,
        pytest.raises(CacheError, match=r"full cannot be written \(No such file"),
    ):
        photograph(part)
