"""Point clouds: every format gives the same points, and what is wrong with a file is one sentence."""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from activelsd.envs.modelnet.cameras import Rings
from activelsd.envs.modelnet.points import decode_points
from activelsd.envs.world import world_settings
from activelsd.errors import DataError
from activelsd.scenery.discs import disc_mesh
from activelsd.scenery.orbit_renderer import render_views
from tests.graphs import opened

FUZZED = int(os.environ.get("FUZZED", "40"))
CLOUD = np.random.default_rng(0).normal(size=(40, 3)).astype(np.float32)


def npy(table):
    file = io.BytesIO()
    np.save(file, table)
    return file.getvalue()


def refused(data, name, *words):
    with pytest.raises(DataError) as error:
        decode_points(data, name)
    message = str(error.value)
    assert message.startswith(name)
    assert "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "f2", "i4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_of_any_numbers(dtype, order):
    table = np.asarray(CLOUD * 10, dtype, order=order)
    np.testing.assert_array_equal(decode_points(npy(table), "a.npy").positions, table.astype(np.float64))


def test_columns_of_unit_length_are_normals_and_colours_are_not():
    normals = CLOUD / np.linalg.norm(CLOUD, axis=1, keepdims=True)
    found = decode_points(npy(np.hstack([CLOUD, normals])), "a.npy").normals
    np.testing.assert_allclose(found, normals, atol=1e-6)
    colours = np.random.default_rng(1).random((40, 3))
    for columns in (colours, 255 * colours, normals[:, :2]):
        assert decode_points(npy(np.hstack([CLOUD, columns])), "a.npy").normals is None


def test_what_is_no_point_cloud_is_said():
    whole = npy(CLOUD)
    refused(b"", "a.npy", "no header")
    refused(whole[:-4], "a.npy", "476 bytes of numbers where its header says 480")
    refused(whole + b"x", "a.npy", "481 bytes")
    refused(npy(CLOUD[:0]), "a.npy", "no points")
    refused(npy(CLOUD[:, :2]), "a.npy", "40 x 2")
    refused(npy(np.stack([CLOUD, CLOUD])), "a.npy", "2 x 40 x 3")
    refused(npy(CLOUD.astype("U8")), "a.npy", "str")
    for bad in (np.nan, np.inf, 1e300):
        table = CLOUD.astype(np.float64)
        table[7, 1] = bad
        refused(npy(table), "a.npy", "a point, number 7")


def pcd(body=None, *, data="binary", fields="x y z", kinds="F F F", sizes="4 4 4", count=40, more=""):
    body = CLOUD.tobytes() if body is None else body
    header = f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\n{more}"
    return f"{header}WIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA {data}\n".encode() + body


def rows(table=CLOUD, between=" "):
    return "".join(between.join(f"{value:.9g}" for value in row) + "\n" for row in table).encode()


def ply(body, *, form="binary_little_endian", more="", count=40):
    properties = "property float x\nproperty float y\nproperty float z\n"
    return f"ply\nformat {form} 1.0\nelement vertex {count}\n{properties}{more}end_header\n".encode() + body


RING = Rings.even(12, [0.0]).cameras
MARKED = "x y z rgb normal_x normal_y normal_z"
NORMALS = CLOUD / np.linalg.norm(CLOUD, axis=1, keepdims=True)
WIDE = np.hstack([CLOUD, np.full((40, 1), 7.0), NORMALS]).astype(np.float32)
SAME = {
    "binary.pcd": pcd(),
    "ascii.pcd": pcd(rows(), data="ascii"),
    "double.pcd": pcd(CLOUD.astype(np.float64).tobytes(), sizes="8 8 8"),
    "swapped.pcd": pcd(CLOUD[:, ::-1].tobytes(), fields="z y x"),
    "wide.pcd": pcd(
        WIDE.tobytes(), fields=MARKED, kinds="F F F U F F F", sizes="4 " * 7, more=f"COUNT{7 * ' 1'}\n"
    ),
    "histogram.pcd": pcd(
        np.hstack([np.zeros((40, 2)), CLOUD]).astype(np.float32).tobytes(),
        fields="fpfh x y z", kinds="F F F F", sizes="4 4 4 4", more="COUNT 2 1 1 1\n",
    ),
    "crlf.pcd": pcd(rows(), data="ascii").replace(b"\n", b"\r\n"),
    "binary.ply": ply(CLOUD.tobytes()),
    "ascii.ply": ply(rows(), form="ascii"),
    "no faces.ply": ply(rows(), form="ascii", more="element face 0\nproperty list uchar int vertices\n"),
    "plain.xyz": rows(),
    "comma.txt": rows(between=", "),
    "semicolon.txt": rows(between=";"),
    "tabs.xyz": rows(between="\t").replace(b"\n", b"\r\n"),
    "counted.pts": b"40\n" + rows(),
    "leica.pts": b"40\r\n" + rows(np.hstack([CLOUD, np.full((40, 4), 9.0)])),
    "header.xyz": b"x,y,z\n" + rows(between=","),
    "comment.txt": b"//X Y Z\n# a scan\n" + rows(),
    "byte order mark.txt": b"\xef\xbb\xbf" + rows(),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_every_format_gives_the_same_points(name):
    np.testing.assert_allclose(decode_points(SAME[name], name).positions, CLOUD, rtol=1e-6)


def test_normals_are_found_by_their_names():
    named = "x y z intensity nx ny nz"
    for name, data in {
        "a.pcd": SAME["wide.pcd"],
        "b.xyz": named.encode() + b"\n" + rows(WIDE),
        "c.xyz": b"//" + named.upper().encode() + b"\n" + rows(WIDE),
        "d.txt": rows(np.hstack([CLOUD, NORMALS]), between=","),
        "e.ply": ply(
            np.hstack([CLOUD, NORMALS]).astype("<f4").tobytes(),
            more="".join(f"property float n{axis}\n" for axis in "xyz"),
        ),
    }.items():
        np.testing.assert_allclose(decode_points(data, name).normals, NORMALS, atol=1e-6)


@pytest.mark.parametrize(
    ("data", "name", "words"),
    [
        (pcd(CLOUD.tobytes()[:-1]), "a.pcd", "39.9167 of 40 points"),
        (pcd(CLOUD.tobytes() + b"\0" * 12), "a.pcd", "41 of 40 points"),
        (pcd(rows(CLOUD[:39]), data="ascii"), "a.pcd", "39 of 40 points"),
        (pcd(data="binary_compressed"), "a.pcd", "binary_compressed data, which is not read"),
        (pcd(fields="x y w"), "a.pcd", "no columns x, y and z"),
        (pcd(kinds="F F X"), "a.pcd", "broken header"),
        (pcd(sizes="4 4"), "a.pcd", "broken header"),
        (pcd().replace(b"HEIGHT 1", b"HEIGHT 2"), "a.pcd", "40 x 2"),
        (pcd()[:60], "a.pcd", "no whole header"),
        (pcd(b"nan 0 0\n" * 40, data="ascii"), "a.pcd", "number 0, that is not finite"),
        (ply(CLOUD.tobytes()[:-1]), "a.ply", "39 of 40 rows"),
        (ply(b"", count=0), "a.ply", "no points"),
        (b"41\n" + rows(), "a.pts", "40 of 41 points"),
        (b"# nothing\n", "a.txt", "no points"),
        (rows() + b"1 2\n", "a.xyz", "'1 2'"),
        (rows() + b"one 2 3\n", "a.xyz", "'one 2 3'"),
        (b"1,5 2,5 3,5\n", "a.xyz", "commas may be decimal"),
        (b"1,5;2,5;3,5\n", "a.xyz", "commas may be decimal"),
        (b"1,,2,3\n", "a.xyz", "a number is missing"),
        (b"1 2\n3 4\n", "a.xyz", "2 x 2"),
        (b"\x89HDF\r\n\x1a\n", "a.xyz", "where numbers belong"),
    ],
)
def test_what_is_no_whole_cloud_is_said(data, name, words):
    refused(data, name, words)


@pytest.mark.parametrize("name", ["a.npy", *SAME])
def test_damaged_bytes_give_points_or_a_sentence(name):
    whole = npy(CLOUD) if name == "a.npy" else SAME[name]
    rng = np.random.default_rng(len(name))
    for _ in range(FUZZED):
        data = bytearray(whole)
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(0, min(len(data), 200) if rng.random() < 0.7 else len(data)))
            match rng.integers(0, 4):
                case 0:
                    data[at] = rng.integers(0, 256)
                case 1:
                    del data[at : at + int(rng.integers(1, 30))]
                case 2:
                    data[at:at] = bytes(data[: int(rng.integers(1, 30))])
                case _:
                    data[at] = rng.choice(list(b"0123456789-.,; \n#xF"))
            if not data:
                break
        try:
            positions, normals = decode_points(bytes(data), name)
        except DataError as error:
            said = str(error)
        else:
            assert np.isfinite(positions).all()
            assert normals is None or normals.shape == positions.shape
            continue
        assert said.startswith(name)
        assert "\n" not in said


@pytest.fixture
def clouds(tmp_path):
    rng = np.random.default_rng(0)
    for category, squash in (("ball", 1.0), ("plate", 0.1)):
        for folder, count in (("train", 3), ("test", 2)):
            (tmp_path / "clouds" / category / folder).mkdir(parents=True)
            for i in range(count):
                points = rng.normal(size=(300, 3))
                points *= (1, 1, squash) / np.linalg.norm(points, axis=1, keepdims=True)
                np.save(tmp_path / "clouds" / category / folder / f"{folder}_{i}.npy", points)
    return tmp_path / "clouds"


def test_a_folder_of_clouds_is_a_data_set(clouds):
    dataset = opened(clouds)
    assert dataset.classes == ("ball", "plate")
    for item in dataset.items:
        views = dataset.source.views(item, size=32, cameras=RING)
        shares = (views < 255).mean(axis=(1, 2))
        low, high = (0.5, 0.7) if item.category == "ball" else (0.03, 0.12)
        assert (low < shares).all()
        assert (shares < high).all()


def test_a_world_of_points_says_so(clouds, tmp_path):
    assert world_settings("modelnet", {"path": str(clouds)}).made_by() == "modelnet-points"
    assert world_settings("modelnet", {}).made_by() == "modelnet"


def test_points_beside_meshes_and_too_few_points_are_refused(clouds):
    np.save(clouds / "ball" / "train" / "train_0.npy", CLOUD[:5])
    dataset = opened(clouds)
    with pytest.raises(DataError, match=r"train_0\.npy cannot be rendered: there are 5 different points"):
        dataset.source.views(dataset.items[0], size=32, cameras=RING)
    assert world_settings("modelnet", {"path": str(clouds)}).made_by() == "modelnet-points"
    (clouds / "plate" / "test" / "a.off").write_text("OFF")
    with pytest.raises(DataError, match=r"holds meshes \(.*a.off\) and points \(.*npy\) side by side"):
        opened(clouds)


@pytest.mark.parametrize(
    ("ending", "written"), [(".txt", rows), (".ply", lambda table: ply(rows(table), form="ascii"))]
)
def test_texts_and_plys_are_told_from_notes_and_meshes(tmp_path, ending, written):
    for category in "ab":
        for folder in ("train", "test"):
            (tmp_path / category / folder).mkdir(parents=True)
            for i in range(2):
                (tmp_path / category / folder / f"{folder}_{i}{ending}").write_bytes(written(CLOUD + i))
    (tmp_path / "notes.txt").write_text("a note")
    dataset = opened(tmp_path)
    assert len(dataset.items) == 8
    assert dataset.source.spec()["kind"] == "points"
    assert world_settings("modelnet", {"path": str(tmp_path)}).made_by() == "modelnet-points"
    for item in dataset.items:
        (tmp_path / item.parts[0]).with_suffix(".off").write_text("OFF")
    if ending == ".txt":  # a note beside each mesh
        assert opened(tmp_path).source.spec()["kind"] == "meshes"
    else:
        with pytest.raises(DataError, match="side by side"):
            opened(tmp_path)


def test_a_ply_of_faces_among_points_is_named(tmp_path):
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    refused(ply(rows() + b"3 0 1 2\n", form="ascii", more=faces), "a.ply", "has faces")


@pytest.fixture
def release(tmp_path):
    """Cones, apex up, and plates, with y up as in the release."""
    top = tmp_path / "data" / "modelnet40_ply_hdf5_2048"
    top.mkdir(parents=True)
    (top / "shape_names.txt").write_text("plate\ncone\n")
    rng = np.random.default_rng(0)
    for split, files in (("train", 2), ("test", 1)):
        for i in range(files):
            height, angle = rng.uniform(0, 1, (6, 400)), rng.uniform(0, 2 * np.pi, (6, 400))
            label = np.arange(6) % 2
            width = np.where(label[:, None] == 1, 1 - height, np.sqrt(height))
            y = np.where(label[:, None] == 1, 2 * height, 0)
            with h5py.File(top / f"ply_data_{split}{i}.h5", "w") as file:
                data = np.stack([width * np.cos(angle), y, width * np.sin(angle)], axis=2)
                file.create_dataset("data", data=data.astype(np.float32), compression="gzip")
                file["label"] = label.astype(np.uint8)[:, None]
        lines = [f"data/modelnet40_ply_hdf5_2048/ply_data_{split}{i}.h5\n" for i in range(files)]
        (top / f"{split}_files.txt").write_text("".join(lines))
    names = [f"{('plate', 'cone')[i % 2]}/object_{9 - i}.ply" for i in range(6)]
    (top / "ply_data_train_1_id2file.json").write_text(json.dumps(names))
    return top


def test_the_release_in_hdf5_is_a_data_set(release, tmp_path):
    dataset = opened(release.parent)
    assert dataset.classes == ("cone", "plate")
    names = [item.name for item in dataset.items if item.split != "test"]
    assert names[:3] == ["cone/object_4", "cone/object_6", "cone/object_8"]
    assert names[3] == "cone/ply_data_train0_0001"
    assert len(dataset.items) == 18
    archive = tmp_path / "release.zip"
    with zipfile.ZipFile(archive, "w") as file:
        for path in release.iterdir():
            file.write(path, f"modelnet40_ply_hdf5_2048/{path.name}")
    zipped = opened(archive)
    for one, other in zip(dataset.items, zipped.items, strict=True):
        views = dataset.source.views(one, size=32, cameras=RING)
        np.testing.assert_array_equal(views, zipped.source.views(other, size=32, cameras=RING))
        widths = (views < 255).sum(axis=2)
        if one.category == "cone":
            assert (widths[:, 8] < widths[:, 16]).all()
            assert (widths[:, 16] < widths[:, 24]).all()
    assert world_settings("modelnet", {"path": str(archive)}).made_by() == "modelnet-points"


def test_what_is_wrong_with_a_release_is_said(release):
    def said(*words):
        with pytest.raises(DataError) as error:
            opened(release.parent)
        for word in words:
            assert word in str(error.value), error.value

    spare = release / "more.h5"
    spare.write_bytes(b"")
    said("more.h5", "would be overlooked")
    spare.unlink()
    file = release / "ply_data_test0.h5"
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    said("ply_data_test0.h5", "not read as HDF5")
    file.unlink()
    said("test_files.txt", "which is not there")
    file.write_bytes(whole)
    (release / "shape_names.txt").write_text("plate\n")
    said("labels from 0 to 1")
    (release / "shape_names.txt").write_text("plate\ncone\n")
    (release / "ply_data_train_1_id2file.json").write_text("[1]")
    said("no list of the 6 names")


def test_real_point_clouds_are_read_and_drawn():
    file = Path(__file__).parents[3].parent / "shared/data/modelnet40_points/mn40_f16.npz"
    if not file.exists():
        pytest.skip(f"{file} is not here: ModelNet40's points are not part of the project")
    with np.load(file) as data:
        for points in data["points"][::2000]:
            views = render_views(
                disc_mesh(decode_points(npy(points), "a.npy").positions),
                size=32,
                cameras=[(0, 30)],
            )
            assert (views < 255).mean() > 0.02
