"""Where objects come from: every kind of dataset, and a sentence for all that can be wrong with one."""

from __future__ import annotations

import json
import os
import zipfile

import cv2
import numpy as np
import pytest

from activelsd.envs.modelnet.cameras import Rings
from activelsd.envs.modelnet.sources import MeshFiles, PictureFiles, Shapes, source_from
from activelsd.envs.world import world_settings
from activelsd.errors import ConfigError, DataError
from tests.graphs import opened

CLASSES = ("bowl", "cup")


def off(seed):
    """A tetrahedron, glued header and all."""
    points = np.random.default_rng(seed).normal(size=(4, 3)).tolist()
    rows = ["OFF4 4 0", *(" ".join(map(str, p)) for p in points)]
    return "\n".join([*rows, "3 0 1 2", "3 0 1 3", "3 0 2 3", "3 1 2 3"]) + "\n"


def lay_out(root, files):
    for i, name in enumerate(files):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(off(i))
    return root


def zip_of(folder, path, prefix=""):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            archive.write(file, prefix + file.relative_to(folder).as_posix())
            if file.is_file():
                archive.writestr(f"__MACOSX/{prefix}{file.relative_to(folder).parent}/._{file.name}", b"junk")
    return path


@pytest.fixture
def meshes(tmp_path):
    counts = {"train": 4, "test": 2}
    return lay_out(
        tmp_path / "Some Net",
        [f"{c}/{s}/{c}_{s}_{i}.off" for c in CLASSES for s, n in counts.items() for i in range(n)],
    )


def draw_views(root, name, category="cup", numbers=range(1, 13), size=24, form="{name}_{i:03d}.png"):
    for folder in ("train", "test"):
        (root / category / folder).mkdir(parents=True, exist_ok=True)
        for i in numbers:
            picture = np.full((size, size), 10 * i, np.uint8)
            cv2.imwrite(str(root / category / folder / form.format(name=f"{name}_{folder}", i=i)), picture)
    return root


def look(dataset, i=0, size=16):
    return dataset.source.views(dataset.items[i], size=size, cameras=Rings.even(12, [30.0]).cameras)


def test_a_folder_of_meshes(meshes):
    (meshes / "README.txt").write_text("about")
    (meshes / ".DS_Store").write_text("")
    (meshes / "cup/train/._cup_0.off").write_text("")
    (meshes / "cup/train/notes.md").write_text("")
    dataset = opened(meshes)
    assert dataset.classes == CLASSES
    assert [(i.name, i.split) for i in dataset.items if i.category == "cup"] == [
        ("cup/cup_train_0", "train"),
        ("cup/cup_train_1", "val"),
        ("cup/cup_train_2", "train"),
        ("cup/cup_train_3", "train"),
        ("cup/cup_test_0", "test"),
        ("cup/cup_test_1", "test"),
    ]
    assert look(dataset).shape == (12, 16, 16)


@pytest.mark.parametrize("prefix", ["", "ModelNet40/"])
def test_its_zip_is_the_same_to_the_byte(meshes, tmp_path, prefix):
    folder, zipped = opened(meshes), opened(zip_of(meshes, tmp_path / "a.zip", prefix))
    assert [(i.name, i.category, i.split) for i in zipped.items] == [
        (i.name, i.category, i.split) for i in folder.items
    ]
    for i in range(len(folder.items)):
        np.testing.assert_array_equal(look(zipped, i), look(folder, i))


def test_objects_of_one_name_are_told_apart_by_their_files(tmp_path):
    files = ["cup/train/1.off", "cup/train/2.off", "cup/test/1.off"]
    dataset = opened(lay_out(tmp_path, files))
    assert [i.name for i in dataset.items] == ["cup/2", "cup/train/1.off", "cup/test/1.off"]


def test_split_rules_choose_objects(tmp_path):
    root = lay_out(tmp_path, [f"cup/{s}/{i:03d}{s}.off" for s in ("train", "test") for i in range(90)])
    counts = {s: len(opened(root, split=s).items) for s in ("official", "mvcnn", "lsdnet")}
    assert counts == {"official": 180, "mvcnn": 100, "lsdnet": 98}


def test_classes_asked_for(meshes):
    assert opened(meshes, classes=["cup"]).classes == ("cup",)
    with pytest.raises(ConfigError, match=r"no class 'bowel' in .*; did you mean bowl"):
        opened(meshes, classes=["cup", "bowel"])
    with pytest.raises(ConfigError, match="no class 'ziggurat' in the embedded shapes; there are bench, "):
        opened(None, classes=["ziggurat"])


def test_embedded_shapes_are_apart_and_stay_when_more_are_asked_for():
    few = opened(None, train_per_class=3, test_per_class=1, classes=["cup", "vase"])
    more = opened(None, train_per_class=5, test_per_class=2, classes=["bench", "cup", "vase"])
    views = {item.name: look(more, i) for i, item in enumerate(more.items)}
    for i, item in enumerate(few.items):
        np.testing.assert_array_equal(look(few, i), views[item.name])
    assert len({v.tobytes() for v in views.values()}) == len(views) == 21
    other = opened(None, seed=1, train_per_class=1, test_per_class=1, classes=["cup"])
    assert look(other).tobytes() not in {v.tobytes() for v in views.values()}
    with pytest.raises(DataError, match="Class 'cup' of the embedded shapes has no test objects"):
        opened(None, test_per_class=0, classes=["cup"])


def test_a_source_survives_json(meshes, tmp_path):
    pictures = draw_views(tmp_path / "views", "c")
    sources = [opened(p).source for p in (meshes, pictures)] + [Shapes(seed=3)]
    assert [type(s) for s in sources] == [MeshFiles, PictureFiles, Shapes]
    for source in sources:
        assert source_from(json.loads(json.dumps(source.spec()))) == source


def identity(*arguments, **options):
    """All of a dataset but its splits."""
    dataset = opened(*arguments, **options)
    return json.dumps([dict(dataset.origin), [(i.name, i.parts, i.stamp) for i in dataset.items]])


def test_what_a_dataset_is_changes_with_the_data(meshes, tmp_path):
    found = [identity(meshes)]
    assert identity(meshes) == identity(meshes, split="mvcnn") == found[0]
    found.append(identity(meshes, classes=["cup"]))
    found.append(identity(zip_of(meshes, tmp_path / "a.zip")))
    path = meshes / "cup/test/cup_test_1.off"
    os.utime(path, ns=(1, 1))
    found.append(identity(meshes))
    path.write_text(off(77))
    found.append(identity(meshes))
    found.append(identity(zip_of(meshes, tmp_path / "a.zip")))
    path.rename(path.with_name("other.off"))
    found.append(identity(meshes))
    found += [identity(None, seed=s, train_per_class=n) for s, n in ((0, 2), (1, 2), (0, 3))]
    assert len(set(found)) == len(found)


@pytest.mark.parametrize(
    ("form", "numbers"),
    [
        ("{name}_000000001_{i:03d}.jpg", range(1, 13)),
        ("{name}_0001.obj.shaded_v{i:03d}.png", range(1, 13)),
        ("{name}_0001_v{i:04d}.png", range(12)),
        ("{name}_{i}.PNG", range(1, 13)),
    ],
)
def test_pictures_by_others_in_the_order_of_their_numbers(tmp_path, form, numbers):
    root = draw_views(tmp_path, "cup", numbers=numbers, form=form)
    dataset = opened(root)
    assert [i.split for i in dataset.items] == ["train", "test"]
    assert dataset.items[0].name.startswith("cup/cup_train")
    views = look(dataset)
    assert views.shape == (12, 16, 16)
    np.testing.assert_allclose(views.mean((1, 2)), [10 * i for i in numbers], atol=1)


def test_pictures_of_any_colour_depth(tmp_path):
    root = draw_views(tmp_path, "a")
    clear, deep, colour = (root / f"cup/train/a_train_{i:03d}.png" for i in (1, 2, 3))
    cv2.imwrite(str(clear), np.zeros((24, 24, 4), np.uint8))
    cv2.imwrite(str(deep), np.full((24, 24), 0x8000, np.uint16))
    cv2.imwrite(str(colour), np.full((24, 24, 3), (255, 0, 0), np.uint8))
    assert look(opened(root))[:3].mean((1, 2)).tolist() == [255, 128, 29]


def test_pictures_in_colour(tmp_path):
    root = draw_views(tmp_path / "data", "a")
    red, clear, gray = (root / f"cup/train/a_train_{i:03d}.png" for i in (1, 2, 3))
    cv2.imwrite(str(red), np.full((24, 24, 3), (10, 20, 200), np.uint8))
    cv2.imwrite(str(clear), np.full((24, 24, 4), (0, 0, 255, 0), np.uint8))
    cv2.imwrite(str(gray), np.full((24, 24), 77, np.uint8))
    cache = tmp_path / "cache"
    colour, plain = (
        world_settings("modelnet", {"path": root, "size": 32, "cache": cache, "colour": c}).open()
        for c in ("rgb", "gray")
    )
    assert colour.frames[:3, :, 0, 0].tolist() == [[200, 20, 10], [255] * 3, [77] * 3]
    assert plain.frames[:3, 0, 0].tolist() == [73, 255, 77]


def test_pictures_that_do_not_fit(tmp_path):
    root = draw_views(tmp_path / "a", "a")
    (root / "cup/train/a_train_007.png").unlink()
    with pytest.raises(
        DataError, match=r"'a_train' in .*/cup/train has views 1 to 12 but lacks view 7; add it"
    ):
        opened(root)
    root = draw_views(tmp_path / "c", "c")
    (root / "cup/train/c_train_v3.jpg").write_bytes(b"")
    with pytest.raises(DataError, match=r"'c_train' in .* has view 3 twice"):
        opened(root)
    root = draw_views(tmp_path / "d", "d")
    (root / "cup/train/front.png").write_bytes(b"")
    with pytest.raises(DataError, match=r"front\.png should end in a view's number"):
        opened(root)


@pytest.mark.parametrize("ending", ["png", "jpg", "webp", "bmp", "tif"])
def test_a_picture_that_is_none(tmp_path, ending):
    root = draw_views(tmp_path, "a", form="{name}_{i:03d}." + ending)
    path = root / f"cup/train/a_train_002.{ending}"
    whole = path.read_bytes()
    for data in (b"", b"no picture", whole[: len(whole) // 2], whole[:-8]):
        path.write_bytes(data)
        with pytest.raises(DataError, match=rf"a_train_002\.{ending} is not a whole picture; copy it again"):
            look(opened(root))
    path.write_bytes(b"GIF89a")
    with pytest.raises(
        DataError, match=rf"2\.{ending} is in GIF's format, which is not read; convert it to PNG"
    ):
        look(opened(root))
    cv2.imwrite(str(path), np.zeros((24, 32), np.uint8))
    with pytest.raises(DataError, match=r"is 32 x 24 pixels, but views are square"):
        look(opened(root))


def test_a_picture_is_read_by_what_it_is_and_not_by_its_name(tmp_path):
    """As another format than its ending says, and with bytes after its end, as motion photographs have."""
    root = draw_views(tmp_path, "a", form="{name}_{i:03d}.jpg")
    plain = look(opened(root))
    for i, ending in enumerate((".jpg", ".webp", ".png", ".tif", ".bmp"), 1):
        path = root / f"cup/train/a_train_{i:03d}.jpg"
        path.write_bytes(
            cv2.imencode(ending, cv2.imread(str(path), -1))[1].tobytes() + b"\xff\xd8 film" * 300
        )
    np.testing.assert_allclose(look(opened(root)).astype(int), plain, atol=1)


def test_paths_with_nothing_to_read(tmp_path):
    def says(path, text):
        with pytest.raises(DataError, match=text) as caught:
            opened(path)
        assert str(caught.value).count(". ") == 0

    says(tmp_path / "gone", "There is no dataset at .*/gone; check env.dataset.path")
    (tmp_path / "note.txt").write_text("hello")
    says(tmp_path / "note.txt", "is neither a folder nor a zip")
    (tmp_path / "a.zip").write_bytes(b"PK\3\4 cut short")
    says(tmp_path / "a.zip", "is not a whole zip; download it again")
    empty = tmp_path / "empty"
    empty.mkdir()
    says(empty, "empty is empty; objects are looked for in .*/CLASS/train and .*/CLASS/test")
    lay_out(tmp_path / "flat", ["cup_1.off"])
    says(tmp_path / "flat", "has no class folders; objects are looked for")
    lay_out(tmp_path / "inner", ["train/cup_1.off", "test/cup_2.off"])
    says(
        tmp_path / "inner", "has no class folders, as its train and test hold files themselves; if it is one"
    )
    says(tmp_path / "inner" / "train", "is the folder of one split; give the folder that holds all")
    lay_out(tmp_path / "bare", ["cup/cup_1.off", "bowl/cup_2.off"])
    says(tmp_path / "bare", "has folders, but none of them is called train or test; objects are looked for")
    lay_out(tmp_path / "half", ["train/cup/1.off", "train/bowl/2.off"])
    says(tmp_path / "half", "has only train/; objects are looked for in .*/CLASS/train and")
    lay_out(tmp_path / "apart", ["train/cup/1.off", "test/bowl/2.off"])
    says(tmp_path / "apart", "has no class both in train and in test; objects")


def test_an_object_that_would_be_overlooked(tmp_path):
    both = ["cup/train/1.off", "cup/test/2.off"]
    with pytest.raises(DataError, match=r"Class folders stand both in .*/a and in .*/b; give one"):
        opened(lay_out(tmp_path / "two", [f"{top}/{f}" for top in "ab" for f in both]))
    for stray in ("cup/3.off", "cup/more/3.off", "cup/more/much/3.off", "3.off"):
        root = lay_out(tmp_path / stray.replace("/", "_"), [*both, stray])
        with pytest.raises(DataError, match=f"/{stray} would be overlooked"):
            opened(root)
    root = lay_out(tmp_path / "first", ["train/cup/1.off", "test/cup/2.off", "train/3.off"])
    with pytest.raises(
        DataError, match=r"train/3\.off would be overlooked, as objects stand in train/CLASS of"
    ):
        opened(root)
    root = lay_out(tmp_path / "bare", [*both, "bowl/1.off"])
    with pytest.raises(DataError, match=r"bowl/1\.off would be overlooked"):
        opened(root)
    assert len(opened(root, classes=["cup"]).items) == 2


def test_classes_with_nothing_to_train_or_test_on(meshes):
    (meshes / "lamp").mkdir()
    with pytest.raises(DataError, match=r"Class 'lamp' of .* has no train objects; add some or leave"):
        opened(meshes)
    lay_out(meshes, ["lamp/train/1.off"])
    with pytest.raises(DataError, match=r"Class 'lamp' of .* has no test objects"):
        opened(meshes)
    lay_out(meshes, ["lamp/test/2.off"])
    with pytest.raises(DataError, match=r"Split 'lsdnet' leaves class 'lamp' of .* no train objects"):
        opened(meshes, split="lsdnet")


def test_kinds_side_by_side_and_formats_nothing_reads(meshes):
    stray = meshes / "cup/train/wood.png"
    stray.write_bytes(b"")
    with pytest.raises(
        DataError, match=r"holds meshes \(.*\.off\) and pictures \(.*wood\.png\) side by side"
    ):
        opened(meshes)
    stray.rename(stray.with_suffix(".blend"))
    with pytest.raises(DataError, match=r"wood\.blend is in no format that can be read here"):
        opened(meshes)


def test_broken_meshes_are_named_wherever_they_lie(meshes, tmp_path):
    bad = meshes / "cup/test/cup_test_1.off"
    bad.write_text("OFF3514 3546 0\n0 0 0\n")
    for path in (meshes, zip_of(meshes, tmp_path / "a.zip", "top/")):
        dataset = opened(path)
        with pytest.raises(DataError, match=r"cup/test/cup_test_1\.off ends after 1 of 3514 vertices"):
            look(dataset, len(dataset.items) - 1)
    bad.write_text("OFF\n3 1 0\n1 1 1\n1 1 1\n1 1 1\n3 0 1 2\n")
    with pytest.raises(DataError, match=r"cup_test_1\.off cannot be rendered: the mesh has no extent"):
        look(opened(meshes), -1)


def test_a_damaged_zip_names_the_member(meshes, tmp_path):
    path = zip_of(meshes, tmp_path / "a.zip")
    with zipfile.ZipFile(path) as archive:
        offset = archive.getinfo("bowl/train/bowl_train_0.off").header_offset
    data = bytearray(path.read_bytes())
    data[offset + 80 : offset + 100] = bytes(20)
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"a\.zip/bowl/train/bowl_train_0\.off is damaged inside the zip"):
        look(opened(path))


SAME = ["cup/cup_a", "cup/cup_b", "cup/cup_c", "cup/cup_d"]


@pytest.mark.parametrize(
    "form",
    [
        "{category}/{split}/{name}.off",
        "{split}/{category}/{name}.off",
        "Net/{split}/{category}/{name}.off",
        "{category}/{split}/{name}/model.off",
        "{split}/{category}/{name}/models/model_normalized.off",
        "{category}/{Split}/{name}.off",
        "{split}ing/{category}/{name}.off",
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_layouts(tmp_path, form, packed):
    rows = [(c, s, n) for c in CLASSES for s, names in (("train", "abc"), ("test", "d")) for n in names]
    files = [form.format(category=c, split=s, Split=s.title(), name=f"{c}_{n}") for c, s, n in rows]
    root = lay_out(tmp_path / "net", files)
    dataset = opened(zip_of(root, tmp_path / "net.zip") if packed else root)
    assert dataset.classes == CLASSES
    assert [i.name for i in dataset.items if i.category == "cup"] == SAME
    assert [i.split for i in dataset.items] == ["train", "val", "train", "test"] * 2


def test_a_class_called_train_is_a_class(tmp_path):
    for i, form in enumerate(("{c}/{s}/{n}.off", "{s}/{c}/{n}.off")):
        files = [form.format(c=c, s=s, n=s) for c in ("bus", "train") for s in ("train", "test")]
        assert opened(lay_out(tmp_path / str(i), files)).classes == ("bus", "train")


@pytest.mark.parametrize("form", ["{c}/{s}/{n}.off", "{s}/{c}/{n}.off"])
@pytest.mark.parametrize("val", ["val", "valid", "Validation"])
def test_a_val_folder_is_the_validation_split(tmp_path, form, val):
    rows = [("train", 12), (val, 2), ("test", 2)]
    root = lay_out(tmp_path, [form.format(c="cup", s=s, n=f"{s}{i}") for s, n in rows for i in range(n)])
    for split, less in (("official", 0), ("lsdnet", 1)):
        found = [item.split for item in opened(root, split=split).items]
        assert found == ["train"] * (12 - less) + ["val"] * 2 + ["test"] * (2 - less)


def test_pictures_in_a_folder_of_their_object(tmp_path):
    root = draw_views(tmp_path / "flat", "a")
    for path in sorted(root.rglob("*.png")):
        stem, _, number = path.stem.rpartition("_")
        for to in (f"one/{{}}/{stem}/{number}.png", f"two/{{}}/{stem}/rendering/view-{number}.png"):
            to = tmp_path / to.format(path.parent.relative_to(root).as_posix())
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(path.read_bytes())
    for name in ("one", "two"):
        dataset = opened(tmp_path / name)
        assert [i.name for i in dataset.items] == ["cup/a_train", "cup/a_test"]
        np.testing.assert_array_equal(look(dataset), look(opened(root)))
    extra = tmp_path / "two/cup/train/a_train/mask-001.png"
    extra.write_bytes(b"")
    with pytest.raises(
        DataError, match=r"two/cup/train/a_train holds pictures of two series, mask-001\.png and"
    ):
        opened(tmp_path / "two")
    lay_out(tmp_path / "three", ["cup/train/a/1.off", "cup/train/a/2.off", "cup/test/b/1.off"])
    with pytest.raises(DataError, match=r"a/1\.off and 2\.off are in the folder of one object"):
        opened(tmp_path / "three")


def sided(root, names, category="cup"):
    """A set in which the object's pictures are called so, each of its own gray."""
    for split in ("train", "test"):
        for i, name in enumerate(names):
            path = root / category / split / f"{split}_{name}"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.full((16, 16), 3 * i, np.uint8))
    return root


@pytest.mark.parametrize(
    "names",
    [
        *[[f"a_{i + first:03d}.png" for i in range(n)] for n, first in ((6, 0), (8, 1), (36, 1), (80, 0))],
        [f"obj3__{5 * i}.png" for i in range(72)],
        [f"9_r{45 * i}.png" for i in range(8)],
        [f"a.obj.shaded_v{i + 1:03d}.png" for i in range(20)],
        [f"a/{i}.png" for i in range(16)],
        [f"a/IMG_{i + 2031}.png" for i in range(8)],
        [f"a/photo ({i + 1}).png" for i in range(11)],
        [f"a/{i:03d}_rgb_2.png" for i in range(10)],
        [f"a/view{i}/scan.png" for i in range(6)],
        [f"a/{d}.png" for d in (0, 22, 45, 67, 90, 112, 135, 157, 180, 202, 225, 247, 270, 292, 315, 337)],
        ["a/only1.png"],
    ],
)
def test_any_number_of_pictures_in_their_natural_order(tmp_path, names):
    (item, _) = opened(sided(tmp_path, names)).items
    assert list(item.parts) == [f"cup/train/train_{name}" for name in names]
    assert item.rings == ()


@pytest.mark.parametrize("folder", ["a/", "a_", "a/b-"])
def test_names_tell_elevation_and_azimuth(tmp_path, folder):
    low = [f"{folder}e-10_a{22.5 * i:g}.png" for i in range(16)]
    high = [f"{folder}e30.5_a{45 * i + 10:03d}.png" for i in range(8)]
    (item, _) = opened(sided(tmp_path, low + high)).items
    assert list(item.parts) == [f"cup/train/train_{name}" for name in low + high]
    assert [(ring.elevation, len(ring.azimuths)) for ring in item.rings] == [(-10, 16), (30.5, 8)]
    assert item.rings[1].azimuths[:2] == (10, 55)


def test_two_numbers_are_a_ring_and_a_place(tmp_path):
    """Angles from the axis as in ETH-80, elevations, and rings that are only counted."""
    sixteen = (0, 22, 45, 68, 90, 112, 135, 158, 180, 202, 225, 248, 270, 292, 315, 338)
    eight = (27, 63, 117, 153, 207, 243, 297, 333)
    from_axis = [f"a/a1-090-{i:03d}.png" for i in sixteen] + [f"a/a1-066-{i:03d}.png" for i in eight]
    (item, _) = opened(sided(tmp_path / "axis", [*from_axis, "a/a1-000-000.png"])).items
    assert list(item.parts) == [f"cup/train/train_{name}" for name in [*from_axis, "a/a1-000-000.png"]]
    assert [(ring.elevation, len(ring.azimuths)) for ring in item.rings] == [(0, 16), (24, 8), (90, 1)]
    low, high = [f"a/10_{i}.png" for i in range(0, 360, 60)], [f"a/40_{i}.png" for i in range(0, 360, 90)]
    (item, _) = opened(sided(tmp_path / "up", high + low)).items
    assert [(ring.elevation, len(ring.azimuths)) for ring in item.rings] == [(10, 6), (40, 4)]
    counted = [f"a/ring{r} view{i}.png" for r in (1, 2) for i in range(1, 7)]
    (item, _) = opened(sided(tmp_path / "counted", counted)).items
    assert [ring.azimuths for ring in item.rings] == [tuple(60.0 * i for i in range(6))] * 2


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ([f"a_{i}.png" for i in (1, 2, 4)], "has views 1 to 4 but lacks view 3; add it or remove"),
        ([f"a_{i}.png" for i in (2, 3, 4)], "has views 2 to 4 but lacks view 1;"),
        ([f"a_{i}.png" for i in range(0, 330, 30)], "has views 0 to 300 but lacks view 330;"),
        ([f"a_{i}.png" for i in range(0, 360, 5) if i != 85], "has views 0 to 355 but lacks view 85;"),
        ([f"a_{i}.png" for i in (2, 4, 6, 8)], "has views 2 to 8 in steps of 2; number them from 1, or"),
        ([f"a/{i}.png" for i in (0, 1, 3)], "has views 0 to 3 but lacks view 2;"),
        (["a/e0_a000.png", "a/e0_a090.png", "a/e0_a270.png"], "of 0 degrees, has views 0 to 270 but lacks"),
        (["a_e0_a000.png", "a_e0_a180.png", "a_001.png"], "tell elevation and azimuth, and others"),
        (["a/066-027.png", "a/066-063.png", "a/090-000.png"], "differ in 2 numbers, as in 090-000.png;"),
        ([f"a/{d}_{i}.png" for d in (20210304, 20210305) for i in (1, 2)], "differ in 2 numbers"),
        (["a/front.png", "a/back.png"], "should have a view's number"),
        (["a/1.png", "a_1.png"], "has a folder 'test_a' and pictures of that name beside it"),
        (["a/1.png", "a/1.jpg"], "test_a has view 1 twice"),
        (
            ["a_0.png", "a_1.png", "a_2.png", "b_1.png", "b_2.png"],
            "'test_b' in .* lacks view 0, which others",
        ),
    ],
)
def test_what_is_missing_or_cannot_be_told_is_refused(tmp_path, names, sentence):
    with pytest.raises(DataError, match=sentence) as caught:
        opened(sided(tmp_path, names))
    assert str(caught.value).count(". ") == 0


def test_objects_of_different_numbers_of_views(tmp_path):
    dataset = opened(sided(tmp_path, [f"a/{i}.png" for i in range(16)] + [f"b_{i}.png" for i in range(1, 9)]))
    assert [len(item.parts) for item in dataset.items] == [16, 8, 16, 8]


COMPANIONS = [
    "Thumbs.db", "thumbs.db", "cup/train/THUMBS.DB", "cup/train/Icon\r", "cup/train/a.off:Zone.Identifier",
    "cup/train/@eaDir/a.off/SYNOFILE.off", "lost+found/x.off", "$RECYCLE.BIN/y.off", "__MACOSX/._a.off",
    ".git/cup/train/z.off", "cup/train/a.off~", "cup/train/LICENSE", "README", "cup/README.md",
    "cup/meta.json", "cup/train/a.mtl", "cup/train/a.bin", "preview.png", "notes/about.txt",
]  # fmt: skip


def test_what_lies_beside_objects_is_passed_over(tmp_path):
    root = lay_out(tmp_path, ["cup/train/a.off", "cup/train/b.off", "cup/test/c.off", *COMPANIONS])
    assert [i.name for i in opened(root, classes=["cup"]).items] == ["cup/a", "cup/b", "cup/c"]


def test_links_that_lead_back_and_pipes(meshes):
    (meshes / "cup/train/back").symlink_to(meshes)
    (meshes / "docs").mkdir()
    (meshes / "docs/about.md").write_text("no class")
    assert opened(meshes).classes == CLASSES
    os.mkfifo(meshes / "cup/train/pipe.off")
    with pytest.raises(DataError, match=r"cup/train/pipe\.off is no file that can be read; remove it"):
        opened(meshes)


def test_textures_of_meshes_that_have_them_are_passed_over(tmp_path):
    textures = ["cup/train/wood.png", "cup/train/textures/oak.JPG", "cup/textures/a.tga", "textures/b.webp"]
    textures += [
        "cup/test/c/images/texture0.jpg",
        "cup/test/c/models/x.mtl",
        "cup/test/c/screenshots/c-1.png",
    ]
    root = lay_out(tmp_path, ["cup/train/a.obj", "cup/train/b.off", "cup/test/c/models/c.obj", *textures])
    assert [i.name for i in opened(root).items] == ["cup/a", "cup/b", "cup/c"]
    lay_out(root, ["cup/train/d/wood.png"])
    with pytest.raises(DataError, match=r"holds meshes .* and pictures \(.*d/wood\.png\) side by side"):
        opened(root)


@pytest.mark.parametrize(
    ("stray", "sentence"),
    [
        ("cup/train/all.zip", "is packed, and what is in it would be overlooked; unpack"),
        ("cup/train/a.off.gz", "is packed"),
        ("cup/train/mug", "has no ending that tells its format; name it by its format or remove it"),
        ("cup/train/a_001.heic", "is a picture in a format that is not read; convert it to PNG"),
    ],
)
def test_files_that_may_hold_objects_are_named(meshes, stray, sentence):
    lay_out(meshes, [stray])
    with pytest.raises(DataError, match=f"{stray} {sentence}"):
        opened(meshes)


def test_all_files_that_may_hold_objects_are_named_at_once(meshes):
    lay_out(meshes, ["cup/train/mug", "cup/glass.off", "jug.off"])
    with pytest.raises(DataError, match=r"3 files of .* are no objects, and might hold some; mend") as caught:
        opened(meshes)
    lines = str(caught.value).splitlines()[1:]
    for line, name in zip(lines, ("cup/glass.off", "cup/train/mug", "jug.off"), strict=True):
        assert line.startswith(f"  {meshes / name} ")


def test_a_folder_of_nothing_but_the_zip(meshes, tmp_path):
    folder = tmp_path / "download"
    folder.mkdir()
    zip_of(meshes, folder / "Net.zip")
    with pytest.raises(
        DataError, match=r"but the archive .*/Net\.zip; give env\.dataset\.path=.*/Net\.zip\."
    ):
        opened(folder)
    (folder / "Net.zip").unlink()
    (folder / "Net.tar.gz").write_bytes(b"\x1f\x8b")
    with pytest.raises(DataError, match=r"but the archive .*/Net\.tar\.gz; unpack it and give the folder"):
        opened(folder)
    with pytest.raises(DataError, match=r"Net\.tar\.gz is not read packed like that; unpack it and give the"):
        opened(folder / "Net.tar.gz")


class _ForeignInfo(zipfile.ZipInfo):
    """An entry whose name is written as the bytes it has in code page 437, without a mark of UTF-8."""

    def _encodeFilenameFlags(self):
        return self.filename.encode("cp437"), 0


def zip_with_names(path, names, encoding):
    with zipfile.ZipFile(path, "w") as archive:
        for i, name in enumerate(names):
            archive.writestr(_ForeignInfo(name.encode(encoding).decode("cp437")), off(i))
    return path


@pytest.mark.parametrize(
    ("encoding", "name"), [("utf-8", "椅子"), ("cp437", "Stühle"), ("gbk", "椅子"), ("utf-8", "Cafe\u0301")]
)
@pytest.mark.parametrize("slash", ["/", "\\"])
def test_zips_made_elsewhere(tmp_path, encoding, name, slash):
    files = [f"{name}{slash}{s}{slash}{name}_{s}.off" for s in ("train", "test")]
    dataset = opened(zip_with_names(tmp_path / "a.zip", files, encoding))
    assert [item.name for item in dataset.items] == [f"{name}/{name}_train", f"{name}/{name}_test"]
    assert look(dataset).shape == (12, 16, 16)


def test_a_zip_in_a_code_page_that_cannot_be_told(tmp_path):
    path = zip_with_names(tmp_path / "a.zip", ["いす/train/a.off", "いす/test/b.off"], "shift-jis")
    with pytest.raises(
        DataError, match=r"a\.zip has names in a code page that cannot be told, such as .*; extract"
    ):
        opened(path)


def test_names_that_are_not_utf8(tmp_path):
    """Latin-1 names of files and classes are read, and can be written into a cache and messages."""
    for i, name in enumerate((b"train/caf\xe9.off", b"test/th\xe9.off")):
        path = os.fsencode(tmp_path) + b"/net/tass\xe9/" + name
        os.makedirs(os.path.dirname(path), exist_ok=True)  # noqa: PTH103, PTH120
        with open(path, "w") as file:  # noqa: PTH123
            file.write(off(i))
    dataset = opened(tmp_path / "net")
    assert [item.name for item in dataset.items] == ["tassé/café", "tassé/thé"]
    assert look(dataset).shape == (12, 16, 16)
    assert dataset.source.files.where(dataset.items[0].parts[0]).endswith("tassé/train/café.off")
