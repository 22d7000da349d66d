"""Errors whose message is meant for the user: one sentence, what is wrong and the way out."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class ActiveLSDError(Exception):
    """Root of every error this package raises on purpose; the command line exits with `exit_code`."""

    exit_code = 1


class UserError(ActiveLSDError):
    """Raised when the mistake is the user's: a wrong setting, path or file. Exit code 2."""

    exit_code = 2


class ConfigError(UserError):
    """Raised when a setting's name or value is not one the schema knows."""


class DataError(UserError):
    """Raised when a dataset, mesh, cache or recording is missing, empty, truncated or foreign."""


class RunError(UserError):
    """Raised when a run folder or checkpoint is missing, incomplete or does not fit the world."""


class TrainingError(ActiveLSDError):
    """Raised when training cannot go on, for example because the loss is no longer finite."""


class SimulatorLost(ActiveLSDError):
    """Raised when a simulator died, hung or talked nonsense; nothing is left, and a reset starts another."""


class SimulatorError(ActiveLSDError):
    """Raised when a simulator was lost so often that starting it once more makes no sense."""


def did_you_mean(word: str, known: Iterable[str], otherwise: str | None = None) -> str:
    """The end of a sentence about an unknown word: the nearest right one, else `otherwise` or them all."""
    names = list(known)
    near = get_close_matches(word, names, 1)
    if near:
        return f"did you mean {near[0]}?"
    return f"there are {', '.join(names)}." if otherwise is None else otherwise
