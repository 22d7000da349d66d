"""Small household objects with labels: cans, bottles, boxes, cups and others.

They come in families of four with the same body and colours; only the patterns of their labels differ. Labels
are on most sides and have similar mean brightness, so from far away they all look gray.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from activelsd.errors import DataError, did_you_mean
from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms.models import Model, Part, assembled
from activelsd.scenery.rooms.textures import Colour, Material, darker
from activelsd.scenery.shapes import vessels
from activelsd.scenery.shapes.solids import arc, box, cylinder, lathe, shift, slab, tube, turn

LABELS = (
    ("#####", ".....", "#####", ".....", "#####"),
    ("#.#.#", "#.#.#", "#.#.#", "#.#.#", "#.#.#"),
    ("#.#.#", ".#.#.", "#.#.#", ".#.#.", "#.#.#"),
    ("#####", "#...#", "#.#.#", "#...#", "#####"),
)
"""Cells of the label of each member of a family, row by row from the top; # is dark."""

_BODIES: tuple[Colour, ...] = (
    (178, 38, 42), (38, 74, 148), (214, 178, 52), (40, 120, 74), (226, 222, 210), (92, 60, 44), (60, 62, 70),
    (214, 120, 40), (128, 168, 190), (150, 84, 140),
)  # fmt: skip
_LIGHT, _DARK = Material((240.0, 238.0, 228.0)), Material((28.0, 28.0, 34.0))
_CELLS = len(LABELS[0])
_RELIEF = 0.0008
"""Metres by which a label stands out from the surface."""


class _Style(NamedTuple):
    """The random parameters of an object: only `label` differs within a family."""

    rng: np.random.Generator
    body: Material
    trim: Material
    label: Sequence[str]


def small_thing(kind: str, number: int) -> Model:
    """The object with this kind and number, always the same to the byte.

    Args:
        kind: one of `KINDS`.
        number: from 0; `number // 4` is the family, `number % 4` the label.

    Raises:
        DataError: there is no such kind.
    """
    if kind not in _MAKERS:
        hint = did_you_mean(kind, KINDS)
        raise DataError(f"There is no embedded small object '{kind}'; {hint}")
    family, label = divmod(number, len(LABELS))
    rng = np.random.default_rng((zlib.crc32(kind.encode()), family))
    first, second = rng.permutation(len(_BODIES))[:2]
    body, trim = Material(_BODIES[first]), Material(darker(_BODIES[second], 0.1))
    return assembled(kind, number, _MAKERS[kind](_Style(rng, body, trim, LABELS[label])))


def _on_lathe(style: _Style, outer: Sequence[tuple[float, float]], low: float, high: float) -> list[Part]:
    """Three labels around a body with outer wall points (radius, height); the first faces the front, -y."""
    radii, heights = zip(*outer, strict=True)
    parts: list[Part] = []
    edges = np.linspace(-45.0, 45.0, _CELLS + 1) - 90.0
    levels = np.linspace(high, low, _CELLS + 1)
    for i, row in enumerate(style.label):
        z = levels[[i + 1, i]]
        r = np.interp(z, heights, radii) + _RELIEF
        for j, cell in enumerate(row):
            ring = arc(edges[j], edges[j + 1], 3)
            grid = np.empty((len(z), len(ring), 3), np.float32)
            grid[:, :, :2] = r[:, None, None] * ring
            grid[:, :, 2] = z[:, None]
            parts.append((_sheet(grid), _DARK if cell == "#" else _LIGHT))
    return [*parts, *_turned(parts, 120.0), *_turned(parts, 240.0)]


def _sheet(grid: np.ndarray[tuple[int, int, int], np.dtype[np.float32]]) -> Mesh:
    """A mesh with two triangles for each cell of a grid (R, C, 3) of points."""
    rows, columns, _ = grid.shape
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = i * columns + j
    faces = np.stack([a, a + 1, a + columns + 1, a, a + columns + 1, a + columns], axis=-1)
    return Mesh(grid.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32))


def _on_front(style: _Style, x: tuple[float, float], z: tuple[float, float], y: float) -> list[Part]:
    """The label on an upright plane that faces -y, within the given ranges of x and z."""
    xs, zs = np.linspace(*x, _CELLS + 1), np.linspace(*z[::-1], _CELLS + 1)
    return [
        (box((xs[j], y - _RELIEF, zs[i + 1]), (xs[j + 1], y, zs[i])), _DARK if cell == "#" else _LIGHT)
        for i, row in enumerate(style.label)
        for j, cell in enumerate(row)
    ]


def _turned(parts: Sequence[Part], angle: float) -> list[Part]:
    """The parts rotated about z by an angle in degrees."""
    return [(turn(mesh, angle), material) for mesh, material in parts]


def _can(style: _Style) -> list[Part]:
    r, h = float(style.rng.uniform(0.031, 0.037)), float(style.rng.uniform(0.11, 0.135))
    outer = ((0.85 * r, 0.0), (r, 0.008), (r, h - 0.01), (0.85 * r, h))
    lid = Material((190.0, 192.0, 196.0))
    return [
        (lathe([(0.0, 0.0), *outer]), style.body),
        (cylinder(0.84 * r, h - 0.004, h + 0.001), lid),
        *_on_lathe(style, outer, 0.015, h - 0.015),
    ]


def _tin(style: _Style) -> list[Part]:
    r, h = float(style.rng.uniform(0.05, 0.06)), float(style.rng.uniform(0.075, 0.095))
    outer = ((r, 0.0), (r, h))
    return [
        (cylinder(r, 0.0, h, segments=24), style.body),
        (cylinder(1.02 * r, h, h + 0.012, segments=24), style.trim),
        *_on_lathe(style, outer, 0.008, h - 0.006),
    ]


def _bottle(style: _Style) -> list[Part]:
    r, h = float(style.rng.uniform(0.034, 0.046)), float(style.rng.uniform(0.24, 0.31))
    neck = 0.36 * r
    outer = ((0.92 * r, 0.0), (r, 0.01), (r, 0.58 * h), (0.8 * r, 0.66 * h), (neck, 0.78 * h), (neck, h))
    return [
        (lathe([(0.0, 0.0), *outer, (0.0, h)]), style.body),
        (cylinder(1.3 * neck, 0.95 * h, 1.02 * h, segments=12), style.trim),
        *_on_lathe(style, outer, 0.14 * h, 0.52 * h),
    ]


def _cup(style: _Style) -> list[Part]:
    r, h = float(style.rng.uniform(0.04, 0.046)), float(style.rng.uniform(0.095, 0.11))
    outer = ((0.88 * r, 0.0), (r, 0.02), (r, h))
    bow = arc(-90, 90, 9)
    side = np.column_stack(
        [r - 0.004 + 0.032 * bow[:, 0], np.zeros(len(bow)), 0.5 * h + 0.32 * h * bow[:, 1]]
    )
    wall = lathe([(0.0, 0.0), *outer, (r - 0.004, h), (r - 0.004, 0.008), (0.0, 0.008)])
    return [(wall, style.body), (tube(side, 0.006), style.body), *_on_lathe(style, outer, 0.025, h - 0.012)]


def _vase(style: _Style) -> list[Part]:
    outer = vessels.profile(style.rng, float(style.rng.uniform(0.0, 0.14)))
    scale = float(style.rng.uniform(0.2, 0.28))
    scaled = [(r * scale * 0.7, z * scale) for r, z in outer]
    inner = [(r - 0.006, z) for r, z in reversed(scaled) if z > 0.02]
    return [
        (lathe([(0.0, 0.0), *scaled, *inner, (0.0, 0.02)]), style.body),
        *_on_lathe(style, scaled, 0.18 * scale, 0.66 * scale),
    ]


def _bowl(style: _Style) -> list[Part]:
    r, h = float(style.rng.uniform(0.08, 0.105)), float(style.rng.uniform(0.075, 0.09))
    outer = ((0.45 * r, 0.0), (0.72 * r, 0.3 * h), (0.9 * r, 0.6 * h), (r, h))
    inner = [(x - 0.005, z + 0.004) for x, z in reversed(outer[:-1])]
    return [
        (lathe([(0.0, 0.0), *outer, (r - 0.005, h), *inner, (0.0, 0.004)]), style.body),
        *_on_lathe(style, outer, 0.12 * h, 0.92 * h),
    ]


def _packet(width: float, depth: float, height: float) -> Callable[[_Style], list[Part]]:
    """A maker of boxes of about that size, with a coloured band at the top and labels on four sides."""

    def make(style: _Style) -> list[Part]:
        w, d, h = (float(x * style.rng.uniform(0.9, 1.1)) for x in (width, depth, height))
        front, side = (
            _on_front(style, (-0.4 * x, 0.4 * x), (0.1 * h, 0.75 * h), -y / 2) for x, y in ((w, d), (d, w))
        )
        return [
            (slab(w, d, 0.85 * h), style.body),
            (slab(w, d, 0.15 * h, at=(0.0, 0.0, 0.85 * h)), style.trim),
            *front,
            *_turned(front, 180.0),
            *_turned(side, 90.0),
            *_turned(side, -90.0),
        ]

    return make


def _book(style: _Style) -> list[Part]:
    """A standing book with a label on both covers."""
    w, d, h = (float(style.rng.uniform(*x)) for x in ((0.14, 0.17), (0.03, 0.045), (0.2, 0.24)))
    pages = Material((226.0, 220.0, 200.0))
    front = _on_front(style, (-0.38 * w, 0.38 * w), (0.35 * h, 0.9 * h), -d / 2)
    return [
        (slab(w - 0.006, d - 0.006, h - 0.006, at=(0.003, 0.0, 0.003)), pages),
        (box((-w / 2, -d / 2, 0.0), (w / 2, -d / 2 + 0.003, h)), style.body),
        (box((-w / 2, d / 2 - 0.003, 0.0), (w / 2, d / 2, h)), style.body),
        (box((-w / 2 - 0.002, -d / 2, 0.0), (-w / 2 + 0.002, d / 2, h)), style.trim),
        *front,
        *_turned(front, 180.0),
    ]


def _radio(style: _Style) -> list[Part]:
    """A radio with a loudspeaker to the left of the label, a handle on top and a label on the back."""
    w, d, h = (float(style.rng.uniform(*x)) for x in ((0.24, 0.3), (0.08, 0.1), (0.15, 0.18)))
    cone = turn(cylinder(0.36 * h, 0.0, 0.006, segments=24), 90, axis="x")
    front = _on_front(style, (0.04 * w, 0.44 * w), (0.15 * h, 0.85 * h), -d / 2)
    bow = ((-0.3 * w, 0.0, h), (-0.3 * w, 0.0, 1.2 * h), (0.3 * w, 0.0, 1.2 * h), (0.3 * w, 0.0, h))
    return [
        (slab(w, d, h), style.body),
        (shift(cone, (-0.25 * w, -d / 2, 0.5 * h)), _DARK),
        (tube(bow, 0.006), style.trim),
        *front,
        *_turned(front, 180.0),
    ]


def _laptop(style: _Style) -> list[Part]:
    """An open laptop with a label on both sides of the screen."""
    w, lean = float(style.rng.uniform(0.3, 0.34)), float(style.rng.uniform(10, 20))
    d, h = 0.66 * w, 0.62 * w
    label = _on_front(style, (-0.4 * w, 0.4 * w), (0.014 + 0.1 * h, 0.014 + 0.9 * h), -0.004)
    back = d / 2 - 0.004
    screen = [
        (slab(w, 0.008, h, at=(0.0, back, 0.014)), style.body),
        *((shift(mesh, (0.0, back, 0.0)), paint) for mesh, paint in [*label, *_turned(label, 180.0)]),
    ]
    hinge = (0.0, d / 2, 0.014)
    return [
        (slab(w, d, 0.014), style.body),
        (slab(0.88 * w, 0.42 * d, 0.002, at=(0.0, 0.16 * d, 0.014)), _DARK),
        *((turn(mesh, -lean, axis="x", about=hinge), material) for mesh, material in screen),
    ]


_MAKERS: Mapping[str, Callable[[_Style], list[Part]]] = {
    "book": _book,
    "bottle": _bottle,
    "bowl": _bowl,
    "box": _packet(0.19, 0.065, 0.27),
    "can": _can,
    "carton": _packet(0.095, 0.095, 0.2),
    "cup": _cup,
    "laptop": _laptop,
    "radio": _radio,
    "tin": _tin,
    "vase": _vase,
}

KINDS: tuple[str, ...] = tuple(sorted(_MAKERS))
"""The embedded kinds of small objects."""
