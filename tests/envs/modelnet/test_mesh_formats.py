"""Every mesh format gives the same object, and a sentence where a part of it would be lost."""

from __future__ import annotations

import base64
import time
import zipfile

import numpy as np
import pytest

from activelsd.envs.modelnet.files import Folder, Zip
from activelsd.envs.modelnet.mesh_formats import gltf
from activelsd.envs.modelnet.mesh_formats.polygons import triangles
from activelsd.envs.modelnet.mesh_formats.surface import Surface
from activelsd.envs.modelnet.readers import decode_mesh, other_files, read_mesh
from activelsd.errors import ConfigError, DataError
from tests.envs.modelnet import mesh_writers as write
from tests.graphs import opened

POINTS, POLYGONS = write.stool()
WHOLE = decode_mesh(write.off(POINTS, POLYGONS), "a.off")
TRIANGLES = WHOLE.faces


def corners(mesh):
    return mesh.vertices[mesh.faces]


def reads(data, name, **options):
    np.testing.assert_allclose(corners(decode_mesh(data, name, **options)), corners(WHOLE), atol=1e-6)


def refuses(data, name, says):
    with pytest.raises(DataError) as caught:
        decode_mesh(data, name)
    message = str(caught.value)
    assert message.startswith(name)
    assert says in message
    assert message.endswith(".")
    assert "\n" not in message


BOM = b"\xef\xbb\xbf"
ENDS = {"unix": "\n", "windows": "\r\n", "old mac": "\r"}


@pytest.mark.parametrize("end", ENDS.values(), ids=ENDS)
def test_line_ends_marks_tabs_and_comments(end):
    reads(
        BOM + write.off(POINTS, POLYGONS, end=end).replace(b" 0" + end.encode(), b"\t0" + end.encode()),
        "a.off",
    )
    reads(BOM + write.obj(POINTS, POLYGONS, gap="\t", end=end, indent="  \t"), "a.obj")
    reads(write.obj(POINTS, POLYGONS, end=f" # a comment{end}"), "a.obj")
    reads(write.off(POINTS, POLYGONS, end=f" # a comment{end}"), "a.off")
    reads(write.ply(POINTS, POLYGONS, end=end), "a.ply")
    reads(write.stl_text(POINTS, TRIANGLES, end=end), "a.stl")


@pytest.mark.parametrize("kind", ["NC", "CN", "C", "N", "STCN", "ST"])
def test_off_with_normals_colours_and_texture_in_any_order(kind):
    reads(write.off(POINTS, POLYGONS, head=f"{kind}OFF\n", extra=" 0 0 1 255 255 255 255"), "a.off")


def test_off_without_its_word_and_with_values_that_are_no_numbers():
    reads(write.off(POINTS, POLYGONS, head=""), "a.off")
    for nan in ("1.#IND", "-1.#QNAN", "nan", "-nan(ind)", "1.#INF00"):
        points = [*map(tuple, POINTS[:3].astype(object)), (0, nan, 0)]
        rows = "\n".join(" ".join(map(str, p)) for p in points)
        text = f"OFF # by hand\n4 {{}} 0\n{rows}\n3 0 1 2\n".encode()
        assert len(decode_mesh(text.replace(b"{}", b"1"), "a.off").faces) == 1  # no face has that vertex
        refuses(text.replace(b"{}", b"2") + b"3 1 2 3\n", "a.off", "a vertex, number 3, that is not finite")


def test_off_with_its_numbers_in_any_lines():
    head, *rest = write.off(POINTS, POLYGONS).decode().split("\n", 2)
    for counts in ("20\n15\n0", "20 15\n0", "20 15 0"):
        reads(f"{head}\n{counts}\n{rest[1]}".encode(), "a.off")
    reads(f"{head} {rest[0]}\n{' '.join(rest[1].split())}".encode(), "a.off")
    reads(f"{head} {rest[0]}\n{chr(10).join(rest[1].split())}".encode(), "a.off")


def test_obj_in_the_ways_of_many_programs():
    for corner in ("{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "{0}/1/-1", "{0}/"):
        reads(write.obj(POINTS, POLYGONS, corner=corner), "a.obj")
    more = b"mtllib a.mtl\no seat\ng\ns off\nusemtl wood\nvt 0 0\nvn 0 0 1\nl 1 2\np 1\n"
    reads(more + write.obj(POINTS, POLYGONS), "a.obj")
    reads(write.obj(POINTS, POLYGONS, gap=" \\\n  "), "a.obj")
    coloured = [(*p, 1.0, 0.5, 0.5) if i % 2 else (*p, 1.0) for i, p in enumerate(POINTS)]
    reads(write.obj(coloured, POLYGONS), "a.obj")
    reads(write.obj(POINTS, [*POLYGONS, (0, 1)]), "a.obj")  # a line shows nothing


def test_obj_of_blocks_with_indices_that_count_back():
    blocks = [(POINTS[:12], POLYGONS[:8]), (POINTS[12:], [[i - 12 for i in f] for f in POLYGONS[8:14]])]
    rows = []
    for points, polygons in blocks:
        rows += [f"v {x} {y} {z}" for x, y, z in points]
        rows += ["f " + " ".join(f"{i - len(points)}//{i - len(points)}" for i in f) for f in polygons]
    reads("\n".join([*rows, "f 1 2 -14"]).encode() + b"\n", "a.obj")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "a face of vertex 3, but 2 vertices"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 -4\n", "a face of vertex -4, but 3 vertices"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 0 1 2\n", "a face of vertex 0, but OBJ counts from 1"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 x\n", "has '1 2 x' where numbers belong"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2.5 3\n", "a face of vertex 1.5"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nf 1 2", "ends within a face"),
        ("v 0 0 0\nv 1 0\nf 1 2 2\n", "a vertex, number 2, of 2 coordinates"),
        ("v 0 0 0\nv 1 0 0\nl 1 2\n", "has no faces, so there is nothing to see"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nsurf 0 1 0 1 1 2\n", "has free-form surfaces (surf)"),
        ("call other.obj\n", "has parts in other files (call)"),
        ("404: Not Found", "a line '404: Not Found', which is not OBJ"),
        ("o thing\n", "has no vertices and no faces"),
    ],
)
def test_an_obj_that_would_lose_a_part_is_refused(text, says):
    refuses(text.encode(), "a.obj", says)


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("form", FORMS)
def test_ply_of_polygons_of_several_sizes(form):
    for length in ("uchar", "int", "ushort"):
        reads(write.ply(POINTS, POLYGONS, form, length), "a.ply")
    reads(write.ply(POINTS, TRIANGLES.tolist(), form, name="vertex_index", end="\r\n"), "a.ply")
    reads(write.ply(POINTS, POLYGONS, form, faces_first=True, end="\r"), "a.ply")
    lists = write.ply(POINTS, POLYGONS, form)
    for end in range(len(lists) - 40, len(lists), 7):
        refuses(lists[: end - 1], "a.ply", "ends after")
    refuses(write.ply(POINTS, POLYGONS, form).replace(b"face 15", b"face 99999999999"), "a.ply", "ends after")
    refuses(write.ply(POINTS, POLYGONS, form)[:60], "a.ply", "has no whole header")


def test_ply_of_triangle_strips_and_other_elements():
    strips = "4 1 0 2 3 -1"[2:]
    text = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\n"
        "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
        f"0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 {strips} 0 1 2\n0 1\n"
    )
    mesh = decode_mesh(text.encode(), "a.ply")
    assert mesh.faces.tolist() == [[1, 0, 2], [0, 2, 3], [0, 1, 2]]
    refuses(text.encode() + b"9\n", "a.ply", "holds more numbers than its header promises")
    refuses(text.replace("0 1 2\n", "0 1 x\n").encode(), "a.ply", "something else where numbers belong")
    refuses(text.replace("8 1", "-8 1").encode(), "a.ply", "has a list of -8")
    refuses(text.replace("float x", "float u").encode(), "a.ply", "has no vertices with x, y and z")
    refuses(text.replace("vertex_indices", "strip").encode(), "a.ply", "without a list vertex_indices")
    refuses(text.replace("element edge", "element vertex").encode(), "a.ply", "has 'element vertex 1' in its")
    refuses(text.replace("float y", "vec3 y").encode(), "a.ply", "has 'property vec3 y' in its header")


def test_stl_is_counted():
    whole = write.stl(POINTS, TRIANGLES)
    n = len(TRIANGLES)
    for good in (
        whole,
        write.stl(POINTS, TRIANGLES, b"solid by hand"),
        whole + b"\0\0\x01\0",
        whole + bytes(700),
    ):
        reads(good, "a.stl")
    for unknown in (0, 0xFFFFFFFF):
        reads(write.stl(POINTS, TRIANGLES, said=unknown), "a.stl")
    refuses(whole[:-60], "a.stl", f"ends after {n - 2} of {n} triangles")
    refuses(whole[:70], "a.stl", "ends within its header")
    refuses(
        write.stl(POINTS, TRIANGLES, said=n - 3), "a.stl", f"has {n - 3} triangles and holds bytes of {n}"
    )
    refuses(write.stl(POINTS, TRIANGLES[:0]), "a.stl", "has no faces")
    text = write.stl_text(POINTS, TRIANGLES)
    reads(write.stl_text(POINTS, TRIANGLES, word=str.upper), "a.stl")
    halves = write.stl_text(POINTS, TRIANGLES[:5]) + write.stl_text(POINTS, TRIANGLES[5:])
    reads(halves, "a.stl")
    refuses(text[:-12], "a.stl", "before the endsolid")
    refuses(text[: len(text) // 2], "a.stl", "before the endsolid")
    refuses(text.replace(b"  endloop\nendfacet\n", b"", 1), "a.stl", "a facet that is not one of three")
    refuses(text.replace(b"e+00", b"e+oo", 1), "a.stl", "a vertex that is not three numbers")


def test_gltf_is_y_up_and_placed_by_its_nodes():
    reads(write.glb(POINTS, TRIANGLES), "a.glb")
    file = write.Gltf()
    half = np.sqrt(0.5)  # z-up points, turned by a node as Blender does
    file.shown(file.primitive(POINTS, TRIANGLES), rotation=[-half, 0, 0, half])
    reads(file.binary(), "a.glb")
    matrix = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1]
    file = write.Gltf()
    file.shown(file.primitive((write.y_up(POINTS) - [1, 2, 3]) / 2, TRIANGLES))
    file.json["nodes"] = [{"mesh": 0}, {"children": [0], "matrix": matrix}]
    file.json["scenes"] = [{"nodes": [1]}]
    reads(file.binary(), "a.glb")
    file.json["nodes"] = [
        {"mesh": 0, "scale": [2, 2, 2]},
        {"children": [2], "translation": [1, 2, 0]},
        {"children": [0], "translation": [0, 0, 3]},
    ]
    reads(file.binary(), "a.glb")


def test_gltf_in_all_its_ways_to_store_triangles():
    points = write.y_up(POINTS)
    file = write.Gltf()
    first, second = (file.primitive(points, half) for half in (TRIANGLES[:4], TRIANGLES[4:]))
    reads(file.shown(first, second).binary(), "a.glb")

    file = write.Gltf()  # no indices
    flat = {"attributes": {"POSITION": file.accessor(points[TRIANGLES.ravel()].astype("<f4"))}}
    reads(file.shown(flat).binary(), "a.glb")

    file = write.Gltf()  # 16-bit fractions of 4, turned into metres by a node, as gltfpack does
    short = {"POSITION": file.accessor(np.round(points / 4 * 32767).astype("<i2"), normalized=True)}
    packed = file.primitive(points, TRIANGLES) | {"attributes": short}
    file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    mesh = decode_mesh(file.shown(packed, scale=[4, 4, 4]).binary(), "a.glb")
    np.testing.assert_allclose(corners(mesh), corners(WHOLE), atol=2e-4)

    file = write.Gltf()  # sparse
    sparse = file.primitive(np.concatenate([points[:10], points[10:] * 0]), TRIANGLES)
    file.json["accessors"][0]["sparse"] = {
        "count": len(points) - 10,
        "indices": {
            "bufferView": file.view(np.arange(10, len(points)).astype("<u2").tobytes()),
            "componentType": 5123,
        },
        "values": {"bufferView": file.view(points[10:].astype("<f4").tobytes())},
    }
    reads(file.shown(sparse).binary(), "a.glb")

    file = write.Gltf()  # strips and fans
    strip = file.primitive(points, [0, 1, 2, 3], mode=5)
    fan = file.primitive(points, [0, 1, 2, 3], mode=6)
    line = file.primitive(points, [0, 1], mode=1)
    mesh = decode_mesh(file.shown(strip, fan, line).binary(), "a.glb")
    n = len(points)
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 2, 3], [n, n + 1, n + 2], [n, n + 2, n + 3]]


def test_gltf_in_the_pose_of_its_joints_and_targets():
    points = write.y_up(POINTS)
    file = write.Gltf()
    part = file.primitive(points * 0 + 7, TRIANGLES)
    part["targets"] = [{"POSITION": file.accessor((points - 7).astype("<f4"))}]
    file.shown(part, weights=[1.0])
    reads(file.binary(), "a.glb")

    file = write.Gltf()
    part = file.primitive(points - [0, 5, 0], TRIANGLES)
    part["attributes"]["JOINTS_0"] = file.accessor(np.tile(np.array([1, 0, 0, 0], "u1"), (len(points), 1)))
    part["attributes"]["WEIGHTS_0"] = file.accessor(np.tile(np.array([1, 0, 0, 0], "<f4"), (len(points), 1)))
    back = np.eye(4, dtype="<f4")
    back[3, 1] = -3  # column-major
    file.shown(part, translation=[100, 100, 100], skin=0)  # a skin's node does not move it
    file.json["nodes"] += [{"children": [2], "translation": [0, 6, 0]}, {"translation": [0, 2, 0]}]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    bind = file.accessor(np.stack([np.eye(4, dtype="<f4"), back]).reshape(2, 16))
    file.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": bind}]
    reads(file.binary(), "a.glb")


def test_gltf_that_would_lose_a_part_is_refused(monkeypatch):
    def changed(change):
        file = write.Gltf()
        file.shown(file.primitive(write.y_up(POINTS), TRIANGLES))
        change(file.json)
        return file.binary()

    whole = changed(lambda _: None)
    refuses(whole[:-9], "a.glb", f"is cut short: it holds {len(whole) - 9} of {len(whole)} bytes")
    refuses(b"glTF\1\0\0\0" + whole[8:], "a.glb", "glTF of version 1")

    def says(change, text):
        refuses(changed(change), "a.glb", text)

    says(
        lambda j: j.update(extensionsRequired=["KHR_draco_mesh_compression"]),
        "needs the extension KHR_draco_mesh",
    )
    says(
        lambda j: j.update(extensionsRequired=["EXT_meshopt_compression"]),
        "needs the extension EXT_meshopt_comp",
    )
    says(lambda j: j.update(extensionsUsed=["EXT_mesh_gpu_instancing"]), "uses the extension EXT_mesh_gpu")
    says(lambda j: j["accessors"][1].update(count=len(TRIANGLES) * 3 - 1), "no multiple of three")
    says(lambda j: j["accessors"][1].update(count=10**12), "an accessor goes on after the end of its buffer")
    says(lambda j: j["accessors"][0].update(count=5), "has a face of vertex 19, but 5 vertices")
    says(lambda j: j["accessors"][0].pop("bufferView"), "has an accessor without data")
    says(lambda j: j["meshes"][0]["primitives"][0].update(mode=1), "only points and lines")
    says(lambda j: j["nodes"][0].pop("mesh"), "no mesh in its scene")
    says(lambda j: j["nodes"][0].update(children=[0]), "a node, number 0, in two places")
    says(lambda j: j["nodes"][0].update(mesh=4), "number 4 of its meshes, which is not there")
    says(lambda j: j["accessors"][0].pop("type"), "lacks 'type', which glTF 2 wants")
    says(lambda j: j["nodes"][0].update(children=3), "has values where glTF 2 wants others")
    monkeypatch.setattr(gltf, "_MOST_CORNERS", 10_000)
    many = [{"mesh": 0}] * 100
    says(lambda j: j.update(nodes=many, scenes=[{"nodes": list(range(100))}]), "shows its meshes so often")


def lay_out_gltf(folder, uri, where):
    file = write.Gltf()
    file.shown(file.primitive(write.y_up(POINTS), TRIANGLES))
    (folder / "cup/train").mkdir(parents=True)
    (folder / "cup/train/a.gltf").write_bytes(file.text(uri))
    (folder / where).parent.mkdir(parents=True, exist_ok=True)
    (folder / where).write_bytes(file.data)
    return folder


@pytest.mark.parametrize(
    ("uri", "where"),
    [("a.bin", "cup/train/a.bin"), ("my%20data/a.bin", "cup/train/my data/a.bin"), ("../../b.bin", "b.bin")],
)
def test_gltf_with_its_geometry_in_another_file(tmp_path, uri, where):
    root = lay_out_gltf(tmp_path / "set", uri, where)
    packed = tmp_path / "set.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for file in sorted(root.rglob("*")):
            archive.write(file, file.relative_to(root).as_posix())
    for files in (Folder(root), Zip(packed)):
        np.testing.assert_allclose(corners(read_mesh(files, "cup/train/a.gltf")), corners(WHOLE), atol=1e-6)
        assert other_files(files, "cup/train/a.gltf") == [where]
        assert files.stamp(where)
    data = (root / where).read_bytes()
    (root / where).write_bytes(data[:-1])
    with pytest.raises(
        DataError, match=f"is cut short: .* beside it holds {len(data) - 1} of {len(data)} bytes"
    ):
        read_mesh(Folder(root), "cup/train/a.gltf")
    (root / where).unlink()
    with pytest.raises(DataError, match=r"\.bin cannot be read"):
        read_mesh(Folder(root), "cup/train/a.gltf")


@pytest.mark.parametrize(
    "uri", ["../../../secret.bin", "/etc/passwd", "file:///etc/passwd", "https://a.b/c.bin", "."]
)
def test_gltf_reads_nothing_outside_of_its_dataset(tmp_path, uri):
    root = lay_out_gltf(tmp_path / "set", uri, "../secret.bin")
    with pytest.raises(DataError, match="which is not in the dataset"):
        read_mesh(Folder(root), "cup/train/a.gltf")
    assert other_files(Folder(root), "cup/train/a.gltf") == []


def test_gltf_with_its_geometry_in_its_text():
    file = write.Gltf()
    file.shown(file.primitive(write.y_up(POINTS), TRIANGLES))
    text = file.text("data:application/octet-stream;base64," + base64.b64encode(file.data).decode())
    reads(text, "a.gltf")
    reads(BOM + text, "a.gltf")
    refuses(text[:-40], "a.gltf", "has no whole JSON")
    refuses(text.replace(b";base64,", b";base64,?"), "a.gltf", "not base64")


@pytest.mark.parametrize("ending", ["off", "obj", "ply", "stl", "gltf", "glb"])
def test_what_is_no_mesh_is_called_what_it_is(ending):
    for data, what in (
        (b"", "is empty"),
        (bytes(3000), "holds nothing but zeros"),
        (b"PK\3\4" + bytes(range(256)) * 3, "is a zip archive under the ending"),
        (b"\x1f\x8b\x08" + bytes(range(256)), "is another archive"),
        (b"\n <!DOCTYPE html>\n<html><body>404</body></html>\n", "is a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n", "of a file in Git LFS"),
        ("v 0 0 0\n".encode("utf-16"), "is text in UTF-16"),
    ):
        refuses(data, f"a.{ending}", what)
    others = {"off": write.off, "ply": write.ply, "obj": write.obj}
    for other in others.keys() - {ending, "obj"}:
        refuses(
            others[other](POINTS, POLYGONS),
            f"a.{ending}",
            f"is {'an OFF' if other == 'off' else 'a PLY'} mesh",
        )


def test_an_object_far_from_the_origin_keeps_its_shape():
    for distance in (465_000.0, 1e9):
        far = POINTS + np.array([distance, 12 * distance, 3.0])
        for name, data in (
            ("a.off", write.off(far, POLYGONS)),
            ("a.obj", write.obj(far, POLYGONS)),
            ("a.ply", write.ply(far, POLYGONS, "binary_little_endian")),
        ):
            mesh = decode_mesh(data, name)
            shift = corners(mesh).min((0, 1)) - corners(WHOLE).min((0, 1))
            np.testing.assert_allclose(corners(mesh) - shift, corners(WHOLE), atol=1e-5)


def area(points, faces):
    a, b, c = points[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def star(n, rng):
    """A polygon of n corners around the origin, with its area."""
    angles, radii = 2 * np.pi * (np.arange(n) + rng.uniform(0, 0.9, n)) / n, rng.uniform(0.1, 1, n)
    flat = np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)
    x, y = flat.T
    return flat, abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def cut(points, polygon):
    return triangles(Surface(points, np.array(polygon), np.array([len(polygon)])))


def test_concave_polygons_are_cut_into_what_they_cover():
    rng = np.random.default_rng(0)
    for n in (4, 5, 6, 9, 40, 200):
        for _ in range(20 if n < 100 else 2):
            flat, whole = star(n, rng)
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            points = np.c_[flat, np.zeros(n)] @ turn * 1e-3 + rng.normal(size=3)
            for polygon in (range(n), range(n - 1, -1, -1)):
                faces = cut(points, polygon)
                assert faces.shape == (n - 2, 3)
                np.testing.assert_allclose(area(points, faces), whole * 1e-6, rtol=1e-6)


def test_a_polygon_with_a_hole_cut_in_by_a_bridge_and_degenerate_ones():
    outer = [(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)]
    inner = [(1, 1, 0), (1, 3, 0), (3, 3, 0), (3, 1, 0)]
    points = np.array(outer + inner, float)
    faces = cut(points, [0, 1, 2, 3, 0, 4, 5, 6, 7, 4])
    assert area(points, faces) == pytest.approx(12)
    for polygon in ([0, 2, 1, 3], [0, 0, 0, 0], [0, 1, 0, 1, 0], [0, 1, 1, 2, 3, 3]):
        assert cut(points, polygon).shape == (len(polygon) - 2, 3)


def test_forty_thousand_faces_of_any_format_in_an_instant():
    n = 20_000
    rng = np.random.default_rng(0)
    points, faces = rng.normal(size=(n, 3)).round(4), rng.integers(n, size=(2 * n, 3))
    rows = np.zeros(2 * n, [("n", "u1"), ("f", "<i4", 3)])
    rows["n"], rows["f"] = 3, faces
    head = write.ply(points[:0], [], "binary_little_endian").decode().replace("property uchar red\n", "")
    head = head.replace("property uchar flags\n", "").replace("vertex 0", f"vertex {n}")
    for name, data in (
        ("a.obj", write.obj(points, faces.tolist(), corner="{0}/{0}/{0}")),
        (
            "a.ply",
            head.replace("face 0", f"face {2 * n}").encode()
            + points.astype("<f8").tobytes()
            + rows.tobytes(),
        ),
        ("a.ply", write.ply(points, [(*f, 0) if i % 2 else f for i, f in enumerate(faces.tolist())])),
        ("a.stl", write.stl(points, faces)),
    ):
        start = time.process_time()
        mesh = decode_mesh(data, name)
        assert time.process_time() - start < 0.4  # 0.08 s where nothing else runs
        assert len(mesh.faces) >= 2 * n


@pytest.fixture
def mixed(tmp_path):
    """One object with each of its axes up in turn, as an OBJ, and y-up as a glTF and its .bin."""
    x, y, z = POINTS.T
    for axis, points in {"x": np.stack([z, y, -x], 1), "y": np.stack([x, z, -y], 1), "z": POINTS}.items():
        for split in ("train", "test"):
            path = tmp_path / f"objects/{axis}/{split}/{axis}_{split}.obj"
            path.parent.mkdir(parents=True)
            path.write_bytes(write.obj(points, POLYGONS))
    for split in ("train", "test"):
        lay_out_gltf(tmp_path / split, "a.bin", "cup/train/a.bin")
        (tmp_path / split / "cup/train").rename(tmp_path / f"objects/z/{split}/more")
        for file in (tmp_path / f"objects/z/{split}/more").iterdir():
            file.rename(file.parents[1] / file.name)
        (tmp_path / f"objects/z/{split}/more").rmdir()
    return tmp_path / "objects"


def named(root, **options):
    return {item.name: item for item in opened(root, **options).items}


def test_the_axis_that_points_up_is_the_formats_unless_it_is_said(mixed):
    source = opened(mixed, up="auto").source
    for axis, name in (
        ("auto", "z/z_train"),
        ("auto", "z/a"),
        ("x", "x/x_train"),
        ("y", "y/y_test"),
        ("y", "z/a"),
    ):
        items = named(mixed, up=axis)
        item = items.get(name) or items["z/train/a.gltf"]
        np.testing.assert_allclose(corners(source.mesh(item)), corners(WHOLE), atol=1e-6)
    lying = corners(source.mesh(named(mixed, up="z")["y/y_train"]))
    assert np.abs(lying - corners(WHOLE)).max() > 1


def test_views_stay_valid_where_the_axis_changes_nothing(mixed):
    auto, said = named(mixed, up="auto"), {axis: named(mixed, up=axis) for axis in "xyz"}
    for name, item in auto.items():
        own = "y" if item.parts[0].endswith(".gltf") else "z"
        assert {axis for axis in "xyz" if said[axis][name].stamp == item.stamp} == {own}
    before = {name: item.stamp for name, item in auto.items()}
    other = mixed / "z/train/a.bin"
    other.write_bytes(other.read_bytes() + b"\0")
    changed = {n for n, item in named(mixed, up="auto").items() if item.stamp != before[n]}
    assert changed == {"z/train/a.gltf"}


def test_pictures_are_not_turned(tmp_path):
    for split in ("train", "test"):
        (tmp_path / "cup" / split).mkdir(parents=True)
        for i in range(12):
            (tmp_path / "cup" / split / f"a{split}_{i + 1:03d}.png").write_bytes(b"")
    with pytest.raises(ConfigError, match=r"env\.dataset\.up turns meshes and points, but .* holds pictures"):
        opened(tmp_path, up="y")


@pytest.mark.parametrize("ending", ["off", "obj", "ply", "stl", "glb", "gltf"])
def test_files_that_another_library_writes(ending, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    whole = trimesh.creation.box((1, 2, 3))
    scene = trimesh.Scene([whole, whole.copy().apply_translation([5, 0, 0])])
    written = (scene if ending in {"glb", "gltf", "obj"} else scene.to_mesh()).export(file_type=ending)
    files = written if isinstance(written, dict) else {f"two.{ending}": written}
    for name, data in files.items():
        (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    (path,) = tmp_path.glob(f"*.{ending}")
    mesh = read_mesh(Folder(tmp_path), path.name, "z")
    assert len(mesh.faces) == 24
    used = corners(mesh).reshape(-1, 3)
    np.testing.assert_allclose([used.min(0), used.max(0)], [[-0.5, -1, -1.5], [5.5, 1, 1.5]])
