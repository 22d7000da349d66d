"""What this machine offers: versions, cores, a GPU, a cache that can be written, AI2-THOR, the newest run."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

import torch

from activelsd.envs.cache import default_cache
from activelsd.envs.cores import cores
from activelsd.envs.thor.installation import (
    INSTALL,
    choose_platform,
    download_command,
    find_build,
    has_vulkan,
)
from activelsd.errors import ConfigError, RunError
from activelsd.train.run import Run


class Finding(NamedTuple):
    """One line of the report."""

    what: str
    state: str
    good: bool = True


def examine(runs: Path) -> Iterator[Finding]:
    """Look at everything the package leans on.

    Args:
        runs: folder of runs.
    """
    yield Finding("python", f"{platform.python_version()} on {platform.platform()}")
    yield from _packages()
    yield Finding("cores", str(cores()))
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "no CUDA device, the CPU is used"
    yield Finding("device", f"{gpu}; {torch.get_num_threads()} threads of PyTorch")
    yield _cache(default_cache())
    yield from _thor()
    try:
        yield Finding("newest run", str(Run.newest(runs).folder))
    except RunError:
        yield Finding("newest run", f"none in ./{runs}")


def _packages() -> Iterator[Finding]:
    """The installed version of every package that this one requires."""
    try:
        wanted = [line for line in requires("activelsd") or [] if "extra ==" not in line]
        yield Finding("activelsd", version("activelsd"))
    except PackageNotFoundError:
        yield Finding(
            "activelsd", "not installed; run from its folder: pip install -c constraints.txt -e .", False
        )
        return
    for line in sorted(wanted):
        name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
        try:
            yield Finding(name, version(name))
        except PackageNotFoundError:
            yield Finding(name, f"missing; install it with: pip install '{line}'", False)


def _cache(folder: Path) -> Finding:
    """Whether the nearest folder there is can be written; nothing is left behind."""
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        return Finding("cache", f"{folder} cannot be written ({error.strerror}); set ACTIVELSD_CACHE", False)
    return Finding("cache", f"{folder}, writable")


def _thor() -> Iterator[Finding]:
    """What there is of AI2-THOR, which is optional."""
    try:
        build = find_build(choose_platform())
    except ConfigError:
        yield Finding("AI2-THOR", f"not installed, and needed only for its own rooms: {INSTALL}")
        return
    yield Finding("AI2-THOR", version("ai2thor"))
    get = f"not downloaded, 800 MB: {download_command(choose_platform())}"
    yield Finding("AI2-THOR build", get if build is None else str(build))
    display = os.environ.get("DISPLAY") or "no DISPLAY"
    yield Finding("AI2-THOR draws on", f"{display}, {'Vulkan' if has_vulkan() else 'no Vulkan'}")
