"""Whatever bytes stand in a mesh file, it is read or refused in one sentence, in little time and memory."""

from __future__ import annotations

import json
import struct
import tracemalloc

import numpy as np
import pytest

from activelsd.envs.modelnet.readers import decode_mesh
from activelsd.errors import DataError
from tests.envs.modelnet import mesh_writers as write

POINTS, POLYGONS = write.stool()
TRIANGLES = write.fans(POLYGONS)
SEEDS = {
    "off": [write.off(POINTS, POLYGONS), write.off(POINTS, POLYGONS, head="NCOFF\n", extra=" 0 0 1 1 2 3 4")],
    "obj": [write.obj(POINTS, POLYGONS), write.obj(POINTS, POLYGONS, corner="{0}/{0}/-1")],
    "ply": [write.ply(POINTS, POLYGONS, form) for form in ("ascii", "binary_big_endian")],
    "stl": [write.stl(POINTS, TRIANGLES), write.stl_text(POINTS, TRIANGLES)],
    "glb": [write.glb(POINTS, TRIANGLES)],
}
PIECES = (
    *(
        b"0",
        b"-1",
        b"1e308",
        b"nan",
        b"inf",
        b"1.#IND",
        b"999999999999",
        b"18446744073709551616",
        b"4294967295",
    ),
    *(
        b"\0",
        b"\xff\xff\xff\xff",
        b"\0\0\x80\x7f",
        b"\n",
        b"\r",
        b"#",
        b"\\\n",
        b"/",
        b'"',
        b"[",
        b"{",
        b"null",
    ),
    *(b"f ", b"v ", b"element ", b"property list ", b"end_header\n", b"solid ", b"endsolid", b"facet"),
)
VALUES = (
    *(None, True, -1, 0, 1, 3, 5, 1.5, 1e308, 10**12, 2**63, float("nan"), "x", "VEC3", "MAT4", 5121, 5126),
    *([], {}, [0], [None], [[1]], [1e300] * 16, ["a"] * 3, {"a": 1}),
)


def mutated(data, rng):
    """The bytes with a few of them changed, left out, said again, or put in."""
    data = bytearray(data)
    for _ in range(rng.choice([1, 2, 8])):
        at, size = rng.integers(len(data) or 1), rng.choice([1, 4, 60])
        piece = PIECES[rng.integers(len(PIECES))]
        change = rng.integers(5)
        if change == 0:
            data[at : at + len(piece)] = piece
        elif change == 1:
            data[at:at] = piece
        elif change == 2:
            del data[at : at + size]
        elif change == 3:
            data[at:at] = data[at : at + size] * 3
        elif rng.random() < 0.3:
            del data[at:]
    return bytes(data)


def mutated_json(value, rng):
    """The same JSON with one value in it changed or left out."""
    if not value or not isinstance(value, dict | list) or rng.random() < 0.15:
        return VALUES[rng.integers(len(VALUES))]
    keys = list(value) if isinstance(value, dict) else range(len(value))
    key = keys[rng.integers(len(keys))]
    pairs = [(k, mutated_json(value[k], rng) if k == key else value[k]) for k in keys]
    if rng.random() < 0.1:
        pairs = [pair for pair in pairs if pair[0] != key]
    return dict(pairs) if isinstance(value, dict) else [one for _, one in pairs]


def is_read_or_refused(data, name):
    try:
        mesh = decode_mesh(data, name)
    except DataError as error:
        message = str(error)
        assert message.startswith((name, "A mesh refers"))
        assert message.endswith(".")
        assert message.isprintable()
        assert len(message) < 300
    else:
        assert np.isfinite(mesh.vertices[mesh.faces]).all()


@pytest.mark.parametrize("ending", SEEDS)
def test_changed_bytes(ending):
    rng = np.random.default_rng(0)
    for i in range(300):
        seeds = SEEDS[ending]
        is_read_or_refused(mutated(seeds[i % len(seeds)], rng), f"a.{ending}")


def test_changed_json():
    rng = np.random.default_rng(0)
    gltf = write.Gltf()
    part = gltf.primitive(POINTS, TRIANGLES)
    part["targets"] = [{"POSITION": part["attributes"]["POSITION"]}]
    part["attributes"]["JOINTS_0"] = gltf.accessor(np.zeros((len(POINTS), 4), "u1"))
    part["attributes"]["WEIGHTS_0"] = gltf.accessor(np.ones((len(POINTS), 4), "<f4"))
    gltf.shown(part, skin=0, weights=[0.5], rotation=[0, 0, 0, 1], scale=[1, 2, 1])
    gltf.json["skins"] = [{"joints": [0]}]
    whole = gltf.binary()
    length = struct.unpack_from("<I", whole, 12)[0]
    document, rest = json.loads(whole[20 : 20 + length]), whole[20 + length :]
    for _ in range(500):
        text = json.dumps(mutated_json(document, rng)).encode()
        head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
        is_read_or_refused(head + text + rest, "a.glb")


MANY = 10**12
PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\n"
    + "".join(f"property float {axis}\n" for axis in "xyz")
    + "{}end_header\n"
)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.off", b"OFF\n%d %d 0\n0 0 0\n" % (MANY, MANY)),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n%d 0 1 2\n" % MANY),
        ("a.ply", PLY.format("ascii", MANY, "").encode()),
        ("a.ply", PLY.format("binary_little_endian", MANY, "").encode() + bytes(99)),
        ("a.ply", PLY.format("binary_little_endian", 3, f"element f {MANY}\n").encode() + bytes(36)),
        ("a.stl", bytes(80) + b"\xff\xff\xff\x7f" + bytes(range(50))),
        ("a.obj", b"v 0 0 0\nf" + b" 1" * 50_000),
        ("a.obj", b"v\n" * 50_000),
        ("a.gltf", b"[" * 100_000),
    ],
)
def test_memory_is_bounded_by_the_size_of_the_file(name, data):
    decode_mesh(SEEDS["obj"][0], "a.obj")  # what is imported is not counted
    tracemalloc.start()
    try:
        is_read_or_refused(data, name)
        assert tracemalloc.get_traced_memory()[1] < 200 * len(data) + 1_000_000
    finally:
        tracemalloc.stop()
