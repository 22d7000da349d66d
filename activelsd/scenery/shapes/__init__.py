"""Embedded shapes: random meshes of ModelNet40 categories, for use without a data set.

As with real objects, some categories look the same from some sides: cabinets are plain at the back, and a cup
can hide its handle. So one view is not enough, but a ring of views is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from activelsd.errors import DataError
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes import cabinets, fixtures, screens, seating, tables, vessels
from activelsd.scenery.shapes.solids import turn

_MAKERS: Mapping[str, Callable[[np.random.Generator], Mesh]] = {
    "bench": seating.bench,
    "bookshelf": cabinets.bookshelf,
    "cup": vessels.cup,
    "desk": tables.desk,
    "dresser": cabinets.dresser,
    "laptop": screens.laptop,
    "mantel": fixtures.mantel,
    "monitor": screens.monitor,
    "night_stand": cabinets.night_stand,
    "piano": fixtures.piano,
    "radio": fixtures.radio,
    "sofa": seating.sofa,
    "table": tables.table,
    "tv_stand": cabinets.tv_stand,
    "vase": vessels.vase,
    "wardrobe": cabinets.wardrobe,
}

CATEGORIES: tuple[str, ...] = tuple(sorted(_MAKERS))
"""Names of the embedded categories; all are ModelNet40 categories."""


def make_shape(category: str, rng: np.random.Generator) -> Mesh:
    """Draws an object of a category and rotates it about z by a random angle, so that azimuth has no meaning.

    Raises:
        DataError: there is no embedded category of that name.
    """
    if category not in _MAKERS:
        raise DataError(f"There is no embedded category '{category}'; there are {', '.join(CATEGORIES)}.")
    mesh = _MAKERS[category](rng)
    return turn(mesh, float(rng.uniform(0.0, 360.0)))


__all__ = ["CATEGORIES", "make_shape"]
