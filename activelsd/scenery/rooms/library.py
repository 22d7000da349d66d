"""Furniture for rooms: models in metres, with sizes by kind and random colours by number."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from activelsd.errors import DataError, did_you_mean
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms import furniture
from activelsd.scenery.rooms.models import Model, place_at_origin
from activelsd.scenery.rooms.textures import Colour, Material, darker
from activelsd.scenery.shapes import cabinets, fixtures, seating, tables


class Size(NamedTuple):
    """The range in metres of one extent of a kind's objects."""

    extent: str  # "height", or "longest" of width and height
    low: float
    high: float


SIZES: Mapping[str, Size] = {
    "armchair": Size("height", 0.8, 0.95),
    "bed": Size("longest", 1.0, 1.6),
    "bench": Size("longest", 1.2, 1.5),
    "bookshelf": Size("longest", 1.2, 1.9),
    "bottle": Size("height", 0.24, 0.31),
    "bowl": Size("longest", 0.16, 0.22),
    "cabinet": Size("longest", 0.9, 1.3),
    "chair": Size("height", 0.8, 0.98),
    "coffee_table": Size("height", 0.38, 0.46),
    "cup": Size("height", 0.09, 0.11),
    "desk": Size("height", 0.72, 0.78),
    "dresser": Size("longest", 0.9, 1.2),
    "fireplace": Size("longest", 1.1, 1.4),
    "floor_lamp": Size("height", 1.4, 1.7),
    "lamp": Size("height", 0.4, 1.5),
    "mantel": Size("longest", 1.1, 1.4),
    "monitor": Size("longest", 0.45, 0.6),
    "night_stand": Size("longest", 0.5, 0.65),
    "piano": Size("longest", 1.2, 1.4),
    "plant": Size("height", 0.5, 1.2),
    "sofa": Size("longest", 1.6, 2.0),
    "table": Size("height", 0.7, 0.77),
    "tv_stand": Size("longest", 0.9, 1.3),
    "wardrobe": Size("longest", 1.6, 1.95),
}
"""Sizes of furniture, and of objects that stand on it."""

FURNITURE = frozenset(SIZES) - {"bottle", "bowl", "cup", "monitor"}
"""Kinds that stand on the floor."""

_MAKERS: Mapping[str, Callable[[np.random.Generator], Mesh]] = {
    "armchair": furniture.armchair,
    "bed": furniture.bed,
    "bench": seating.bench,
    "bookshelf": cabinets.bookshelf,
    "chair": furniture.chair,
    "coffee_table": furniture.coffee_table,
    "desk": tables.desk,
    "dresser": cabinets.dresser,
    "floor_lamp": furniture.floor_lamp,
    "mantel": fixtures.mantel,
    "night_stand": cabinets.night_stand,
    "piano": fixtures.piano,
    "sofa": seating.sofa,
    "table": tables.table,
    "tv_stand": cabinets.tv_stand,
    "wardrobe": cabinets.wardrobe,
}

_WOODS: tuple[Colour, ...] = ((150, 104, 62), (196, 158, 108), (98, 64, 42), (214, 190, 150), (122, 78, 60))
_PAINTS: tuple[Colour, ...] = (
    (226, 224, 216),
    (84, 104, 116),
    (62, 66, 72),
    (140, 154, 128),
    (186, 172, 152),
)
_CLOTHS: tuple[Colour, ...] = ((116, 124, 138), (150, 66, 58), (74, 96, 84), (190, 176, 150), (70, 78, 110))
_SOFT = frozenset({"armchair", "bed", "sofa"})
_TRIMS: tuple[Colour, ...] = (
    (206, 200, 186), (52, 50, 52), (168, 58, 48), (54, 86, 132), (196, 164, 70), (88, 112, 82),
    (160, 164, 170),
)  # fmt: skip

_MINOR = 0.02
"""Parts below this fraction of the whole bounding box, such as books or handles, get another colour."""


class Library(Protocol):
    """Gives furniture by kind and number, always the same to the byte."""

    kinds: tuple[str, ...]  # kinds that stand on the floor

    def model(self, kind: str, number: int) -> Model:
        """The model with this kind and number. Raises DataError if there is no such kind."""
        ...


class Embedded:
    """Furniture generated from random parameters, as many pieces of each kind as needed."""

    kinds: tuple[str, ...] = tuple(sorted(_MAKERS))

    def model(self, kind: str, number: int) -> Model:
        """See `Library`."""
        if kind not in _MAKERS:
            hint = did_you_mean(kind, self.kinds)
            raise DataError(f"There is no embedded furniture '{kind}'; {hint}")
        rng = np.random.default_rng((zlib.crc32(kind.encode()), number))
        return painted(kind, number, _MAKERS[kind](rng), rng)


def painted(kind: str, number: int, mesh: Mesh, rng: np.random.Generator) -> Model:
    """Scales a mesh to its kind's size; large parts get one material and small parts trim colours."""
    used = mesh.vertices[np.unique(mesh.faces)]
    width, _, height = np.ptp(used, axis=0)
    size = SIZES[kind]
    extent = float(height if size.extent == "height" else max(width, height))
    scale = float(rng.uniform(size.low, size.high)) / extent
    standing = place_at_origin(mesh, scale)
    main = _main_material(kind, rng)
    count = 4 if kind == "bookshelf" else 1
    trims = [_TRIMS[i] for i in rng.permutation(len(_TRIMS))[:count]]
    paint = _by_parts(standing, len(trims))
    return Model(kind, number, standing, paint, (main, *(Material(trim) for trim in trims)))


def _main_material(kind: str, rng: np.random.Generator) -> Material:
    if kind in _SOFT:
        cloth = _CLOTHS[rng.integers(len(_CLOTHS))]
        pattern = ("plain", "stripes", "checks")[rng.integers(3)]
        return Material(cloth, darker(cloth, 0.18), pattern, float(rng.uniform(0.08, 0.2)))
    if rng.random() < 0.35:
        return Material(_PAINTS[rng.integers(len(_PAINTS))])
    wood = _WOODS[rng.integers(len(_WOODS))]
    return Material(wood, darker(wood, 0.14), "grain", float(rng.uniform(0.03, 0.05)), int(rng.integers(3)))


def _by_parts(mesh: Mesh, trims: int) -> NDArray[np.int32]:
    """(M,) material of every face: 0 for the large connected parts, 1..trims in turn for the others."""
    _, welded = np.unique(np.round(mesh.vertices, 5), axis=0, return_inverse=True)
    faces = welded.reshape(-1)[mesh.faces]
    n = int(faces.max()) + 1
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    links = coo_array((np.ones(len(edges), np.uint8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    _, part_of_vertex = connected_components(links, directed=False)
    parts, part = np.unique(part_of_vertex[faces[:, 0]], return_inverse=True)
    low, high = np.full((len(parts), 3), np.inf), np.full((len(parts), 3), -np.inf)
    corners = mesh.vertices[mesh.faces]
    np.minimum.at(low, part, corners.min(axis=1))
    np.maximum.at(high, part, corners.max(axis=1))
    whole = np.ptp(corners.reshape(-1, 3), axis=0)
    share = ((high - low + 0.01) / (whole + 0.01)).prod(axis=1)
    colour = np.where(share < _MINOR, 1 + np.arange(len(parts)) % trims, 0)
    return colour[part].astype(np.int32)
