"""Point clouds: every format gives the same points, and what is wrong with a file is one sentence."""

from __future__ import annotations

import io

import numpy as np
import pytest

from activelsd.envs.modelnet.cameras import Rings
from activelsd.envs.modelnet.points import decode_points
from activelsd.envs.world import world_settings
from activelsd.errors import DataError
from tests.graphs import opened

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
    refused(npy(CLOUD.astype("U8")), "a.npy", "<U8")
    for bad in (np.nan, np.inf, 1e300):
        table = CLOUD.astype(np.float64)
        table[7, 1] = bad
        refused(npy(table), "a.npy", "a point, number 7")


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
        views = dataset.source.views(item, size=32, cameras=Rings.even(12, [0.0]).cameras)
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
        dataset.source.views(dataset.items[0], size=32, cameras=Rings.even(12, [0.0]).cameras)
    (clouds / "plate" / "test" / "a.off").write_text("OFF")
    with pytest.raises(DataError, match=r"holds meshes \(.*a.off\) and points \(.*npy\) side by side"):
        opened(clouds)
