"""Reading a scan: every trap of the format, in one written by hand, and a sentence for each broken one."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from activelsd.envs.avd import scan as reader
from activelsd.envs.avd.datasets import scans_in
from activelsd.envs.avd.scan import MOVES, Scan, read_instances, read_scan
from activelsd.envs.crops import cut_out, squashed
from activelsd.errors import DataError
from tests.envs.avd.homes import (
    HEIGHT,
    INSTANCES,
    WIDTH,
    entry,
    name,
    photograph,
    pose,
    structs,
    write_homes,
    write_map,
    write_scan,
)

A, B, C, D, E, F = (name(i) for i in range(1, 7))
GONE = name(99)


@pytest.fixture
def trapped(tmp_path: Path) -> Path:
    """A scan with every trap in it. A, B, C, E are views; D is not annotated, GONE is not on disk."""
    write_map(tmp_path)
    annotations = {
        # Fewer than 12 images at the point; a one-way edge to B; a pointer to a photograph not on disk.
        A: entry([[10, 20, 50, 60, 1, 2]], forward=B, rotate_cw=GONE, left=D),
        # A self-loop, and boxes over every border, at it, outside, empty, and inside out.
        B: entry(
            [
                [-30, -5, 40, 95, 1, 1],
                [100, 10, WIDTH, 50, 2, 3],
                [170, 10, 200, 50, 3, 3],
                [5, 5, 5, 9, 4, 5],
            ],
            rotate_cw=B,
        ),
        # One instance twice in a photograph: the larger counts, wherever it is listed.
        C: entry([[0, 0, 10, 10, 2, 5], [20, 20, 60, 70, 2, 1], [80, 80, 90, 85, 2, 5]], backward=E, right=A),
        # A view annotated that is not on disk, in spite of what leads there.
        GONE: entry([[0, 0, 50, 50, 3, 1]], rotate_ccw=A),
        # Coordinates that are not whole numbers; no boxes key at all would be fine too.
        E: entry([[30.4, 9.6, 70.0, 40.0, 3.0, 4.0]]),
    }
    rows = [
        pose(A, 0.5, -1.0),
        pose(B, 0.5, -0.7, (1.0, 0.0)),
        # No pose: R is 0 x 0.
        {**pose(C), "R": np.zeros((0, 0)), "world_pos": np.zeros((0, 0)), "direction": np.zeros((0, 0))},
        pose(GONE),
        pose(D, 9.0, 9.0),
    ]
    on_disk = [A, B, C, D, E]
    scan = write_scan(
        tmp_path / "Home_001_1",
        annotations,
        on_disk=on_disk,
        poses=rows,
        scale=2000.0,
        present="advil_liqui_gels\n\n  red_bull \n\n\n",
    )
    (scan / "special_note.txt").write_text("coca_cola_glass_bottle stands twice in this scene")
    (scan / "jpg_rgb" / "Thumbs.db").write_text("not a photograph")
    return scan


def read(folder: Path) -> Scan:
    return read_scan(folder, read_instances(folder.parent))


def edges(scan: Scan) -> set[tuple[str, str, str]]:
    """(from, move, to) of every move that leads somewhere."""
    rows, columns = np.nonzero(scan.moves >= 0)
    files = [file.name for file in scan.files]
    return {(files[v], MOVES[m], files[scan.moves[v, m]]) for v, m in zip(rows, columns, strict=True)}


def boxes(scan: Scan, image: str) -> dict[str, tuple[int, ...]]:
    """Instance to box of a photograph."""
    view = [file.name for file in scan.files].index(image)
    rows = np.flatnonzero(scan.box_view == view)
    return {INSTANCES[scan.box_instance[row] - 1]: tuple(scan.boxes[row].tolist()) for row in rows}


def test_views_are_what_is_on_disk_and_annotated(trapped: Path) -> None:
    scan = read(trapped)
    assert [file.name for file in scan.files] == [A, B, C, E]
    assert (scan.name, scan.width, scan.height) == ("Home_001_1", WIDTH, HEIGHT)


def test_moves_are_one_way_may_loop_and_are_blocked_where_nothing_is(trapped: Path) -> None:
    assert edges(read(trapped)) == {
        (A, "forward", B),
        (B, "rotate_cw", B),
        (C, "backward", E),
        (C, "right", A),
    }


def test_boxes_are_half_open_clipped_and_one_an_instance(trapped: Path) -> None:
    scan = read(trapped)
    assert boxes(scan, A) == {"advil_liqui_gels": (10, 20, 50, 60)}
    assert boxes(scan, B) == {
        "advil_liqui_gels": (0, 0, 40, HEIGHT),
        "coca_cola_glass_bottle": (100, 10, WIDTH, 50),
    }
    assert boxes(scan, C) == {"coca_cola_glass_bottle": (20, 20, 60, 70)}
    assert boxes(scan, E) == {"red_bull": (30, 10, 70, 40)}
    assert scan.difficulty.tolist() == [2, 1, 3, 1, 4]
    assert (np.diff(scan.box_view) >= 0).all()


def test_poses_are_metres_and_degrees_and_may_be_missing(trapped: Path) -> None:
    poses = read(trapped).poses
    np.testing.assert_allclose(poses[:2], [[1.0, -2.0, 0.0], [1.0, -1.4, 90.0]], rtol=1e-6)
    assert np.isnan(poses[2]).all(), "its R is 0 x 0"
    assert np.isnan(poses[3]).all(), "it has no row"


def test_the_map_of_instances_may_hold_blank_lines_and_leaves_the_background_out(tmp_path: Path) -> None:
    (tmp_path / "instance_id_map.txt").write_text("b_c 2\n\nbackground 0\n a_b\t1 \nd 33".replace("\t", " "))
    assert list(read_instances(tmp_path).items()) == [("a_b", 1), ("b_c", 2), ("d", 33)]


@pytest.mark.parametrize(
    ("text", "match"), [("a 1\nb 1", "the id 1 twice, also to 'b'"), ("a 1\na 2", "'a' two")]
)
def test_an_id_or_a_name_that_is_there_twice_is_refused(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "instance_id_map.txt").write_text("a 1\n" + text)
    with pytest.raises(DataError, match=match):
        read_instances(tmp_path)


def change(folder: Path, **moves: str) -> None:
    file = folder / "annotations.json"
    content = json.loads(file.read_text())
    content[A] |= moves
    file.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "pointer", ["../../outside.jpg", "/etc/outside.jpg", "jpg_rgb/x.jpg", "..\\x.jpg", "..", "x\0.jpg"]
)
@pytest.mark.parametrize("as_key", [False, True])
def test_names_outside_the_scan_are_refused(trapped: Path, pointer: str, as_key: bool) -> None:
    photograph(trapped.parent.parent / "outside.jpg")
    if as_key:
        file = trapped / "annotations.json"
        file.write_text(json.dumps({**json.loads(file.read_text()), pointer: entry()}))
    else:
        change(trapped, forward=pointer)
    with pytest.raises(DataError, match=r"annotations.json names '.*', which is outside the scan's folder;"):
        read(trapped)


def test_a_scan_of_the_older_release_is_recognised(tmp_path: Path) -> None:
    old = tmp_path / "Home_01_1"
    (old / "rgb").mkdir(parents=True)
    (old / "annotations").mkdir()
    (old / "annotations" / "1_boxes.txt").write_text("1 10 20 30 40\n")
    with pytest.raises(
        DataError, match=r"Home_01_1 is a scan of the data set's older release .* not supported"
    ):
        read_scan(old, {"a": 1})
    with pytest.raises(DataError, match="older release"):
        scans_in(tmp_path)


def test_a_million_entries_are_refused_quickly(trapped: Path) -> None:
    body = ",".join(f'"{i}.jpg":{{}}' for i in range(10**6))
    (trapped / "annotations.json").write_text("{" + body + "}")
    began = time.monotonic()
    with pytest.raises(DataError, match="describes 1000000 photographs, more than any scan has"):
        read(trapped)
    assert time.monotonic() - began < 10
    with (trapped / "annotations.json").open("wb") as file:
        file.truncate(reader.MOST_BYTES + 1)
    with pytest.raises(DataError, match="has 64 MiB, more than any scan's"):
        read(trapped)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('{"a.jpg": {"bounding_boxes": [', "is not complete JSON"),
        ("[" * 100_000, "is not complete JSON"),
        ("", "is not complete JSON"),
        ("[1, 2]", "must contain one object with a key per photograph"),
        (json.dumps({A: [1]}), f"has no boxes and moves for '{A}'"),
        (json.dumps({A: entry() | {"bounding_boxes": {}}}), f"has no boxes and moves for '{A}'"),
        (json.dumps({A: entry(forward=3)}), "names a photograph 3, which is not a file name"),  # type: ignore[arg-type]
        (json.dumps({GONE: entry()}), "describes none of the photographs"),
        (
            json.dumps({A: entry([[1, 2, 3, 4, 77, 1]])}),
            f"has instance 77 in '{A}', but instance_id_map",
        ),
        (json.dumps({A: entry([[1, 2, 3, 4, 1]])}), r"has a box \[1, 2, 3, 4, 1\]"),
        (json.dumps({A: entry([["x", 2, 3, 4, 1, 1]])}), "has a box"),  # type: ignore[list-item]
        (json.dumps({A: entry([[float("nan"), 2, 3, 4, 1, 1]])}), "has a box"),  # type: ignore[list-item]
        (json.dumps({A: entry([[10**400, 2, 3, 4, 1, 1]])}), "has a box"),
    ],
)
def test_annotations_that_are_broken(trapped: Path, text: str, sentence: str) -> None:
    (trapped / "annotations.json").write_text(text)
    with pytest.raises(DataError, match=f"annotations.json {sentence}") as error:
        read(trapped)
    assert str(error.value).count("\n") == 0


@pytest.mark.parametrize(
    "missing", ["annotations.json", "image_structs.mat", "present_instance_names.txt", "instance_id_map.txt"]
)
def test_missing_files_are_named(trapped: Path, missing: str) -> None:
    (trapped.parent / missing if missing.startswith("instance") else trapped / missing).unlink()
    with pytest.raises(DataError, match=f"{missing} cannot be read .No such file or directory.; copy"):
        read(trapped)


def test_missing_photographs_are_told(trapped: Path) -> None:
    for file in (trapped / "jpg_rgb").glob("*.jpg"):
        file.unlink()
    with pytest.raises(DataError, match="jpg_rgb contains no photograph; unpack"):
        read(trapped)
    (trapped / "jpg_rgb" / "Thumbs.db").unlink()
    (trapped / "jpg_rgb").rmdir()
    with pytest.raises(DataError, match="jpg_rgb cannot be read"):
        read(trapped)


@pytest.mark.parametrize("cut", [0, 3, 128, 200, 900])
def test_a_table_of_poses_cut_short_or_foreign_is_one_sentence(trapped: Path, cut: int) -> None:
    file = trapped / "image_structs.mat"
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises(DataError, match=r"image_structs.mat (is not a table of poses|cannot be read)"):
        read(trapped)


def test_a_table_of_poses_without_its_parts_is_one_sentence(trapped: Path) -> None:
    from scipy.io import savemat

    for content in (
        {"scale": 1.0},
        {"image_structs": structs([pose(A)])},
        {"image_structs": 3.0, "scale": 1.0},
    ):
        savemat(trapped / "image_structs.mat", content)
        with pytest.raises(DataError, match=r"image_structs.mat is not a table of poses"):
            read(trapped)


def test_a_jpg_that_is_not_one_is_named(trapped: Path) -> None:
    whole = (trapped / "jpg_rgb" / A).read_bytes()
    for data in (b"", b"<html>not found</html>", whole[: len(whole) // 2]):
        (trapped / "jpg_rgb" / A).write_bytes(data)
        with pytest.raises(DataError, match=f"{A} is not a whole picture; copy it again or remove it"):
            read(trapped)


def test_an_instance_unknown_to_the_map_names_the_nearest(trapped: Path) -> None:
    (trapped / "present_instance_names.txt").write_text("advil_liqui_gel\n")
    with pytest.raises(DataError, match=r"names 'advil_liqui_gel', which .* did you mean advil_liqui_gels"):
        read(trapped)


@pytest.mark.parametrize("ending", [".JPG", ".jpeg", ".png"])
def test_photographs_have_any_ending_and_annotations_perhaps_another(trapped: Path, ending: str) -> None:
    whole = read(trapped)
    for file in (trapped / "jpg_rgb").glob("*.jpg"):
        file.rename(file.with_suffix(ending))
    scan = read(trapped)
    assert [file.name for file in scan.files] == [file.stem + ending for file in whole.files]
    np.testing.assert_array_equal(scan.moves, whole.moves)
    np.testing.assert_array_equal(scan.poses, whole.poses)
    np.testing.assert_array_equal(scan.boxes, whole.boxes)
    (trapped / "jpg_rgb" / A).write_bytes(scan.files[0].read_bytes() + b"a film after the photograph")
    with pytest.raises(DataError, match="are the same photograph; remove one of them"):
        read(trapped)
    scan.files[0].unlink()
    assert read(trapped).files[0].name == A


def test_scans_one_folder_off_or_packed_are_told(tmp_path: Path) -> None:
    write_homes(tmp_path / "homes" / "all", homes=2)
    with pytest.raises(DataError, match=r"homes holds no scan .*, but .*/homes/all does; give that folder"):
        scans_in(tmp_path / "homes")
    with pytest.raises(
        DataError, match=r"Home_001_1 is a scan itself; give the folder that holds it, .*/all"
    ):
        scans_in(tmp_path / "homes" / "all" / "Home_001_1")
    (tmp_path / "avd.zip").write_bytes(b"PK")
    with pytest.raises(DataError, match=r"avd\.zip is no folder; unpack it and give the folder that holds"):
        scans_in(tmp_path / "avd.zip")
    (tmp_path / "packed").mkdir()
    (tmp_path / "packed" / "Home_001_1.tar").write_bytes(b"")
    with pytest.raises(DataError, match=r"packed holds no scan, but the archive Home_001_1\.tar; unpack it"):
        scans_in(tmp_path / "packed")


def test_a_root_without_scans_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no scan of the Active Vision Dataset; give the folder"):
        scans_in(tmp_path)
    with pytest.raises(DataError, match=r"There is no dataset at .*/nowhere; check env\.dataset\.path"):
        scans_in(tmp_path / "nowhere")
    write_homes(tmp_path, homes=2)
    assert list(scans_in(tmp_path)) == ["Home_001_1", "Home_002_1"]
    (tmp_path / "Home_002_1").rename(tmp_path / "kitchen")
    with pytest.raises(DataError, match="kitchen is a scan whose name does not say its home"):
        scans_in(tmp_path)


def test_squashing_keeps_fractions() -> None:
    picture = np.zeros((90, 160), np.uint8)
    picture[45:, 40:80] = 255
    small = squashed(picture, 16)
    assert small[8:, 4:8].min() == 255
    assert int(small.astype(int).sum()) == 255 * 8 * 4


def test_a_crop_is_the_square_around_its_box_and_the_edge_goes_on_beyond_the_photograph() -> None:
    picture = np.full((100, 100), 50, np.uint8)
    picture[40:60, 45:55] = 250
    crop = cut_out(picture, np.array([45, 40, 55, 60]), 24)
    assert crop.shape == (24, 24)
    # 20 pixels high with context of 2 above and below; 10 wide in the middle of 24.
    assert (crop[2:22, 7:17] == 250).all()
    assert int((crop == 250).sum()) == 200
    corner = cut_out(picture, np.array([0, 0, 50, 100]), 60)
    assert (corner[:, :10] == 50).all()
    assert cut_out(picture, np.array([99, 99, 100, 100]), 8).shape == (8, 8)
