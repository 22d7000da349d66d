"""Finds scans in a folder of the Active Vision Dataset, or makes sample scans on first use."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from activelsd.envs.avd.scan import ANNOTATIONS, PHOTOGRAPHS, check_release
from activelsd.envs.avd.settings import SAMPLE_NOTE, ScansSettings
from activelsd.envs.avd.splits import PUBLISHED, TEST_SCANS
from activelsd.envs.cache import alone, writing
from activelsd.envs.digest import code_digest
from activelsd.envs.settings import Progress
from activelsd.errors import DataError

ARCHIVES = frozenset({".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".rar"})
"""Endings of what scans may be packed in."""

_NAME = re.compile(r"[A-Za-z]+_\d+_\d+")


def scans_in(root: Path) -> dict[str, Path]:
    """The scan folders of a root by name, in order of name.

    Raises:
        DataError: there is no scan, or only scans of the older release.
    """
    if root.is_file():
        raise DataError(
            f"{root} is no folder; unpack it and give the folder that holds Home_001_1 and so on."
        )
    if not root.exists():
        raise DataError(f"There is no dataset at {root}; check env.dataset.path.")
    folders = _folders(root)
    found = {path.name: path for path in folders if _is_scan(path)}
    if not found:
        for path in folders:
            check_release(path)
        raise DataError(_no_scan(root, folders))
    for name in found:
        if not _NAME.fullmatch(name):
            raise DataError(
                f"{found[name]} is a scan whose name does not say its home; name it by place and scan, as in"
                " Home_001_1, or move it away."
            )
    return found


def _folders(root: Path) -> list[Path]:
    try:
        return sorted(path for path in root.iterdir() if path.is_dir() and path.name[0] != ".")
    except OSError as error:
        raise DataError(
            f"{root} cannot be read ({error.strerror or error}); mend or copy it again."
        ) from None


def _no_scan(root: Path, folders: Sequence[Path]) -> str:
    """What there is in place of scans, and the way to them."""
    if _is_scan(root):
        return f"{root} is a scan itself; give the folder that holds it, {root.parent}."
    for folder in folders:
        if any(map(_is_scan, _folders(folder))):
            return f"{root} holds no scan itself, but {folder} does; give that folder."
    for file in sorted(root.iterdir()):
        if file.suffix.lower() in ARCHIVES:
            return f"{root} holds no scan, but the archive {file.name}; unpack it there."
    return (
        f"{root} holds no scan of the Active Vision Dataset; give the folder that holds Home_001_1 and so on,"
        f" each with {PHOTOGRAPHS}/ and {ANNOTATIONS}."
    )


def _is_scan(folder: Path) -> bool:
    return (folder / PHOTOGRAPHS).is_dir() or (folder / ANNOTATIONS).exists()


def is_sample(path: Path | None) -> bool:
    """Whether the scans at a path were rendered here; without a path they will be."""
    return path is None or (path / SAMPLE_NOTE).exists()


def sample_scans(settings: ScansSettings, cache: Path, *, progress: Progress | None = None) -> Path:
    """The folder of sample scans in a cache, made unless they are there.

    Its name carries a digest of its scans and of the code that draws them, so a change makes another. If
    another process is making them, this one waits for it.

    Args:
        settings: which scans; a published split asks for all of its own.
        cache: folder for the samples.
        progress: called with what is done and what there is in all.
    """
    # Real scans do not need rooms and embree.
    from activelsd.envs.avd.homes import DEFAULT_SCANS
    from activelsd.envs.avd.writer import write_sample

    width, height, seed = settings.width, settings.height, settings.seed
    names = settings.scans or (PUBLISHED if settings.split in TEST_SCANS else DEFAULT_SCANS)
    made_by = code_digest("activelsd.envs.avd.writer")
    digest = hashlib.sha256(" ".join([*names, made_by]).encode()).hexdigest()[:8]
    root = cache / f"avd-sample-{width}x{height}-seed{seed}-{digest}"
    if root.is_dir():
        return root
    with alone(root):
        if root.is_dir():  # another process has made it meanwhile
            return root
        # It gets its own name when it is whole; the writer goes on with what an interruption leaves.
        partial = root.with_name(root.name + ".partial")
        write_sample(partial, scans=names, width=width, height=height, seed=seed, progress=progress)
        with writing(cache):
            partial.rename(root)
    return root
