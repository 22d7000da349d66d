"""The versions of the packages that a run was made with, and a check that those of its parts are here."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from activelsd.errors import ConfigError
from activelsd.registry import ALL, Registry

FILE = "versions.json"
_PARTS = "parts"  # maps "KIND NAME" to "PACKAGE VERSION"


def write_versions(folder: Path, parts: Iterable[tuple[Registry, str]]) -> None:
    """Write the versions of Python, the main packages, and the packages that bring a run's parts."""
    packages = ("activelsd", "torch", "numpy", "gymnasium", "embreex")
    system = {"python": platform.python_version(), "platform": platform.platform()}
    brought = {(kind.kind, name): kind.package(name) for kind, name in parts}
    others = {f"{kind} {name}": " ".join(one) for (kind, name), one in brought.items() if one}
    versions = system | {package: _version(package) for package in packages}
    content = versions | dict(one for one in brought.values() if one) | {_PARTS: others}
    (folder / FILE).write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def check_parts(folder: Path) -> None:
    """Check that the packages are installed here which brought the parts of a run, where that is known.

    Raises:
        ConfigError: one is not.
    """
    kinds = {one.kind: one for one in ALL}
    try:
        parts: dict[str, str] = json.loads((folder / FILE).read_text("utf-8"))[_PARTS]
    except (OSError, ValueError, KeyError, TypeError):
        return
    for part, package in parts.items():
        kind, _, name = part.rpartition(" ")
        if kind in kinds and name not in kinds[kind].names():
            raise ConfigError(
                f"{folder} was made with the {kind} '{name}' of the package {package}, which is not installed"
                f" here; install it with: pip install {package.split()[0]}"
            )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
