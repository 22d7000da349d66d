"""Fonts for pictures with names in any script."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from functools import lru_cache

_LOG = logging.getLogger("activelsd")

OWN = "DejaVu Sans"
"""matplotlib brings it along."""

_LIKELY = ("cjk", "noto sans", "wenquanyi", "yahei", "simhei", "pingfang", "hiragino", "unicode", "unifont")
"""Parts of the names of fonts with many letters, which are tried first."""


def choose_fonts(names: Iterable[str]) -> tuple[list[str], frozenset[str]]:
    """Returns font families that together have the letters of all names, and the letters that none has."""
    from matplotlib.font_manager import findfont, fontManager

    missing = {letter for name in names for letter in name if not letter.isspace()} - _letters(findfont(OWN))
    families = [OWN]
    fonts = {one.name: one.fname for one in fontManager.ttflist} if missing else {}
    for family in sorted(fonts, key=lambda name: (not any(word in name.lower() for word in _LIKELY), name)):
        found = missing & _letters(fonts[family])
        if found:
            families.append(family)
            missing -= found
        if not missing:
            break
    return families, frozenset(missing)


def names_to_draw(names: Sequence[str], missing: frozenset[str], kind: str) -> dict[str, str]:
    """Returns each name as a picture can show it: a number stands for one with letters that no font has."""
    numbered = {name: f"{kind} {i}" for i, name in enumerate(names, 1) if missing & set(name)}
    if numbered:
        legend = ", ".join(f"{number} is {name}" for name, number in numbered.items())
        _LOG.warning("No font here has all letters of these names, so the picture numbers them: %s.", legend)
    return {name: numbered.get(name, name) for name in names}


@lru_cache(maxsize=256)
def _letters(file: str) -> frozenset[str]:
    """The letters of a font; none if it cannot be read."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(map(chr, FT2Font(file).get_charmap()))
    except (OSError, RuntimeError):
        return frozenset()
