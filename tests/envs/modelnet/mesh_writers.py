"""Writes one object in every mesh format, in the ways that programs write it."""

from __future__ import annotations

import json
import struct

import numpy as np

PLANK = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


def stool():
    """(points (N, 3), polygons) of an L-shaped seat on a post, z up, no two sides alike."""
    seat = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)]
    points = [(x, y, z) for z in (2.0, 2.5) for x, y in seat]
    polygons = [tuple(range(5, -1, -1)), tuple(range(6, 12))]
    polygons += [(i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i) for i in range(6)]
    points += [(x, y, z) for z in (0.0, 2.0) for x, y in ((0.2, 0.2), (0.7, 0.2), (0.7, 0.8), (0.2, 0.8))]
    polygons += [tuple(12 + i for i in side) for side in PLANK]
    polygons.append((0, 1, 6))
    return np.array(points), polygons


def fans(polygons):
    """Triangles (M, 3) of convex polygons."""
    return np.array([(f[0], f[i], f[i + 1]) for f in polygons for i in range(1, len(f) - 1)])


def off(points, polygons, head="OFF\n", extra="", end="\n"):
    rows = [head + f"{len(points)} {len(polygons)} 0"]
    rows += [" ".join(map(repr, map(float, p))) + extra for p in points]
    rows += [" ".join(map(str, (len(f), *f))) for f in polygons]
    return (end.join(rows) + end).encode()


def obj(points, polygons, gap=" ", end="\n", corner="{}", indent=""):
    rows = [indent + gap.join(("v", *(repr(float(x)) for x in p))) for p in points]
    rows += [indent + gap.join(("f", *(corner.format(i + 1) for i in f))) for f in polygons]
    return (end.join(rows) + end).encode()


def ply(points, polygons, form="ascii", length="uchar", end="\n", name="vertex_indices", faces_first=False):
    parts = [
        [
            f"element vertex {len(points)}",
            *(f"property double {axis}" for axis in "xyz"),
            "property uchar red",
        ],
        [f"element face {len(polygons)}", f"property list {length} int {name}", "property uchar flags"],
    ]
    order = ">" if "big" in form else "<"
    if form == "ascii":
        body = [
            (end.join(" ".join(map(repr, map(float, p))) + " 7" for p in points) + end).encode(),
            (end.join(" ".join(map(str, (len(f), *f, 1))) for f in polygons) + end).encode(),
        ]
    else:
        n = {"uchar": "B", "int": "i", "ushort": "H"}[length]
        body = [
            b"".join(struct.pack(order + "3dB", *p, 7) for p in points),
            b"".join(struct.pack(f"{order}{n}{len(f)}iB", len(f), *f, 1) for f in polygons),
        ]
    if faces_first:
        parts, body = parts[::-1], body[::-1]
    lines = ["ply", f"format {form} 1.0", "comment by hand", *parts[0], *parts[1], "end_header", ""]
    return end.join(lines).encode() + b"".join(body)


def stl(points, triangles, title=b"made by hand", said=None):
    corners = np.asarray(points, "<f4")[triangles]
    rows = b"".join(bytes(12) + c.tobytes() + b"\0\0" for c in corners)
    return title.ljust(80) + struct.pack("<I", len(triangles) if said is None else said) + rows


def stl_text(points, triangles, word=str, end="\n"):
    rows = ["solid facet 1 vertex"]
    for triangle in triangles:
        rows += ["facet normal nan 0 0", "  outer loop"]
        rows += ["    vertex " + " ".join(f"{x:e}" for x in points[i]) for i in triangle]
        rows += ["  endloop", "endfacet"]
    return (end.join(map(word, [*rows, "endsolid"])) + end).encode()


def y_up(points):
    """z-up points as glTF has them: y up."""
    x, y, z = np.asarray(points, float).T
    return np.stack([x, z, -y], axis=1)


class Gltf:
    """A glTF document of one buffer, accessor by accessor."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self.data = b""

    def view(self, data):
        self.data += bytes(-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.data += data
        self.json["bufferViews"].append(view)
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values, **more):
        values = np.asarray(values)
        kind = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}[values.dtype.str[1:]]
        width = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[values.shape[1] if values.ndim > 1 else 1]
        entry = {"bufferView": self.view(values.tobytes()), "componentType": kind, "count": len(values)}
        self.json["accessors"].append(entry | {"type": width} | more)
        return len(self.json["accessors"]) - 1

    def primitive(self, points, triangles, **more):
        attributes = {"POSITION": self.accessor(np.asarray(points, "<f4"))}
        return {"attributes": attributes, "indices": self.accessor(np.ravel(triangles).astype("<u2"))} | more

    def shown(self, *primitives, **node):
        self.json |= {"meshes": [{"primitives": list(primitives)}], "nodes": [{"mesh": 0} | node]}
        self.json |= {"scenes": [{"nodes": [0]}], "scene": 0}
        return self

    def text(self, uri):
        buffers = [{"byteLength": len(self.data), "uri": uri}]
        return json.dumps(self.json | {"buffers": buffers}).encode()

    def binary(self):
        text = json.dumps(self.json | {"buffers": [{"byteLength": len(self.data)}]}).encode()
        text += b" " * (-len(text) % 4)
        data = self.data + bytes(-len(self.data) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def glb(points, triangles):
    gltf = Gltf()
    return gltf.shown(gltf.primitive(y_up(points), triangles)).binary()
