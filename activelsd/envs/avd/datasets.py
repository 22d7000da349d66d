"""Where scans come from: a folder of the Active Vision Dataset, or sample scans made here on first use."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from activelsd.envs.avd.scan import ANNOTATIONS, PHOTOGRAPHS, check_release
from activelsd.envs.avd.splits import PUBLISHED, TEST_SCANS
from activelsd.envs.cache import alone, writing
from activelsd.errors import DataError

_NAME = re.compile(r"[A-Za-z]+_\d+_\d+")


def scans_in(root: Path) -> dict[str, Path]:
    """The scan folders of a root by name, in order of name.

    Raises:
        DataError: there is none, or only scans of the older release.
    """
    try:
        folders = sorted(path for path in root.iterdir() if path.is_dir() and path.name[0] != ".")
    except OSError as error:
        raise DataError(
            f"{root} cannot be read ({error.strerror or error}); give the folder that holds Home_001_1 and so"
            " on."
        ) from None
    found = {path.name: path for path in folders if _is_scan(path)}
    if not found:
        for path in folders:
            check_release(path)
        raise DataError(
            f"{root} holds no scan of the Active Vision Dataset; give the folder that holds Home_001_1 and so"
            f" on, each with {PHOTOGRAPHS}/ and {ANNOTATIONS}."
        )
    for name in found:
        if not _NAME.fullmatch(name):
            raise DataError(
                f"{found[name]} is a scan whose name does not say its home; name it by place and scan, as in"
                " Home_001_1, or move it away."
            )
    return found


def _is_scan(folder: Path) -> bool:
    return (folder / PHOTOGRAPHS).is_dir() or (folder / ANNOTATIONS).exists()


def sample_scans(
    cache: Path,
    *,
    split: str,
    scans: Sequence[str] | None,
    width: int,
    height: int,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> Path:
    """The folder of sample scans in a cache, made unless they are there.

    Its name carries a digest of its scans and of the code that draws them, so a change makes another.

    Args:
        cache: where samples are kept.
        split: a published split asks for all of its scans.
        scans: names of those to make; None for the split's, or twenty.
        width: of the photographs, in pixels.
        height: of the photographs, in pixels.
        seed: draws homes and things.
        progress: called with what is done and what there is in all.
    """
    # Rooms and embree, which real scans do without.
    from activelsd.envs.avd.homes import DEFAULT_SCANS
    from activelsd.envs.avd.writer import code_digest, write_sample

    names = tuple(scans or (PUBLISHED if split in TEST_SCANS else DEFAULT_SCANS))
    digest = hashlib.sha256(" ".join([*names, code_digest()]).encode()).hexdigest()[:8]
    root = cache / f"avd-sample-{width}x{height}-seed{seed}-{digest}"
    if root.is_dir():
        return root
    with writing(cache):
        cache.mkdir(parents=True, exist_ok=True)
    with alone(root):
        # Under its own name only when it is whole; what an interruption leaves, the writer goes on with.
        partial = root.with_name(root.name + ".partial")
        write_sample(partial, scans=names, width=width, height=height, seed=seed, progress=progress)
        with writing(cache):
            partial.rename(root)
    return root
