"""Meshes from files: every quirk of ModelNet's OFF, and a sentence for every way a file can be broken."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from activelsd.envs.modelnet.files import Folder
from activelsd.envs.modelnet.readers import check_format, decode_mesh, read_mesh
from activelsd.errors import DataError

FURNITURE = Path(__file__).parents[4] / "shared/data/furniture"
TRIANGLE = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"

coordinates = st.floats(-1e4, 1e4, width=32)


@st.composite
def off_files(draw):
    """(text of an OFF file with random quirks, the vertices and polygons it stands for)."""
    vertices = draw(st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=3, max_size=9))
    index = st.integers(0, len(vertices) - 1)
    sides = draw(st.sampled_from([(3, 3), (3, 6), (4, 4), (1, 5)]))
    faces = draw(st.lists(st.lists(index, min_size=sides[0], max_size=sides[1]), min_size=1, max_size=9))
    faces.append(draw(st.lists(index, min_size=3, max_size=3)))  # so that something has an area
    kind, per_vertex = draw(st.sampled_from([("", ""), ("C", " 0.5 0 1 1"), ("N", " 0 0 1"), ("", " 1 2 3")]))
    colours = st.sampled_from(["", " 255 0 0", " 0.1 0.2 0.3 1.0", " 7"])
    colour = draw(st.one_of(colours.map(lambda c: [c] * len(faces)), st.lists(colours, min_size=len(faces))))
    if per_vertex:
        # a plain file's numbers are told apart by count; an odd one out keeps this one from passing for it
        colour[0] = " 255 0 0"
    counts = f"{len(vertices)} {len(faces)}{draw(st.sampled_from(['', ' 0', ' 12']))}"
    lines = [
        kind + "OFF" + draw(st.sampled_from(["", " ", "\n", "\n\n", "\n# by hand\n", " # x\n"])) + counts
    ]
    lines += [" ".join(map(repr, xyz)) + per_vertex for xyz in vertices]
    lines += [f"{len(f)} " + "  ".join(map(str, f)) + colour[i % len(colour)] for i, f in enumerate(faces)]
    for at in draw(st.lists(st.integers(1, len(lines)), max_size=3)):
        lines.insert(at, draw(st.sampled_from(["", "   ", "# 3 0 1 2", "\t"])))
    end = draw(st.sampled_from(["\n", "\r\n", " \n", "\t\r\n"]))
    text = end.join(lines) + draw(st.sampled_from(["", end, end * 3]))
    return text, np.array(vertices, np.float32), faces


@given(off_files())
def test_whatever_the_quirks_the_mesh_is_the_same(file):
    text, vertices, polygons = file
    mesh = decode_mesh(text.encode(), "a.off")
    used = vertices[sorted({i for polygon in polygons for i in polygon})].astype(float)
    low, high = used.min(0), used.max(0)
    centre = (low + high) / 2 if np.abs(used).max() > 64 * (high - low).max() else 0.0
    np.testing.assert_array_equal(mesh.vertices, (vertices - centre).astype(np.float32))
    owners = [polygon for polygon in polygons for _ in polygon[2:]]
    for triangle, owner in zip(mesh.faces.tolist(), owners, strict=True):
        assert triangle == owner if len(owner) == 3 else set(triangle) <= set(owner)
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float32, np.int32)


def test_counts_glued_to_the_keyword_and_unused_vertices_and_repeated_faces():
    text = "OFF4 3 0\n0 0 0\n1 0 0\n0 1 0\n9e3 9e3 9e3\n3 0 1 2\n3 0 1 2\n3 1 1 1\n"
    mesh = decode_mesh(text.encode(), "a.off")
    assert mesh.vertices.shape == (4, 3)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [1, 1, 1]]


@given(off_files(), st.data())
def test_a_file_cut_anywhere_is_read_whole_or_refused(file, data):
    text, _, polygons = file
    cut = text[: data.draw(st.integers(0, len(text)))]
    with suppress(DataError):
        assert len(decode_mesh(cut.encode(), "a.off").faces) == sum(len(p[2:]) for p in polygons)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("ply\nformat ascii 1.0\n", "is a PLY mesh under the ending .off"),
        ("OFFICE\n3 1 0\n", "does not begin with OFF"),
        ("OFF BINARY\n\0\0", "is a binary"),
        ("4OFF\n3 1 0\n", "is an OFF of four or more dimensions"),
        ("nOFF\n3 1 0\n", "is an OFF of four or more dimensions"),
        ("1.5 3\n", "does not begin with OFF"),
        (TRIANGLE + "3 0 1 2\n3 0 2 1\n", "goes on after the 3 vertices and 1 faces"),
        ("OFF\nthree one\n", "no counts of vertices and faces"),
        ("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "has no faces"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "has no faces"),
        ("OFF\n3514 3546 0\n0 0 0\n1 0 0\n", "ends after 2 of 3514 vertices; copy it again"),
        ("OFF\n3514 3546 0\n", "ends after 0 of 3514 vertices; copy it again"),
        ("OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1", "ends after 1 of 2 faces; copy it again"),
        (
            TRIANGLE.replace("3 0 1 2", "3 0 1 3"),
            "a face of vertex 3, but its 3 vertices are numbered from 0",
        ),
        (TRIANGLE.replace("3 0 1 2", "3 0 1 -1"), "a face of vertex -1"),
        (TRIANGLE.replace("3 0 1 2", "3 0 1 1.5"), "a face of vertex 1.5"),
        (TRIANGLE.replace("3 0 1 2", "-3 0 1 2"), "a face of -3 corners"),
        (TRIANGLE.replace("3 0 1 2", "nan 0 1 2"), "a face of nan corners"),
        (TRIANGLE.replace("1 0 0", "1 nan 0"), "vertex, number 1, that is not finite"),
        (TRIANGLE.replace("1 0 0", "1 1e60 0"), "vertex, number 1, that is not finite"),
        (TRIANGLE.replace("1 0 0", "1,5 0 0"), "has '1,5 0 0' where numbers belong"),
    ],
)
def test_a_broken_file_is_named_with_what_is_wrong(text, says):
    with pytest.raises(DataError, match="chair_0001") as caught:
        decode_mesh(text.encode(), "ModelNet40/chair_0001.off")
    assert says in str(caught.value)
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match=r"gone\.off cannot be read \(No such file"):
        read_mesh(Folder(tmp_path), "gone.off")


def test_a_hundred_thousand_faces_in_an_instant():
    n = 50_000
    rng = np.random.default_rng(0)
    vertices = "\n".join(" ".join(f"{x:.4f}" for x in row) for row in rng.normal(size=(n, 3)))
    faces = "\n".join(f"3 {a} {b} {c}" for a, b, c in rng.integers(n, size=(2 * n, 3)))
    data = f"OFF{n} {2 * n} 0\n{vertices}\n{faces}\n".encode()
    start = time.process_time()
    mesh = decode_mesh(data, "a.off")
    assert time.process_time() - start < 1.0  # 0.15 s where nothing else runs
    assert mesh.faces.shape == (2 * n, 3)


def test_a_format_nothing_reads_is_refused_before_reading():
    check_format(".off", "a.off")
    check_format(".ply", "a.ply")
    with pytest.raises(
        DataError, match=r"a\.blend is in no format that can be read here \(OFF, .*\); convert it"
    ):
        check_format(".blend", "a.blend")


@pytest.mark.skipif(not FURNITURE.is_dir(), reason="the folder of real furniture meshes is not there")
def test_every_real_mesh_is_read():
    paths = sorted(FURNITURE.glob("*/*/*.off"))
    assert len(paths) == 333
    for path in paths:
        counts = path.read_bytes()[:40].split()[1:]
        mesh = decode_mesh(path.read_bytes(), path.name)
        assert len(mesh.vertices) == int(counts[0])
        assert len(mesh.faces) == int(counts[1])
