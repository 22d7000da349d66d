"""The triangles that a glTF's default scene shows, in its own axes: y is up, z to the front.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.mesh_formats.gltf_file import Beside, Document, Invalid
from activelsd.envs.modelnet.mesh_formats.surface import Surface
from activelsd.errors import DataError

_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "EXT_lights_")
"""Beginnings of extensions that change what is not seen here: colours and lights."""

_ALLOWED = frozenset({"KHR_mesh_quantization", "KHR_xmp", "KHR_xmp_json_ld", "KHR_animation_pointer"})

_INSTANCES = "EXT_mesh_gpu_instancing"

_MOST_CORNERS = 20_000_000
"""Of all that is shown, unless the file is larger, as nodes may show one mesh any number of times."""

_PART = 200
"""Corners that a part counts as at least, for the time it takes."""


def read(data: bytes, name: str, beside: Beside) -> Surface:
    """The triangles of all meshes in the default scene, where their nodes put them.

    Strips, fans, sparse, quantised and normalised accessors, skins and morph targets are read; points and
    lines are not seen.

    Args:
        data: the file, text or binary.
        name: of the file in messages.
        beside: reads the files that it refers to.

    Raises:
        DataError: it is no glTF 2, not whole, or needs an extension that is not known here.
    """
    try:
        document = Document(data, beside)
        _check_extensions(document.json)
        with np.errstate(all="ignore"):  # points that are not finite are refused for all formats alike
            return _scene(document)
    except Invalid as error:
        raise DataError(f"{name} {error}; export it again or remove it.") from None
    except KeyError as error:
        raise DataError(f"{name} lacks {str(error)[:40]}, which glTF 2 wants; export it again.") from None
    except (IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError):
        raise DataError(
            f"{name} has values where glTF 2 wants others; export it again or remove it."
        ) from None


def _check_extensions(json: Mapping[str, Any]) -> None:
    for extension in json.get("extensionsRequired", []):
        if not (extension in _ALLOWED or extension.startswith(_HARMLESS)):
            raise Invalid(f"needs the extension {extension[:60]}, which is not read")
    if _INSTANCES in json.get("extensionsUsed", []):
        raise Invalid(f"uses the extension {_INSTANCES}, which is not read")


def _scene(document: Document) -> Surface:
    """The surface of the default scene; all nodes if there are no scenes."""
    places = dict(_placed(document))
    points: list[NDArray[np.float64]] = []
    triangles: list[NDArray[np.int64]] = []
    n_points = n_corners = other = 0
    for index in places:
        node = document.item("nodes", index)
        if "mesh" not in node:
            continue
        mesh = document.item("meshes", node["mesh"])
        weights = node.get("weights", mesh.get("weights", []))
        for primitive in mesh["primitives"]:
            faces = _triangles(document, primitive)
            if faces is None:
                other += 1
                continue
            own = _positions(document, primitive, weights)
            n_corners += max(faces.size + len(own), _PART)
            if n_corners > max(_MOST_CORNERS, document.size):
                raise Invalid(f"shows its meshes so often that they have more than {_MOST_CORNERS:,} corners")
            if faces.size and faces.max() >= len(own):
                raise Invalid(f"has a face of vertex {faces.max()}, but {len(own)} vertices")
            if "skin" in node:
                own = _skinned(document, primitive, document.item("skins", node["skin"]), places, own)
            else:
                own = own @ places[index][:3, :3].T + places[index][:3, 3]
            points.append(own)
            triangles.append(faces + n_points)
            n_points += len(own)
    if not triangles:
        seen = "only points and lines" if other else "no mesh in its scene"
        raise Invalid(f"has {seen}, so there is nothing to see")
    return Surface.of_triangles(np.concatenate(points), np.concatenate(triangles))


def _placed(document: Document) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Every node of the default scene with its matrix (4, 4) in the scene's axes."""
    nodes = document.json.get("nodes", [])
    if document.json.get("scenes"):
        roots = document.item("scenes", document.json.get("scene", 0)).get("nodes", [])
    else:
        inner = {child for node in nodes for child in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in inner]
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        index, around = waiting.pop()
        node = document.item("nodes", index)
        if index in seen:
            raise Invalid(f"has a node, number {index}, in two places")
        seen.add(index)
        matrix = around @ _matrix(node)
        yield index, matrix
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]


def _matrix(node: Mapping[str, Any]) -> NDArray[np.float64]:
    """The transform (4, 4) of a node: its matrix, or scale, then rotation, then translation."""
    if "matrix" in node:
        whole: NDArray[np.float64] = np.array(node["matrix"], np.float64).reshape(4, 4).T
        return whole
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64).reshape(3)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _triangles(document: Document, primitive: Mapping[str, Any]) -> NDArray[np.int64] | None:
    """Indices (T, 3) into the positions of a primitive; None if it is of points or lines."""
    mode = primitive.get("mode", 4)
    if mode in (0, 1, 2, 3):
        return None
    if "indices" in primitive:
        order = document.array(primitive["indices"])[:, 0].astype(np.int64)
    else:
        order = np.arange(len(document.array(primitive["attributes"]["POSITION"])))
    if mode == 4:
        if len(order) % 3:
            raise Invalid(f"has triangles of {len(order)} corners together, which is no multiple of three")
        return order.reshape(-1, 3)
    if mode == 5:
        return np.stack([order[:-2], order[1:-1], order[2:]], axis=1) if len(order) > 2 else order[:0, None]
    if mode == 6:
        first = np.full(max(len(order) - 2, 0), order[0] if len(order) else 0)
        return np.stack([first, order[1:-1], order[2:]], axis=1)
    raise Invalid(f"has a primitive of mode {str(mode)[:20]}")


def _positions(document: Document, primitive: Mapping[str, Any], weights: Any) -> NDArray[np.float64]:
    """The positions (N, 3) of a primitive, moved by its morph targets."""
    if "KHR_draco_mesh_compression" in primitive.get("extensions", {}) and "bufferView" not in document.item(
        "accessors", primitive["attributes"]["POSITION"]
    ):
        raise Invalid("is compressed by KHR_draco_mesh_compression, which is not read")
    points = document.array(primitive["attributes"]["POSITION"]).astype(np.float64)
    if points.shape[1] != 3:
        raise Invalid("has positions that are not x, y and z")
    for target, weight in zip(primitive.get("targets", []), weights, strict=False):
        if weight and "POSITION" in target:
            points = points + float(weight) * document.array(target["POSITION"])
    return points


def _skinned(
    document: Document,
    primitive: Mapping[str, Any],
    skin: Mapping[str, Any],
    places: Mapping[int, NDArray[np.float64]],
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Points (N, 3) where the joints of a skin hold them, by which they alone are placed."""
    joints = [places[joint] for joint in skin["joints"]]
    if "inverseBindMatrices" in skin:
        inverse = document.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = [joint @ inverse[i] for i, joint in enumerate(joints)]
    matrices = np.stack(joints)
    moved, total = np.zeros_like(points), np.zeros((len(points), 1))
    for n in range(8):
        if f"JOINTS_{n}" not in primitive["attributes"]:
            break
        chosen = document.array(primitive["attributes"][f"JOINTS_{n}"]).astype(np.int64)
        shares = document.array(primitive["attributes"][f"WEIGHTS_{n}"]).astype(np.float64)
        if chosen.size and chosen.max() >= len(matrices):
            raise Invalid(f"has a vertex of joint {chosen.max()}, but {len(matrices)} joints")
        for column in range(chosen.shape[1]):
            own = matrices[chosen[:, column]]
            moved += shares[:, column, None] * (
                np.einsum("nij,nj->ni", own[:, :3, :3], points) + own[:, :3, 3]
            )
            total += shares[:, column, None]
    if (total <= 0).any():
        raise Invalid("has a skin that leaves out some of its vertices")
    return moved / total
