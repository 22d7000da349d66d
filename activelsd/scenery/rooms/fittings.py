"""Fittings of kitchens and bathrooms, and a library with these and the other furniture.

As for other furniture, units are metres and the front faces -y.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping

import numpy as np

from activelsd.scenery.rooms.casings import DARK, STEEL
from activelsd.scenery.rooms.library import Embedded
from activelsd.scenery.rooms.models import Model, Part, assembled
from activelsd.scenery.rooms.textures import Colour, Material, darker
from activelsd.scenery.shapes.cabinets import doors, drawers, grip
from activelsd.scenery.shapes.solids import box, cylinder, lathe, prism, shift, slab, tube

_CERAMIC = Material((236.0, 236.0, 232.0))
_FRONTS: tuple[Colour, ...] = (
    (226, 224, 216),
    (150, 104, 62),
    (104, 122, 128),
    (196, 158, 108),
    (122, 134, 112),
)
_TOPS: tuple[Colour, ...] = ((72, 70, 70), (198, 192, 182), (168, 128, 84), (132, 130, 128))


def _unit(rng: np.random.Generator, width: float, depth: float, height: float) -> list[Part]:
    """A cupboard with doors or drawers and a worktop."""
    front = Material(_FRONTS[rng.integers(len(_FRONTS))])
    lower, under = 0.08, height - 0.04
    area = (-width / 2 + 0.01, width / 2 - 0.01, lower, under)
    count = max(1, round(width / 0.5))
    if rng.random() < 0.3:
        faces = drawers(grip(rng), -depth / 2, area, 3, count)
    else:
        faces = doors(rng, -depth / 2, area, count)
    shade = _TOPS[rng.integers(len(_TOPS))]
    top = Material(shade, darker(shade, 0.12), "grain", 0.05) if rng.random() < 0.5 else Material(shade)
    return [
        (slab(width - 0.02, depth - 0.1, lower), DARK),
        (slab(width, depth, under - lower, at=(0.0, 0.0, lower)), front),
        *((mesh, front if np.ptp(mesh.vertices, axis=0)[[0, 2]].min() > 0.06 else STEEL) for mesh in faces),
        (slab(width + 0.02, depth + 0.05, height - under, at=(0.0, 0.0, under)), top),
    ]


def _tap(at: tuple[float, float, float]) -> list[Part]:
    bow = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.16), (0.0, -0.05, 0.21), (0.0, -0.13, 0.2), (0.0, -0.14, 0.16))
    return [(shift(tube(bow, 0.012), at), STEEL)]


def counter(rng: np.random.Generator) -> list[Part]:
    """A kitchen worktop over cupboards, sometimes with a sink."""
    w, d, h = float(rng.uniform(1.1, 1.8)), 0.56, float(rng.uniform(0.86, 0.92))
    parts = _unit(rng, w, d, h)
    if rng.random() < 0.5:
        x = float(rng.choice((-1.0, 1.0))) * (w / 2 - 0.32)
        parts.append((slab(0.46, 0.38, 0.004, at=(x, -0.02, h)), STEEL))
        parts.append((slab(0.4, 0.32, 0.005, at=(x, -0.02, h)), Material((104.0, 106.0, 112.0))))
        parts += _tap((x, 0.2, h))
    return parts


def stove(rng: np.random.Generator) -> list[Part]:
    """Four hotplates over an oven with a window in its door."""
    w, d, h = 0.6, 0.58, float(rng.uniform(0.86, 0.92))
    body = Material(((228, 228, 224), (64, 66, 70), (170, 172, 176))[rng.integers(3)])
    parts: list[Part] = [(slab(w, d, h), body)]
    parts.append((box((-0.22, -d / 2 - 0.012, 0.3), (0.22, -d / 2, 0.58)), DARK))
    parts.append((box((-0.24, -d / 2 - 0.045, 0.64), (0.24, -d / 2 - 0.02, 0.665)), STEEL))
    for i in range(4):
        knob = box((-0.21 + 0.12 * i, -d / 2 - 0.025, h - 0.12), (-0.15 + 0.12 * i, -d / 2, h - 0.06))
        parts.append((knob, DARK))
    plates = [(a * 0.14, b * 0.13) for a in (-1, 1) for b in (-1, 1)]
    return [
        *parts,
        *((shift(cylinder(0.095, h, h + 0.006, segments=24), (x, y, 0)), DARK) for x, y in plates),
    ]


def fridge(rng: np.random.Generator) -> list[Part]:
    """A fridge with two doors, one above the other, and handles on one side."""
    w, d, h = float(rng.uniform(0.58, 0.68)), 0.6, float(rng.uniform(1.5, 1.75))
    body = Material(((232, 232, 228), (176, 178, 182), (196, 84, 70))[rng.integers(3)])
    front, split = -d / 2, float(rng.uniform(0.35, 0.65)) * h
    x = float(rng.choice((-1.0, 1.0))) * (w / 2 - 0.05)
    parts: list[Part] = [
        (slab(w, d, h - 0.03, at=(0.0, 0.0, 0.03)), body),
        (slab(w - 0.04, d - 0.06, 0.03), DARK),
    ]
    for low, high in ((0.05, split), (split + 0.012, h - 0.01)):
        parts.append((box((-w / 2, front - 0.04, low), (w / 2, front - 0.006, high)), body))
        parts.append(
            (box((x - 0.012, front - 0.08, high - 0.4), (x + 0.012, front - 0.04, high - 0.08)), STEEL)
        )
    return parts


def basin(rng: np.random.Generator) -> list[Part]:
    """A cupboard with a washbasin on one side of the top and a tap behind it."""
    w, d, h = float(rng.uniform(0.85, 1.2)), 0.46, float(rng.uniform(0.74, 0.8))
    x = float(rng.choice((-1.0, 1.0))) * (w / 2 - 0.24)
    outer = ((0.1, h), (0.17, h + 0.03), (0.2, h + 0.11), (0.19, h + 0.11), (0.16, h + 0.04), (0.0, h + 0.02))
    bowl = shift(lathe(((0.0, h), *outer), 32), (x, -0.02, 0.0))
    return [*_unit(rng, w, d, h), (bowl, _CERAMIC), *_tap((x, 0.2, h))]


def bathtub(rng: np.random.Generator) -> list[Part]:
    """A bathtub of four walls and a floor, with a tap at the back."""
    w, d, h, t = (
        float(rng.uniform(1.5, 1.7)),
        float(rng.uniform(0.7, 0.76)),
        float(rng.uniform(0.5, 0.56)),
        0.09,
    )
    skin = _CERAMIC if rng.random() < 0.6 else Material(_FRONTS[rng.integers(len(_FRONTS))])
    shell = [
        box((-w / 2, -d / 2, 0.0), (-w / 2 + t, d / 2, h)),
        box((w / 2 - t, -d / 2, 0.0), (w / 2, d / 2, h)),
        box((-w / 2, -d / 2, 0.0), (w / 2, -d / 2 + t, h)),
        box((-w / 2, d / 2 - t, 0.0), (w / 2, d / 2, h)),
    ]
    floor = slab(w - t, d - t, 0.14)
    return [*((mesh, skin) for mesh in shell), (floor, _CERAMIC), *_tap((0.0, d / 2 - 0.04, h))]


def toilet(rng: np.random.Generator) -> list[Part]:
    """A toilet with a closed lid in front of a cistern."""
    w, seat, top = 0.38, float(rng.uniform(0.4, 0.44)), float(rng.uniform(0.74, 0.8))
    lid = Material(((240, 240, 236), (120, 84, 58), (64, 66, 72))[rng.integers(3)])
    foot = ((-0.2, 0.0), (0.1, 0.0), (0.1, seat), (-0.32, seat), (-0.3, 0.75 * seat))
    return [
        (prism(foot, -0.14, 0.14), _CERAMIC),
        (shift(cylinder(0.19, seat, seat + 0.03, segments=24), (0.0, -0.15, 0.0)), lid),
        (box((-0.19, -0.15, seat), (0.19, 0.1, seat + 0.03)), lid),
        (box((-w / 2, 0.12, 0.36), (w / 2, 0.32, top)), _CERAMIC),
        (box((-w / 2 - 0.008, 0.1, top), (w / 2 + 0.008, 0.33, top + 0.025)), _CERAMIC),
    ]


_MAKERS: Mapping[str, Callable[[np.random.Generator], list[Part]]] = {
    "basin": basin,
    "bathtub": bathtub,
    "counter": counter,
    "fridge": fridge,
    "stove": stove,
    "toilet": toilet,
}

FITTINGS: tuple[str, ...] = tuple(sorted(_MAKERS))
"""The embedded kinds of fittings."""


class Fitted(Embedded):
    """The embedded furniture and the fittings of kitchens and bathrooms."""

    kinds: tuple[str, ...] = (*Embedded.kinds, *FITTINGS)

    def model(self, kind: str, number: int) -> Model:
        """See `Library`."""
        if kind not in _MAKERS:
            return super().model(kind, number)
        rng = np.random.default_rng((zlib.crc32(kind.encode()), number))
        return assembled(kind, number, _MAKERS[kind](rng))
