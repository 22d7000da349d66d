"""Household objects that look like plain boxes from most sides: clocks, toasters, televisions and others.

Only one or two sides show what they are. Similar classes have bodies from the same distribution, and so have
the look-alikes that are no class in any world: a loudspeaker, a box of tissues, a microwave oven.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms.models import Part
from activelsd.scenery.rooms.textures import Colour, Material, darker
from activelsd.scenery.shapes.solids import arc, box, cylinder, prism, shift, slab, tube, turn

DARK, LIGHT, STEEL = Material((30.0, 30.0, 36.0)), Material((238.0, 236.0, 228.0)), Material((178, 180, 186))

BODIES: tuple[Colour, ...] = (
    (222, 218, 208), (168, 48, 44), (64, 92, 140), (196, 166, 84), (70, 118, 88), (96, 70, 54), (66, 68, 76),
    (204, 126, 60), (140, 168, 182), (150, 100, 140),
)  # fmt: skip
"""Colours shared by all kinds, so that colour says little about the class."""

_CARDBOARD: tuple[Colour, ...] = ((178, 138, 94), (196, 160, 118), (150, 116, 80), (216, 210, 200))
_SCREEN = Material((52.0, 60.0, 74.0))
_PAGES = Material((232.0, 226.0, 208.0))
_DIGITS = ("abcdef", "bc", "abged", "abgcd", "fgbc", "afgcd", "afgedc", "abc", "abcdefg", "abfgcd")
_RELIEF = 0.001  # metres by which prints stand out from the surface


class _Casing(NamedTuple):
    """A body centred at the origin, with its front at y = -depth / 2 and a flat top for |y| < `flat`."""

    width: float
    depth: float
    height: float
    flat: float
    body: Material
    parts: list[Part]


def _casing(rng: np.random.Generator) -> _Casing:
    """A random body of an object for a worktop or a night stand."""
    w, d, h = (float(rng.uniform(*span)) for span in ((0.17, 0.26), (0.11, 0.15), (0.14, 0.19)))
    body = Material(BODIES[rng.integers(len(BODIES))])
    round_by = float(rng.choice((0.0, 0.02, 0.035)))
    edge = round_by * arc(0.0, 90.0, 5)
    inner, top = d / 2 - round_by, h - round_by
    right = np.column_stack([inner + edge[:, 0], top + edge[:, 1]])
    left = (right * (-1, 1))[::-1]
    outline = np.concatenate([[(-d / 2, 0.012), (d / 2, 0.012)], right, left])
    foot = slab(0.9 * w, 0.85 * d, 0.012)
    return _Casing(w, d, h, inner, body, [(prism(outline, -w / 2, w / 2), body), (foot, DARK)])


def _disc(radius: float, x: float, front: float, z: float, out: float) -> Mesh:
    """An upright disc that stands out by `out` from a front."""
    return shift(turn(cylinder(radius, 0.0, out, segments=24), 90, axis="x"), (x, front, z))


def alarm_clock(rng: np.random.Generator) -> list[Part]:
    """A clock with a dial or a digital display on the front, and a button or two bells on top."""
    case = _casing(rng)
    w, h, front = case.width, case.height, -case.depth / 2
    parts = list(case.parts)
    if rng.random() < 0.6:
        r = 0.42 * h
        parts.append((_disc(1.14 * r, 0.0, front, 0.52 * h, 0.004), DARK))
        parts.append((_disc(r, 0.0, front, 0.52 * h, 0.006), LIGHT))
        for length, thick in ((0.6 * r, 0.012), (0.85 * r, 0.008)):
            hand = box((-thick / 2, front - 0.008, 0.0), (thick / 2, front, length))
            turned = turn(hand, float(rng.uniform(0, 360)), axis="y")
            parts.append((shift(turned, (0.0, 0.0, 0.52 * h)), DARK))
    else:
        low, high = 0.28 * h, 0.8 * h
        parts.append((box((-0.43 * w, front - 0.003, low), (0.43 * w, front, high)), DARK))
        for x in (-0.38, -0.19, 0.06, 0.25):
            lit = _DIGITS[rng.integers(len(_DIGITS))]
            parts += _digit(lit, (x * w, front, low + 0.07 * h), 0.13 * w, 0.38 * h)
    if rng.random() < 0.5:
        parts.append((slab(0.3 * w, 1.2 * case.flat, 0.014, at=(0.0, 0.0, h)), STEEL))
    else:
        bells = [shift(cylinder(0.16 * h, 0.0, 0.025, top=0.08 * h), (s * 0.25 * w, 0.0, h)) for s in (-1, 1)]
        parts += [(bell, STEEL) for bell in bells]
    return parts


def _digit(lit: str, at: tuple[float, float, float], wide: float, tall: float) -> list[Part]:
    """The lit segments (letters a-g) of a digit whose lower left corner is at `at` on the front."""
    x, front, z = at
    t = 0.2 * wide
    half = tall / 2
    boxes = {
        "a": (0.0, tall - t, wide, tall), "d": (0.0, 0.0, wide, t),
        "g": (0.0, half - t / 2, wide, half + t / 2),
        "b": (wide - t, half, wide, tall), "c": (wide - t, 0.0, wide, half),
        "e": (0.0, 0.0, t, half), "f": (0.0, half, t, tall),
    }  # fmt: skip
    spans = [boxes[segment] for segment in lit]
    return [(box((x + a, front - 0.005, z + b), (x + c, front, z + d)), LIGHT) for a, b, c, d in spans]


def toaster(rng: np.random.Generator) -> list[Part]:
    """A toaster with two slots in the top and a lever at one end; front and back are plain."""
    case = _casing(rng)
    w, h = case.width, case.height
    side = float(rng.choice((-1.0, 1.0)))
    wide = 0.55 * case.flat
    parts = list(case.parts)
    for y in (-0.5 * case.flat, 0.5 * case.flat):
        rim = slab(0.8 * w, wide + 0.012, 0.003, at=(0.0, y, h))
        parts += [(rim, STEEL), (slab(0.76 * w, wide, 0.004, at=(0.0, y, h)), DARK)]
    if rng.random() < 0.3:  # a slice of bread in a slot
        parts.append((slab(0.5 * w, 0.6 * wide, 0.03, at=(0.0, 0.5 * case.flat, h)), _PAGES))
    slit = slab(0.002, 0.016, 0.6 * h, at=(side * w / 2, 0.0, 0.25 * h))
    lever = slab(0.03, 0.045, 0.018, at=(side * (w / 2 + 0.014), 0.0, float(rng.uniform(0.55, 0.75)) * h))
    dial = shift(turn(cylinder(0.016, 0.0, 0.012), side * 90, axis="y"), (side * w / 2, 0.03, 0.2 * h))
    return [*parts, (slit, DARK), (lever, DARK), (dial, STEEL)]


def loudspeaker(rng: np.random.Generator) -> list[Part]:
    """One or two cones on the front and a strip of buttons on top."""
    case = _casing(rng)
    w, h, front = case.width, case.height, -case.depth / 2
    xs = (-0.24 * w, 0.24 * w) if rng.random() < 0.5 else (0.0,)
    parts = list(case.parts)
    r = min(0.4 * h, 0.22 * w)
    for x in xs:
        for radius, out, material in ((r, 0.004, DARK), (0.6 * r, 0.007, case.body), (0.25 * r, 0.012, DARK)):
            parts.append((_disc(radius, x, front, 0.5 * h, out), material))
    parts.append((slab(0.4 * w, 0.6 * case.flat, 0.008, at=(0.0, 0.0, h)), DARK))
    return parts


def tissue_box(rng: np.random.Generator) -> list[Part]:
    """A box with a slot in the top and usually a tissue in the slot."""
    case = _casing(rng)
    parts = [*case.parts, (slab(0.6 * case.width, 0.8 * case.flat, 0.003, at=(0.0, 0.0, case.height)), DARK)]
    if rng.random() < 0.6:
        sheet = slab(0.3 * case.width, 0.006, 0.05, at=(0.0, 0.0, case.height))
        parts.append((turn(sheet, 12.0, axis="x", about=(0.0, 0.0, case.height)), LIGHT))
    return parts


def _crate(rng: np.random.Generator) -> tuple[float, float, float]:
    """Random width, depth and height of a television, microwave oven or cardboard box."""
    w, d, h = (float(rng.uniform(*span)) for span in ((0.36, 0.5), (0.25, 0.32), (0.27, 0.36)))
    return w, d, h


def television(rng: np.random.Generator) -> list[Part]:
    """A flat screen on a foot, or an old set in a box that is plain on all other sides."""
    shade = Material(BODIES[rng.integers(len(BODIES))]) if rng.random() < 0.35 else Material((58, 58, 64))
    return _old_set(rng, shade) if rng.random() < 0.4 else _flat_screen(rng, shade)


def _old_set(rng: np.random.Generator, shade: Material) -> list[Part]:
    w, d, h = _crate(rng)
    front, right = -d / 2, w / 2 - 0.09
    x = right + 0.045
    parts = [
        (slab(w, d, h), shade),
        (box((-w / 2 + 0.03, front - 0.006, 0.05), (right, front, h - 0.03)), DARK),
        (box((-w / 2 + 0.055, front - 0.01, 0.075), (right - 0.025, front, h - 0.055)), _SCREEN),
        *((_disc(0.022, x, front, k * h, 0.02), STEEL) for k in (0.8, 0.62)),
        (box((x - 0.025, front - 0.003, 0.08), (x + 0.025, front, 0.4 * h)), DARK),
    ]
    if rng.random() < 0.5:
        rod = tube(((0.0, 0.0, h), (0.0, 0.0, h + 0.2)), 0.004)
        parts += [(turn(rod, a, axis="y", about=(0.0, 0.0, h)), STEEL) for a in (-35.0, 35.0)]
    return parts


def _flat_screen(rng: np.random.Generator, shade: Material) -> list[Part]:
    w, t = float(rng.uniform(0.55, 0.8)), float(rng.uniform(0.03, 0.05))
    h, foot = 0.58 * w, float(rng.uniform(0.04, 0.08))
    front = -t / 2
    return [
        (box((-w / 2, front, foot), (w / 2, t / 2, foot + h)), shade),
        (box((-w / 2 + 0.02, front - 0.003, foot + 0.025), (w / 2 - 0.02, front, foot + h - 0.02)), _SCREEN),
        (box((-0.25 * w, t / 2, foot + 0.12 * h), (0.25 * w, t / 2 + 0.03, foot + 0.6 * h)), shade),
        (slab(0.07, 0.025, foot + 0.02), DARK),
        (slab(float(rng.uniform(0.35, 0.6)) * w, 0.2, 0.012), DARK),
    ]


def microwave(rng: np.random.Generator) -> list[Part]:
    """A box with a window, a handle and a keypad on the front, plain on all other sides."""
    w, d, h = _crate(rng)
    front, right = -d / 2, w / 2 - 0.1
    parts = [(slab(w, d, h), Material(((222, 220, 214), (58, 58, 64), (168, 170, 176))[rng.integers(3)]))]
    parts.append((box((-w / 2 + 0.035, front - 0.004, 0.06), (right - 0.05, front, h - 0.05)), DARK))
    parts.append((box((right - 0.025, front - 0.03, 0.06), (right - 0.01, front, h - 0.05)), STEEL))
    for row in range(4):
        for column in range(3):
            x, z = right + 0.012 + 0.026 * column, 0.06 + 0.036 * row
            parts.append((box((x, front - 0.004, z), (x + 0.018, front, z + 0.022)), STEEL))
    parts.append((box((right + 0.012, front - 0.004, h - 0.08), (w / 2 - 0.015, front, h - 0.045)), DARK))
    return parts


def cardboard_box(rng: np.random.Generator) -> list[Part]:
    """A cardboard box, open with its flaps up or down, or closed with tape over the top."""
    w, d, h = (0.85 * side for side in _crate(rng))
    shade = _CARDBOARD[rng.integers(len(_CARDBOARD))]
    paper, dim = Material(shade), Material(darker(shade, 0.45))
    if rng.random() < 0.4:
        tape = Material(darker(shade, -0.25) if rng.random() < 0.5 else darker(shade, 0.35))
        return [
            (slab(w, d, h), paper),
            (slab(w + 0.002, 0.05, 0.002, at=(0.0, 0.0, h)), tape),
            *((slab(0.002, 0.05, 0.3 * h, at=(s * w / 2, 0.0, 0.7 * h)), tape) for s in (-1, 1)),
            (box((-0.35 * w, -d / 2 - _RELIEF, 0.5 * h), (-0.05 * w, -d / 2, 0.8 * h)), LIGHT),
        ]
    t = 0.008
    parts: list[Part] = [
        (slab(w, d, 0.02), paper),
        (slab(w - 0.02, d - 0.02, 0.004, at=(0.0, 0.0, 0.02)), dim),
        *((slab(t, d, h, at=(s * (w - t) / 2, 0.0, 0.0)), paper) for s in (-1, 1)),
        *((slab(w, t, h, at=(0.0, s * (d - t) / 2, 0.0)), paper) for s in (-1, 1)),
    ]
    lean = float(rng.uniform(20, 120))
    for s in (-1, 1):
        flap = slab(t, d, 0.4 * d, at=(s * (w - t) / 2, 0.0, h))
        parts.append((turn(flap, s * lean, axis="y", about=(s * w / 2, 0.0, h)), paper))
        flap = slab(w, t, 0.4 * d, at=(0.0, s * (d - t) / 2, h))
        parts.append(
            (turn(flap, -s * float(rng.uniform(20, 120)), axis="x", about=(0.0, s * d / 2, h)), paper)
        )
    return parts


def lying_book(rng: np.random.Generator) -> list[Part]:
    """A closed book with a title on the cover, or an open book with two printed pages."""
    w, d = (float(rng.uniform(*span)) for span in ((0.16, 0.2), (0.22, 0.28)))
    cover = Material(BODIES[rng.integers(len(BODIES))])
    if rng.random() < 0.5:
        t = float(rng.uniform(0.025, 0.05))
        return [
            (slab(w - 0.01, d - 0.012, t - 0.006, at=(0.004, 0.0, 0.003)), _PAGES),
            (slab(w, d, 0.004), cover),
            (slab(w, d, 0.004, at=(0.0, 0.0, t - 0.004)), cover),
            (slab(0.006, d, t, at=(-w / 2, 0.0, 0.0)), cover),
            (slab(0.7 * w, 0.14 * d, _RELIEF, at=(0.0, 0.22 * d, t)), LIGHT),
            (slab(0.5 * w, 0.06 * d, _RELIEF, at=(0.0, 0.05 * d, t)), LIGHT),
        ]
    parts: list[Part] = [(slab(2 * w, d, 0.004), cover)]
    for s in (-1, 1):
        page: list[Part] = [(slab(w - 0.006, d - 0.012, 0.014, at=(s * w / 2, 0.0, 0.004)), _PAGES)]
        for i in range(6):
            y = (0.36 - 0.14 * i) * d
            short = 0.75 if rng.random() < 0.75 else 0.4
            page.append((slab(short * w, 0.05 * d, _RELIEF, at=(s * w / 2, y, 0.018)), DARK))
        parts += [(turn(mesh, -s * 6.0, axis="y", about=(0.0, 0.0, 0.004)), paint) for mesh, paint in page]
    return parts


def notebook(rng: np.random.Generator) -> list[Part]:
    """An open laptop with keys, a touch pad and windows on its screen; the lid is plain."""
    w, lean = float(rng.uniform(0.3, 0.36)), float(rng.uniform(5, 30))
    d, h = 0.66 * w, 0.62 * w
    shade = Material((58, 58, 64)) if rng.random() < 0.4 else Material(BODIES[rng.integers(len(BODIES))])
    back, t = d / 2, 0.016
    lit = LIGHT if rng.random() < 0.5 else Material((120, 140, 168))
    lid: list[Part] = [
        (box((-w / 2, back - 0.01, t), (w / 2, back, t + h)), shade),
        (box((-w / 2 + 0.012, back - 0.012, t + 0.015), (w / 2 - 0.012, back - 0.01, t + h - 0.012)), DARK),
    ]
    for _ in range(2):
        x, z = float(rng.uniform(-0.42, 0.0)) * w, t + float(rng.uniform(0.1, 0.4)) * h
        lid.append((box((x, back - 0.014, z), (x + 0.4 * w, back - 0.012, z + 0.45 * h)), lit))
    rows, columns, wide = 4, 10, 0.88 * w / 10
    keys = [
        slab(0.75 * wide, 0.07 * d, 0.004, at=((j - 4.5) * wide, (0.36 - 0.12 * i) * d, t))
        for i in range(rows)
        for j in range(columns)
    ]
    return [
        (slab(w, d, t), shade),
        (slab(0.3 * w, 0.24 * d, 0.002, at=(0.0, -0.3 * d, t)), STEEL),
        *((key, DARK) for key in keys),
        *((turn(mesh, -lean, axis="x", about=(0.0, back, t)), paint) for mesh, paint in lid),
    ]


def picture_frame(rng: np.random.Generator) -> list[Part]:
    """A leaning panel like a laptop's screen, with a picture in front and a strut behind."""
    w, h = float(rng.uniform(0.22, 0.34)), float(rng.uniform(0.2, 0.26))
    frame = Material(BODIES[rng.integers(len(BODIES))])
    split = float(rng.uniform(0.35, 0.6)) * h
    parts: list[Part] = [
        (slab(w, 0.012, h), frame),
        (box((-w / 2 + 0.025, -0.008, 0.025), (w / 2 - 0.025, 0.0, split)), Material((92, 110, 78))),
        (box((-w / 2 + 0.025, -0.008, split), (w / 2 - 0.025, 0.0, h - 0.025)), Material((190, 206, 220))),
    ]
    leaning: list[Part] = [(turn(mesh, -15.0, axis="x"), paint) for mesh, paint in parts]
    return [*leaning, (slab(0.05, 0.09, 0.01, at=(0.0, 0.06, 0.0)), frame)]


MAKERS: Mapping[str, Callable[[np.random.Generator], list[Part]]] = {
    "alarm_clock": alarm_clock,
    "cardboard_box": cardboard_box,
    "loudspeaker": loudspeaker,
    "lying_book": lying_book,
    "microwave": microwave,
    "notebook": notebook,
    "picture_frame": picture_frame,
    "television": television,
    "tissue_box": tissue_box,
    "toaster": toaster,
}
"""The function that makes the parts of each kind, with the front towards -y."""
