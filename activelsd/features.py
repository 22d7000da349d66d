"""Features of a frozen trunk for every picture of a recording, computed once and kept beside it.

A file `features-<digest>.npy` holds float16 (N + 1, F): a row for each picture the trunk is shown, then one
for the black picture that stands for a target out of sight. The digest is of the pictures, of the trunk, and
of how the pictures are varied; so nothing stale is ever read, and no setting names these files.
"""

from __future__ import annotations

import hashlib
import io
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd.envs.cache import alone, writing
from activelsd.envs.settings import Progress
from activelsd.envs.viewgraph import ViewGraph, replace_durably
from activelsd.errors import DataError
from activelsd.policy.trunks import ViewTrunk
from activelsd.train.augment import VARIATION_SIZE, cut

_FLUSH_SECONDS = 2.0
_CHUNK = {"cpu": 32, "cuda": 512}
"""Pictures that the trunk is shown at once, by the device's kind."""


class Pictures:
    """The pictures of a recording that a trunk is shown, plain or varied.

    The variants of a recording follow one another: as they are, mirrored if `mirror`, then each further cut
    of the crops, and its mirror image.
    """

    def __init__(self, graph: ViewGraph, *, mirror: bool, cuts: int) -> None:
        """Take a graph's crops if it has any, in `cuts` cuts, else its frames, which have one."""
        self._pictures, self._boxes = (
            (graph.frames, None) if graph.crops is None else (graph.crops, graph.boxes)
        )
        cuts = 1 if graph.crops is None else cuts
        self.variants = [
            (i, flipped) for i in range(cuts) for flipped in ((False, True) if mirror else (False,))
        ]
        content = hashlib.sha256(repr((self._pictures.shape, graph.channels)).encode())
        for start in range(0, len(self._pictures), 4096):
            content.update(np.ascontiguousarray(self._pictures[start : start + 4096]).data)
        if cuts > 1 and self._boxes is not None:
            content.update(np.ascontiguousarray(self._boxes).data)
        self._digest = content.hexdigest()

    def __len__(self) -> int:
        """How many there are, the black one included."""
        return len(self._pictures) + 1

    def digest(self, variant: tuple[int, bool]) -> str:
        """Tells apart pictures, and variants of them."""
        return f"{self._digest} {variant}"

    def chunk(self, variant: tuple[int, bool], start: int, size: int) -> Tensor:
        """uint8 (n, C, S, S), the pictures from `start` on; n is `size`, or less at the end."""
        number, flipped = variant
        rows = slice(start, start + size)
        pictures = torch.from_numpy(np.array(self._pictures[rows]))
        if pictures.ndim == 3:
            pictures = pictures[:, None]
        if number and self._boxes is not None and len(pictures):
            present = torch.ones(len(pictures), 1)
            target = torch.cat([torch.from_numpy(self._boxes[rows]), present], 1)[:, None]
            pictures = cut(pictures, target, self._drawn(number)[rows])
        if flipped:
            pictures = pictures.flip(-1)
        if len(pictures) < size:  # the end
            pictures = torch.cat([pictures, pictures.new_zeros(1, *self._shape())])
        return pictures

    @lru_cache(maxsize=1)  # noqa: B019  one pass over the pictures asks for the same again and again
    def _drawn(self, number: int) -> Tensor:
        """(N, VARIATION_SIZE), how every crop is varied in a cut."""
        drawn = np.random.default_rng(number).random((len(self._pictures), VARIATION_SIZE), np.float32)
        return torch.from_numpy(drawn)

    def _shape(self) -> tuple[int, ...]:
        one = self._pictures.shape[1:]
        return one if len(one) == 3 else (1, *one)


def with_features(
    graph: ViewGraph,
    trunk: Any,
    *,
    cache: Path,
    mirror: bool = False,
    vary_crops: bool = False,
    device: str = "cpu",
    progress: Callable[[str], Any] | None = None,
) -> ViewGraph:
    """The graph with the features of a frozen trunk; as it is for any other trunk.

    Args:
        graph: recorded views.
        trunk: of the network.
        cache: folder to keep them in.
        mirror: whether episodes are mirrored in training.
        vary_crops: whether crops are varied in training.
        device: to compute them on.
        progress: makes the callback of a progress line, given what is done.

    Raises:
        CacheError: the cache cannot be written.
        DataError: a file of features is damaged.
    """
    if not isinstance(trunk, ViewTrunk) or not trunk.frozen:
        return graph
    pictures = Pictures(graph, mirror=mirror, cuts=trunk.variants if vary_crops else 1)
    trunk = trunk.to(device)
    with _shown(progress) as show:
        done, total = 0, len(pictures) * len(pictures.variants)
        features = []
        for variant in pictures.variants:
            path = _file(cache, pictures.digest(variant), trunk)
            if not path.exists():
                with alone(path):
                    if not path.exists():
                        report = partial(_report, show, done, total)
                        _compute(path, pictures, variant, trunk, device, report)
            features.append(_loaded(path, len(pictures), trunk))
            done += len(pictures)
    return replace(graph, features=tuple(features))


def _loaded(path: Path, rows: int, trunk: ViewTrunk) -> NDArray[np.float16]:
    try:
        features: NDArray[np.float16] = np.load(path, mmap_mode="c")
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({error}); delete it, and it is made again.") from None
    if features.shape != (rows, trunk.embedding):
        raise DataError(f"{path} has {features.shape} features; delete it, and it is made again.")
    return features


def _report(show: Progress, before: int, total: int, done: int) -> None:
    show(before + done, total)


@contextmanager
def _shown(progress: Callable[[str], Any] | None) -> Iterator[Progress]:
    if progress is None:
        yield lambda done, total: None
        return
    with progress("Computing features") as show:
        yield show


def _file(cache: Path, pictures: str, trunk: ViewTrunk) -> Path:
    key = hashlib.sha256(f"{pictures} {trunk.digest()}".encode()).hexdigest()[:20]
    return cache / f"features-{key}.npy"


def _compute(
    path: Path,
    pictures: Pictures,
    variant: tuple[int, bool],
    trunk: ViewTrunk,
    device: str,
    report: Callable[[int], None],
) -> None:
    """Append rows to a partial file, going on with what an interrupted process left, then rename it."""
    unfinished = path.with_name(path.name + ".partial")
    size, row = _CHUNK[torch.device(device).type], 2 * trunk.embedding
    with writing(path.parent), unfinished.open("a+b") as file:
        header = _header((len(pictures), trunk.embedding))
        file.seek(0)
        if file.read(len(header)) != header:
            file.truncate(0)
            file.write(header)
            file.flush()
        # A power cut may leave part of a row; whatever was not flushed as whole rows is computed again.
        done = (file.seek(0, os.SEEK_END) - len(header)) // row // size * size
        file.truncate(len(header) + done * row)
        flushed = time.monotonic()
        with torch.inference_mode():
            while done < len(pictures):
                report(done)
                found = trunk.embed(pictures.chunk(variant, done, size).to(device)).half().cpu().numpy()
                file.write(found.tobytes())
                done += len(found)
                if time.monotonic() - flushed > _FLUSH_SECONDS:
                    file.flush()
                    os.fsync(file.fileno())
                    flushed = time.monotonic()
    with writing(path.parent):
        replace_durably(unfinished, path)
    report(done)


def _header(shape: tuple[int, int]) -> bytes:
    """How a NumPy file of float16 in that shape begins."""
    stream = io.BytesIO()
    description = np.lib.format.header_data_from_array_1_0(np.zeros((0, shape[1]), np.float16))
    np.lib.format.write_array_header_1_0(stream, description | {"shape": shape})
    return stream.getvalue()


def recorded_size(cache: Path) -> tuple[int, int]:
    """Number of the feature files in a cache, and their bytes."""
    sizes = [path.stat().st_size for path in cache.glob("features-*.npy")]
    return len(sizes), sum(sizes)
