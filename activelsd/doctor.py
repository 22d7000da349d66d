"""Reports on this machine: package versions, CPU cores, GPU, cache folder, AI2-THOR and the newest run."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import torch

from activelsd import registry
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
from activelsd.features import recorded_size
from activelsd.train.run import Run


class Finding(NamedTuple):
    """One line of the report; `good` is False if something must be fixed."""

    what: str
    state: str
    good: bool = True


def examine(runs: Path) -> Iterator[Finding]:
    """Checks everything that the package depends on.

    Args:
        runs: folder of the runs.
    """
    yield Finding("python", f"{platform.python_version()} on {platform.platform()}")
    yield from _packages()
    yield Finding("cores", str(cores()))
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "no CUDA device, the CPU is used"
    yield Finding("device", f"{gpu}; {torch.get_num_threads()} PyTorch threads")
    yield from _parts()
    yield _cache(default_cache())
    yield from _pretrained()
    yield from _thor()
    try:
        yield Finding("newest run", str(Run.newest(runs).folder))
    except RunError:
        yield Finding("newest run", f"none in ./{runs}")


def _packages() -> Iterator[Finding]:
    """Yields the installed version of every required package."""
    try:
        required = [line for line in requires("activelsd") or [] if "extra ==" not in line]
        yield Finding("activelsd", version("activelsd"))
    except PackageNotFoundError:
        yield Finding(
            "activelsd", "not installed; run from its folder: pip install -c constraints.txt -e .", False
        )
        return
    for line in sorted(required):
        name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
        try:
            yield Finding(name, version(name))
        except PackageNotFoundError:
            yield Finding(name, f"missing; install it with: pip install '{line}'", False)


def _parts() -> Iterator[Finding]:
    """The parts that other packages bring."""
    for kind in registry.ALL:
        for name in kind.installed():
            what = f"{kind.kind} {name}"
            if name in kind.own():
                yield Finding(what, "another package's has no effect, since activelsd has its own", False)
                continue
            try:
                kind.get(name)
                yield Finding(what, " ".join(kind.package(name) or ("an unknown package",)))
            except ConfigError as error:
                yield Finding(what, str(error), False)


def _cache(folder: Path) -> Finding:
    """Whether the cache folder, or its nearest existing parent, is writable; leaves no file behind."""
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        return Finding("cache", f"{folder} is not writable ({error.strerror}); set ACTIVELSD_CACHE", False)
    return Finding("cache", f"{folder}, writable")


def _pretrained() -> Iterator[Finding]:
    """Yields what pretrained trunks need, which is optional, and what is kept for them."""
    try:
        yield Finding("timm", version("timm"))
    except PackageNotFoundError:
        yield Finding("timm", "not installed; only pretrained trunks need it: pip install 'activelsd[timm]'")
        return
    missing = [name for name in ("onnxruntime", "onnxscript") if find_spec(name) is None]
    if missing:
        way_out = "pretrained trunks need it on a CPU: pip install 'activelsd[timm]'"
        yield Finding(missing[0], f"missing; {way_out}", False)
    files, size = recorded_size(default_cache())
    yield Finding("features", f"{files} files of {size / 1e6:.0f} MB in all in the cache")


def _thor() -> Iterator[Finding]:
    """Yields what is installed of AI2-THOR, which is optional."""
    try:
        build = find_build(choose_platform())
    except ConfigError:
        yield Finding("AI2-THOR", f"not installed; only its own rooms need it: {INSTALL}")
        return
    yield Finding("AI2-THOR", version("ai2thor"))
    missing = f"not downloaded (800 MB); download it with: {download_command(choose_platform())}"
    yield Finding("AI2-THOR build", missing if build is None else str(build))
    display = os.environ.get("DISPLAY") or "no DISPLAY"
    yield Finding("AI2-THOR display", f"{display}, {'Vulkan' if has_vulkan() else 'no Vulkan'}")
