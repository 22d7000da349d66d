"""Exported folders: their names, what they show, going on after an interruption, and reading them back."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from activelsd import cli
from activelsd.envs.modelnet import export as exporting
from activelsd.envs.modelnet.cameras import Dodecahedron, Rings
from activelsd.envs.modelnet.datasets import Dataset
from activelsd.envs.modelnet.export import Form, export
from activelsd.envs.modelnet.prepare import open_views, prepare
from activelsd.errors import DataError
from activelsd.scenery.orbit_renderer import DISTANCE, render_depths
from activelsd.scenery.shapes.solids import cylinder
from tests.graphs import opened

SIZE = 32


def shapes(train: int = 2, test: int = 1) -> Dataset:
    return opened(None, train_per_class=train, test_per_class=test, classes=("cup", "vase"))


def form(layout: str = "mvcnn", views: int = 12, kind: str = "shaded") -> Form:
    return Form(layout=layout, views=views, kind=kind, size=SIZE)


def files(root: Path) -> list[str]:
    return sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())


@pytest.mark.parametrize(
    ("layout", "views", "first", "last"),
    [
        ("mvcnn", 12, "train_00000.obj.shaded_v001.png", "train_00000.obj.shaded_v012.png"),
        ("rotationnet", 20, "train_00000_001.png", "train_00000_020.png"),
    ],
)
def test_an_export_read_back_is_the_same_data_set(layout, views, first, last, tmp_path) -> None:
    """Splits, names, starts and views: to the byte, since the pictures are of the same size."""
    dataset, out = shapes(train=12), tmp_path / "out"
    done = export(dataset, out, form(layout, views))
    assert done == (26, 26 * views, 26 * views)
    names = files(out)
    assert len(names) == 26 * views + 1
    assert {f"cup/train/{first}", f"cup/train/{last}", exporting.MANIFEST} <= set(names)
    rig = Rings.even(12, [30.0]) if views == 12 else Dodecahedron()
    graphs = []
    for one in (dataset, opened(out)):
        file = prepare(one, size=SIZE, rig=rig, cache=tmp_path / "cache")
        graphs.append(open_views(file, one))
    drawn, read = graphs
    assert read.targets == drawn.targets
    assert np.array_equal(read.start_split, drawn.start_split)
    assert np.array_equal(read.frames, drawn.frames)
    assert read.view_names == drawn.view_names


def test_val_folders_stay_and_equal_names_are_told_apart(tmp_path) -> None:
    for i, name in enumerate(("train/1.off", "train/1.obj", "train/2.b.off", "val/3.off", "test/1.off")):
        path = tmp_path / "net/cup" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        corners = [(0, 0, 0), (1, 0, i), (0, 1, 0)]
        path.write_text(
            "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\n"
            if name.endswith("obj")
            else "OFF\n3 1 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in corners) + "3 0 1 2\n"
        )
    dataset, out = opened(tmp_path / "net"), tmp_path / "out"
    export(dataset, out, form("rotationnet"))
    objects = {name.rpartition("_")[0] for name in files(out)} - {""}
    assert objects == {
        f"cup/{name}" for name in ("train/train_1_off", "train/train_1_obj", "train/2.b", "val/3", "test/1")
    }
    assert [item.split for item in opened(out).items].count("val") == 1


def test_depth_is_16_bits_along_the_axis(tmp_path) -> None:
    """A disc's top, seen from straight above, is nearer by its height; what is hit by nothing is 65535."""
    flat = render_depths(cylinder(1.0, 0, 0.5, segments=64), size=64, cameras=[(0, 90), (0, 0)])
    radius = np.hypot(1, 0.25)
    top, side = DISTANCE - 0.25 / radius, DISTANCE - 1 / radius
    for picture, depth in zip(flat, (top, side), strict=True):
        assert abs(int(picture[32, 32]) - (depth - 2) / 2 * 65534) < 65, "within a thousandth"
        assert picture[0, 0] == 65535
    assert np.ptp(flat[0][28:36, 28:36].astype(int)) <= 1, "a plane across the axis has one depth"
    export(shapes(), tmp_path / "out", form(kind="depth"))
    picture = cv2.imread(str(tmp_path / "out/cup/test/test_00000.obj.depth_v001.png"), cv2.IMREAD_UNCHANGED)
    assert (picture.dtype, picture.shape, picture.max()) == (np.uint16, (SIZE, SIZE), 65535)
    assert len(opened(tmp_path / "out").items) == 6


def test_what_is_there_is_kept_and_the_rest_is_made(tmp_path, monkeypatch) -> None:
    dataset, out, written = shapes(), tmp_path / "out", []
    replace = exporting._replace

    def failing(path: Path, data: bytes) -> None:
        if len(written) == 30:
            raise OSError(28, "No space left on device")
        replace(path, data)
        written.append(path)

    with monkeypatch.context() as patch:
        patch.setattr(exporting, "_replace", failing)
        with pytest.raises(DataError, match=r"out cannot be written \(No space left on device\); make room"):
            export(dataset, out, form())
    stamps = {name: (out / name).stat().st_mtime_ns for name in files(out)}
    assert len(stamps) == 30
    cut = out / "cup/train/train_00000.obj.shaded_v003.png"
    cut.write_bytes(cut.read_bytes()[:-7])
    counts: list[tuple[int, int]] = []
    done = export(dataset, out, form(), progress=lambda *now: counts.append(now))
    assert done.written == 72 - 29 + 1
    assert counts == [(1, 6), (2, 6), (3, 6), (4, 6), (5, 6), (6, 6)]
    kept = stamps.keys() - {exporting.MANIFEST, cut.relative_to(out).as_posix()}
    assert all((out / name).stat().st_mtime_ns == stamps[name] for name in kept)
    whole = tmp_path / "whole"
    export(dataset, whole, form())
    assert files(out) == files(whole)
    assert all((out / name).read_bytes() == (whole / name).read_bytes() for name in files(whole))
    assert export(dataset, out, form()).written == 0


def test_objects_that_changed_are_made_anew(tmp_path) -> None:
    mesh = "OFF\n3 1 0\n0 0 0\n1 0 {}\n0 1 0\n3 0 1 2\n"
    for i, name in enumerate(("train/1", "train/2", "test/3")):
        path = tmp_path / f"net/cup/{name}.off"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(mesh.format(i))
    export(opened(tmp_path / "net"), tmp_path / "out", form())
    (tmp_path / "net/cup/train/2.off").write_text(mesh.format("7.5"))
    assert export(opened(tmp_path / "net"), tmp_path / "out", form()) == (3, 36, 12)
    assert export(opened(tmp_path / "net", up="x"), tmp_path / "out", form()) == (3, 36, 36)
    assert export(opened(tmp_path / "net", up="x"), tmp_path / "out", form()) == (3, 36, 0)
    (tmp_path / "net/cup/train/1.off").write_text("OFF\n3 1 0\n0 0")
    with pytest.raises(DataError, match=r"1\.off .*skip_broken"):
        export(opened(tmp_path / "net"), tmp_path / "new", form())
    assert len(files(tmp_path / "new")) == 25, "the others are there"
    assert export(opened(tmp_path / "net"), tmp_path / "new", form(), skip_broken=True) == (2, 24, 0)


def test_folders_of_something_else_are_refused(tmp_path) -> None:
    out = tmp_path / "out"
    export(shapes(), out, form())
    (tmp_path / "other").mkdir()
    (tmp_path / "other/thesis.tex").write_text("")
    (tmp_path / "file").write_text("")
    for folder, how, sentence in (
        (tmp_path / "other", form(), "other holds something that is no export; name a new folder"),
        (tmp_path / "file", form(), "file is a file; name a folder to export to"),
        (out, form(kind="depth"), "out holds an export of kind shaded; name a new folder, or remove"),
        (out, form("rotationnet"), "out holds an export of layout mvcnn;"),
    ):
        with pytest.raises(DataError, match=sentence):
            export(shapes(), folder, how)
    assert files(tmp_path / "other") == ["thesis.tex"]
    with pytest.raises(DataError, match=r"out holds pictures already; export draws meshes"):
        export(opened(out), tmp_path / "again", form())
    assert not (tmp_path / "again").exists()
    (out / exporting.MANIFEST).write_text(json.dumps([]))
    with pytest.raises(DataError, match="holds something that is no export"):
        export(shapes(), out, form())


def test_the_verb(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["env=modelnet", "env.dataset.train_per_class=2", "env.dataset.test_per_class=1"]
    words += ["env.dataset.classes=[cup,vase]", "--size", "32"]
    assert cli.main(["export", *words, "--layout", "rotationnet", "pictures"]) == 0
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        f"120 pictures of 6 objects, 120 of them new, in {tmp_path}/pictures",
        f"Read by: env=modelnet env.dataset.path={tmp_path}/pictures env.cameras=dodecahedron",
    ]
    assert "Exporting objects: 6 of 6" in said.err
    for wrong, sentence in (
        (words, "export needs the one folder to write to, and was given none"),
        ([*words, "a", "b"], "export needs the one folder to write to, and was given a b"),
        ([*words, "a", "--views", "13"], "argument --views: invalid choice: 13"),
        ([*words, "a", "--size", "7"], "--size 7: must be from 32 to 1024."),
        (["env=avd", "a"], "export draws the objects of env=modelnet, not of env=avd."),
        (
            ["env=modelnet", "a", "env.azimuths=8"],
            "export's cameras are those of --views; leave out env.azimuths.",
        ),
    ):
        assert cli.main(["export", *wrong]) == 2
        assert sentence in capsys.readouterr().err
    assert files(tmp_path / "a") == []
