"""Embedded shapes: meshes of ModelNet40 categories made by parameters, where no data set is at hand.

They come in groups that look alike from some sides and not from others, as real objects do: cabinets are
plain at the back, a cup hides its handle. One view is not enough; a ring of views is.
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
"""Names of the embedded categories, all of them ModelNet40's."""


def make_shape(category: str, rng: np.random.Generator) -> Mesh:
    """Draw an object of a category, turned about z by a random angle so that azimuth says nothing.

    Raises:
        DataError: there is no embedded category of that name.
    """
    if category not in _MAKERS:
        known = ", ".join(CATEGORIES)
        raise DataError(f"There is no embedded category '{category}'; the embedded ones are {known}.")
    mesh = _MAKERS[category](rng)
    return turn(mesh, float(rng.uniform(0.0, 360.0)))


__all__ = ["CATEGORIES", "make_shape"]
