"""Living-room objects that have the body of a cabinet but are none: piano, mantel, radio."""

from __future__ import annotations

import numpy as np

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.shapes.cabinets import case, closed, knob, pull
from activelsd.scenery.shapes.solids import box, cylinder, join, lathe, shift, slab, tube, turn


def piano(rng: np.random.Generator) -> Mesh:
    """An upright piano with its keys on a ledge along the front, supported by two legs."""
    shell = case(rng, 0.95, 1.5)
    w, front = shell.width, shell.front
    tall = shell.top - shell.bottom
    ledge = shell.bottom + tall * float(rng.uniform(0.45, 0.58))
    reach = float(rng.uniform(0.16, 0.24)) * tall + 0.03
    parts = [*shell.parts, closed(shell)]
    parts.append(box((-w / 2, front - reach, ledge - 0.06), (w / 2, front, ledge)))
    cheek = 0.06 * w
    for sign in (-1, 1):
        x = sign * (w / 2 - cheek / 2)
        parts.append(slab(cheek, reach, 0.07, at=(x, front - reach / 2, ledge)))
        parts.append(slab(cheek, cheek, ledge - 0.06, at=(x, front - reach + cheek / 2, 0.0)))
    keys = int(rng.integers(12, 19))
    pitch = (w - 2 * cheek) / keys
    for i in range(keys):
        x = -w / 2 + cheek + i * pitch
        parts.append(box((x + 0.004, front - reach + 0.01, ledge), (x + pitch - 0.004, front, ledge + 0.02)))
        if i % 7 in (0, 1, 3, 4, 5) and i + 1 < keys:  # a black key is between this key and the next
            a = x + 0.7 * pitch
            parts.append(box((a, front - 0.55 * reach, ledge + 0.02), (a + 0.6 * pitch, front, ledge + 0.05)))
    desk = box((-0.3 * w, front - 0.03, ledge + 0.1), (0.3 * w, front, ledge + 0.1 + 0.25 * tall))
    parts.append(turn(desk, -float(rng.uniform(5, 18)), axis="x", about=(0, front, ledge + 0.1)))
    if rng.random() < 0.6:
        panel = shell.bottom + 0.06
        parts.append(box((-0.38 * w, front - 0.025, panel), (0.38 * w, front, ledge - 0.12)))
    return join(parts)


def mantel(rng: np.random.Generator) -> Mesh:
    """A fireplace: an opening between two columns under a shelf."""
    shell = case(rng, 1.0, 1.6, deep=0.95)
    w, d, z0, z1 = shell.width / 2, shell.depth / 2, shell.bottom, shell.top
    half = w * float(rng.uniform(0.45, 0.62))
    lintel = z0 + (z1 - z0) * float(rng.uniform(0.55, 0.72))
    parts = [
        *shell.parts,
        box((-w, -d, z0), (-half, d, z1)),
        box((half, -d, z0), (w, d, z1)),
        box((-half, -d, lintel), (half, d, z1)),
        box((-half, d - 0.03, z0), (half, d, lintel)),
        box((-half, -d, z0), (half, d, z0 + 0.02)),
    ]
    hearth = float(rng.uniform(0.05, 0.15))
    parts.append(box((-0.9 * w, -d - hearth, 0.0), (0.9 * w, -d, z0 + 0.03)))
    out = float(rng.uniform(0.03, 0.06))
    for sign in (-1, 1):
        x = sign * (half + w) / 2
        wide = (w - half) * float(rng.uniform(0.45, 0.7))
        if rng.random() < 0.5:
            parts.append(slab(wide, out, z1 - z0 - 0.1, at=(x, -d - out / 2, z0)))
        else:
            parts.append(shift(cylinder(wide / 2, z0, z1 - 0.1, segments=10), (x, -d, 0)))
    parts.append(box((-w, -d - out - 0.03, z1 - 0.09), (w, -d, z1 - 0.03)))
    if rng.random() < 0.6:  # logs on a grate
        for y, z in ((-0.03, 0.05), (0.05, 0.05), (0.01, 0.11)):
            log = turn(cylinder(0.035, -0.6 * half, 0.6 * half, segments=7), 90, axis="y")
            parts.append(shift(log, (0, y, z0 + z)))
    return join(parts)


def radio(rng: np.random.Generator) -> Mesh:
    """A radio with one or two round loudspeakers, a dial and a row of knobs."""
    shell = case(rng, 1.1, 2.1)
    w, front, z0, z1 = shell.width, shell.front, shell.bottom, shell.top
    tall = z1 - z0
    parts = [*shell.parts, closed(shell)]
    radius = min(0.36 * tall, 0.2 * w) * float(rng.uniform(0.85, 1.0))
    stereo = rng.random() < 0.5
    side = -1 if rng.random() < 0.5 else 1
    centres = (-0.29 * w, 0.29 * w) if stereo else (side * 0.24 * w,)
    for x in centres:
        cone = lathe(
            ((radius, 0.0), (radius, 0.035), (0.82 * radius, 0.035), (0.3 * radius, 0.008), (0.0, 0.03)), 18
        )
        parts.append(shift(turn(cone, 90, axis="x"), (x, front, z0 + 0.48 * tall)))
    x0, x1 = (-0.11 * w, 0.11 * w) if stereo else sorted((-side * 0.04 * w, -side * 0.42 * w))
    parts.append(box((x0, front - 0.02, z0 + 0.62 * tall), (x1, front, z0 + 0.86 * tall)))
    parts.append(pull((x0 + x1) / 2, front - 0.005, z0 + 0.74 * tall, 0.7 * (x1 - x0)))
    knobs = 2 if stereo else int(rng.integers(2, 4))
    for i in range(knobs):
        x = x0 + (i + 0.5) * (x1 - x0) / knobs
        parts.append(knob(x, front, z0 + 0.3 * tall, min(0.09 * tall, 0.4 * (x1 - x0) / knobs)))
    if rng.random() < 0.2:  # an antenna
        aerial = tube(((0.0, 0.0, 0.0), (0.0, 0.0, float(rng.uniform(0.4, 0.7)))), 0.012)
        leaning = turn(aerial, float(rng.uniform(-40, 40)), axis="y")
        parts.append(shift(leaning, (side * 0.4 * w, shell.depth / 2 - 0.04, z1)))
    return join(parts)
