"""Errors for the user; the message is one sentence that says what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches


class ActiveLSDError(Exception):
    """Base class of the errors this package raises on purpose; the command line exits with `exit_code`."""

    exit_code = 1


class UserError(ActiveLSDError):
    """Raised when the user can fix the cause: a wrong setting, path or file. Exit code 2."""

    exit_code = 2


class ConfigError(UserError):
    """Raised when a setting has an unknown name or an invalid value."""


class DataError(UserError):
    """Raised when a dataset, mesh, cache or recording is missing, empty, truncated or in another format."""


class CacheError(DataError):
    """Raised when the cache cannot be written: what is wrong is not the data."""


class RunError(UserError):
    """Raised when a run folder or checkpoint is missing, incomplete or does not fit the world."""


class TrainingError(ActiveLSDError):
    """Raised when training cannot continue, for example because the loss is no longer finite."""


class SimulatorLost(ActiveLSDError):
    """Raised when a simulator died, hung or sent invalid data; it is closed, a reset starts a new one."""


class SimulatorError(ActiveLSDError):
    """Raised when a simulator was lost so often that it is not started again."""


def listed(sentences: Sequence[str], most: int = 20) -> str:
    """A line for each of the first sentences, and one for how many more there are."""
    lines = [f"  {sentence}" for sentence in sentences[:most]]
    more = len(sentences) - len(lines)
    return "\n".join([*lines, f"  and {more} more"] if more else lines)


def some(names: Sequence[str], most: int = 4) -> str:
    """The first few names, and how many more there are, for a sentence."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def did_you_mean(word: str, known: Iterable[str], otherwise: str | None = None) -> str:
    """The end of a sentence about an unknown word: the closest known word, else `otherwise` or all words."""
    names = list(known)
    near = get_close_matches(word, names, 1)
    if near:
        return f"did you mean {near[0]}?"
    return f"there are {', '.join(names)}." if otherwise is None else otherwise
