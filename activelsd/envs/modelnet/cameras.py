"""Where cameras stand around an object: on rings at one or more elevations, or on a dodecahedron.

The twenty vertices of the dodecahedron are those of MVCNN (Su et al. 2015) and RotationNet (Kanezaki et al.
2018), in the order of MVCNN's code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class Camera(NamedTuple):
    """The direction, from the object, that a camera stands in."""

    azimuth: float  # degrees about the upright axis, counter-clockwise seen from above
    elevation: float  # degrees above the horizontal plane

    @property
    def name(self) -> str:
        """The name of its view, like `e30_a090`."""
        whole, _, fraction = f"{self.azimuth:.2f}".rstrip("0").partition(".")
        return f"e{self.elevation:g}_a{whole:0>3}" + (f".{fraction}" if fraction else "")


class Rig(Protocol):
    """The cameras around an object. The methods return the camera that a step leads to, -1 if none."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All of them; views are in this order."""
        ...

    @property
    def starts(self) -> int:
        """How many of the first cameras begin episodes."""
        ...

    @property
    def climbs(self) -> bool:
        """Whether some camera stands higher than another."""
        ...

    def beside(self, camera: int, number: int) -> int:
        """A number of cameras further, counter-clockwise."""
        ...

    def around(self, camera: int, degrees: float) -> int:
        """The camera nearest to this angle, counter-clockwise, but always another one."""
        ...

    def above(self, camera: int, number: int) -> int:
        """A number of elevations higher, or lower if it is negative."""
        ...


class Ring(NamedTuple):
    """Cameras at one elevation."""

    elevation: float
    azimuths: tuple[float, ...]  # rising


@dataclass(frozen=True)
class Rings:
    """Rings of cameras, from the lowest to the highest. Episodes start on the first.

    A ring may have any number of cameras; up and down lead to the nearest azimuth.
    """

    rings: tuple[Ring, ...]

    @classmethod
    def even(cls, azimuths: int, elevations: Sequence[float]) -> Rings:
        """Rings with the same number of cameras, evenly spaced, the first at azimuth 0."""
        around = tuple(i * 360 / azimuths for i in range(azimuths))
        return cls(tuple(Ring(elevation, around) for elevation in elevations))

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """See `Rig`; ring after ring."""
        return tuple(Camera(azimuth, ring.elevation) for ring in self.rings for azimuth in ring.azimuths)

    @property
    def starts(self) -> int:
        """See `Rig`."""
        return len(self.rings[0].azimuths)

    @property
    def climbs(self) -> bool:
        """See `Rig`."""
        return len(self.rings) > 1

    def beside(self, camera: int, number: int) -> int:
        """See `Rig`."""
        level, place = self._places[camera]
        count = len(self.rings[level].azimuths)
        return camera - place + (place + number) % count if number % count else -1

    def around(self, camera: int, degrees: float) -> int:
        """See `Rig`; half a camera counts as a whole one."""
        count = len(self.rings[self._places[camera][0]].azimuths)
        number = max(1, math.floor(abs(degrees) * count / 360 + 0.5))
        return self.beside(camera, -number if degrees < 0 else number)

    def above(self, camera: int, number: int) -> int:
        """See `Rig`."""
        level, place = self._places[camera]
        if not 0 <= level + number < len(self.rings):
            return -1
        here, there = self.rings[level].azimuths[place], self.rings[level + number].azimuths
        first = self._places.index((level + number, 0))
        return first + min(range(len(there)), key=lambda i: abs((there[i] - here + 180) % 360 - 180))

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        """The ring of each camera, and its place on it."""
        return [(level, i) for level, ring in enumerate(self.rings) for i in range(len(ring.azimuths))]


_GOLDEN = (1 + math.sqrt(5)) / 2
_SIGNS = (1, -1)
VERTICES: tuple[tuple[float, float, float], ...] = (
    *product(_SIGNS, _SIGNS, _SIGNS),
    *((0, y / _GOLDEN, z * _GOLDEN) for y in _SIGNS for z in _SIGNS),
    *((x * _GOLDEN, 0, z / _GOLDEN) for x in _SIGNS for z in _SIGNS),
    *((x / _GOLDEN, y * _GOLDEN, 0) for y in _SIGNS for x in _SIGNS),
)
"""Of the dodecahedron, x, y and z (up), in MVCNN's order."""


@dataclass(frozen=True)
class Dodecahedron:
    """Twenty cameras on the vertices of a dodecahedron; a step leads along one of a vertex's three edges.

    Sideways it is the edge that leads furthest to that side, the upper of two; up and down the edge that
    climbs or falls most. An angle leads to the vertex nearest to the point at that angle on the same height.
    """

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """See `Rig`."""
        return tuple(
            Camera(math.degrees(math.atan2(y, x)) % 360, math.degrees(math.atan2(z, math.hypot(x, y))))
            for x, y, z in VERTICES
        )

    @property
    def starts(self) -> int:
        """See `Rig`; all."""
        return len(VERTICES)

    @property
    def climbs(self) -> bool:
        """See `Rig`."""
        return True

    def beside(self, camera: int, number: int) -> int:
        """See `Rig`."""
        for _step in range(abs(number)):
            x, y, _ = self._vertices[camera]
            camera = self._furthest(camera, np.array([-y, x, 0.0]) * (1 if number > 0 else -1))
        return camera

    def around(self, camera: int, degrees: float) -> int:
        """See `Rig`."""
        x, y, z = self._vertices[camera]
        turn = math.radians(degrees)
        wanted = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), z
        near = np.round(self._vertices @ np.array(wanted), 9)
        near[camera] = -np.inf
        return int(near.argmax())

    def above(self, camera: int, number: int) -> int:
        """See `Rig`."""
        for _ in range(abs(number)):
            up = np.array([0.0, 0.0, 1 if number > 0 else -1])
            to = self._furthest(camera, up)
            if (self._vertices[to] - self._vertices[camera]) @ up < 1e-9:
                return -1
            camera = to
        return camera

    @cached_property
    def _vertices(self) -> NDArray[np.float64]:
        return np.array(VERTICES, np.float64)

    def _furthest(self, camera: int, direction: NDArray[np.float64]) -> int:
        """The neighbour that lies furthest in a direction; of two, the first in MVCNN's order."""
        away = np.linalg.norm(self._vertices - self._vertices[camera], axis=1)
        neighbours = np.flatnonzero(np.isclose(away, 2 / _GOLDEN))
        reach = np.round((self._vertices[neighbours] - self._vertices[camera]) @ direction, 9)
        return int(neighbours[reach.argmax()])
