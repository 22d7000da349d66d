"""Sentences for settings that are not right: which one, why, and the nearest right one."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import get_args

from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from activelsd.errors import did_you_mean

_WANTED = {
    "bool_parsing": "true or false",
    "finite_number": "a finite number",
    "float_parsing": "a number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "list_type": "a list, as in [a,b]",
    "string_pattern_mismatch": "letters, digits and . _ + - only",
    "string_type": "text",
    "tuple_type": "a list, as in [a,b]",
}
"""What each of pydantic's complaints asks for; its own words stand for the others."""


def unknown_key(
    key: str, place: str, world: str, known: Mapping[str, FieldInfo], elsewhere: Mapping[str, Iterable[str]]
) -> str:
    """What to say of a key that a world's settings do not have.

    Args:
        key: the dotted key.
        place: the file it stands in, as ` (in FILE)`, or nothing.
        world: the run's world.
        known: the settings of that world.
        elsewhere: per other world its keys.
    """
    for other, keys in elsewhere.items():
        if key in keys:
            return f"{key} is a setting of the world {other}, and this run's world is {world}{place}."
    inside = [name for name in known if name.startswith(f"{key}.")]
    if inside:
        return f"{key} is a group of settings{place}; set one of {', '.join(inside)}."
    tops = {name.partition(".")[0] for name in known}
    # The right name in the wrong place, as in gamma=0.9 or env.gamma=0.9, is nearer than any other.
    meant = [name for name in known if name.rpartition(".")[2] == key.rpartition(".")[2]]
    hint = f"did you mean {meant[0]}?" if len(meant) == 1 else ""
    hint = hint or did_you_mean(key, [*known, *sorted(tops), "experiment"], "--dry-run lists all there are.")
    return f"{key} is not a setting{place}; {hint}"


def refused_value(key: str, value: object, place: str, field: FieldInfo, error: ErrorDetails) -> str:
    """What to say of a value that the schema does not take."""
    choices = [str(choice) for choice in get_args(field.annotation)]
    if error["type"] == "literal_error":
        hint = did_you_mean(str(value), choices, "")
        return f"{key}={value}{place}: must be {error['ctx']['expected']}" + (f"; {hint}" if hint else ".")
    wanted = _WANTED.get(error["type"]) or re.sub(r"^\w+ should (be|have) ", "", error["msg"])
    if error["type"] == "too_short":
        wanted = f"a list of at least {error['ctx']['min_length']}"
    wanted = wanted.replace("greater than or equal to", "at least").replace(
        "less than or equal to", "at most"
    )
    if type(None) in get_args(field.annotation):
        wanted += ", or null"
    return f"{key}={value}{place}: must be {wanted}."
