"""The mesh with materials, made by libraries, placed by layouts and rendered by the renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms.textures import Material
from activelsd.scenery.shapes.solids import join


@dataclass(frozen=True, eq=False)
class Model:
    """An object in its own coordinates: metres, z up, front towards -y.

    It stands on z = 0, with the centre of its bounding box above the origin.
    """

    kind: str
    number: int  # kind and number determine the rest
    mesh: Mesh
    paint: NDArray[np.int32]  # (M,) index of each face's material
    materials: tuple[Material, ...]

    @property
    def name(self) -> str:
        """Kind and number as one word."""
        return f"{self.kind}_{self.number}"

    @cached_property
    def size(self) -> tuple[float, float, float]:
        """Width, depth and height in metres."""
        width, depth, height = np.ptp(self.mesh.vertices[np.unique(self.mesh.faces)], axis=0)
        return float(width), float(depth), float(height)


Part = tuple[Mesh, Material]


def assembled(kind: str, number: int, parts: Sequence[Part], scale: float = 1.0) -> Model:
    """Joins parts to a model, scales it and places it at the origin."""
    materials = tuple(dict.fromkeys(material for _, material in parts))
    paint = np.concatenate([np.full(len(m.faces), materials.index(p), np.int32) for m, p in parts])
    return Model(kind, number, place_at_origin(join(mesh for mesh, _ in parts), scale), paint, materials)


def place_at_origin(mesh: Mesh, scale: float) -> Mesh:
    """The scaled mesh with its lowest point at z = 0 and its bounding box centred above the origin."""
    used = mesh.vertices[np.unique(mesh.faces)].astype(np.float64)
    low, high = used.min(axis=0), used.max(axis=0)
    centre = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Mesh(((mesh.vertices - centre) * scale).astype(np.float32), mesh.faces)
