"""Errors whose message is meant for the user: one sentence, what is wrong and the way out."""


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
