"""Reads ModelNet40 as point clouds in HDF5 files, as released with PointNet (`modelnet40_ply_hdf5_2048`).

`train_files.txt` and `test_files.txt` name the files of each split, and `shape_names.txt` the classes. A file
has `data` (M, N, 3), `label` (M, 1) and perhaps `normal` (M, N, 3); y is up. Beside a file `train0.h5` may
stand `train_0_id2file.json`, the names of its M objects as in `chair/chair_0001.ply`.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.files import Folder, Zip
from activelsd.envs.modelnet.points import Points, from_table
from activelsd.errors import DataError
from activelsd.scenery.meshes import Axis

if TYPE_CHECKING:  # other data sets do without it
    import h5py

_LISTS = {"train": "train_files.txt", "test": "test_files.txt"}
_CLASSES = "shape_names.txt"
_ENDINGS = (".h5", ".hdf5")
UP: Axis = "y"
"""The axis that points up."""

_CACHED = 1 << 24
"""Bytes of each part of a file that are kept unpacked, so that rows read in order are unpacked once."""


class Row(NamedTuple):
    """An object of a release."""

    category: str
    split: str
    name: str
    path: str  # of its HDF5 file
    row: int
    stamp: str


def folder_of(files: Folder | Zip) -> str | None:
    """The folder of a release with a slash at its end, or nothing for the root; None: there is no release.

    Raises:
        DataError: there are several.
    """
    paths = {member.path for member in files.members()}
    tops = sorted(
        path.removesuffix(_CLASSES)
        for path in paths
        if PurePosixPath(path).name == _CLASSES and path.removesuffix(_CLASSES) + _LISTS["train"] in paths
    )
    if len(tops) > 1:
        first, second = (files.where(top) for top in tops[:2])
        raise DataError(f"There are point clouds both in {first} and in {second}; give one of the two.")
    return tops[0] if tops else None


def objects(files: Folder | Zip, top: str) -> dict[str, list[Row]]:
    """The objects of every class of the release in a folder.

    Raises:
        DataError: a file is missing, broken, or named by no list.
    """
    _opened.cache_clear()  # the files may be others by now
    stamps = {member.path: member.stamp for member in files.members()}
    classes = _lines(files, top + _CLASSES)
    found: dict[str, list[Row]] = {category: [] for category in classes}
    if len(found) < len(classes) or not classes:
        raise DataError(f"{files.where(top + _CLASSES)} names no class, or one twice; download it again.")
    left = {path for path in stamps if path.startswith(top) and path.endswith(_ENDINGS)}
    for split, name in _LISTS.items():
        for line in _lines(files, top + name):
            path = top + PurePosixPath(line).name
            if path not in left:
                where, what = files.where(top + name), files.where(path)
                raise DataError(f"{where} names {what}, which is not there or named before; mend the list.")
            left.remove(path)
            labels = _opened(files, path).labels
            if len(labels) and (labels.min() < 0 or labels.max() >= len(classes)):
                raise DataError(
                    f"{files.where(path)} has labels from {labels.min()} to {labels.max()} where"
                    f" {_CLASSES} has {len(classes)} classes; download it again."
                )
            names = _names(files, path, len(labels), stamps)
            for row, (label, own) in enumerate(zip(labels.tolist(), names, strict=True)):
                category = classes[label]
                found[category].append(Row(category, split, own, path, row, stamps[path]))
    if left:
        first = files.where(sorted(left)[0])
        raise DataError(f"{first} would be overlooked, as no list of the release names it; add or remove it.")
    return found


def points_at(files: Folder | Zip, path: str, row: int) -> Points:
    """The point cloud in a row of an HDF5 file."""
    file = _opened(files, path).file
    name = f"{files.where(path)}, row {row},"
    try:
        columns = [file[part][row] for part in ("data", "normal") if part in file]
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise DataError(f"{name} cannot be read ({_brief(error)}); download it again.") from None
    return from_table(np.concatenate(columns, axis=1).astype(np.float64), name)


class _Opened(NamedTuple):
    file: h5py.File
    labels: NDArray[np.int64]  # (M,)


@lru_cache(maxsize=64)
def _opened(files: Folder | Zip, path: str) -> _Opened:
    """A file of a release and its labels, kept open: every object asks for it."""
    import h5py

    where = files.where(path)
    try:
        source = files.root / path if isinstance(files, Folder) else io.BytesIO(files.read(path))
        file = h5py.File(source, "r", locking=False, rdcc_nbytes=_CACHED)
        data, labels = file["data"], np.asarray(file["label"])
        shapes = [data.shape, *([file["normal"].shape] if "normal" in file else [])]
        kinds = data.dtype.kind + labels.dtype.kind
    except (OSError, RuntimeError, ValueError, KeyError, AttributeError) as error:
        raise DataError(f"{where} is not read as HDF5 with data and label ({_brief(error)}).") from None
    if len(data.shape) != 3 or data.shape[2] != 3 or len(set(shapes)) > 1 or labels.size != len(data):
        raise DataError(
            f"{where} has data {data.shape} and label {labels.shape}, but (M, N, 3) and (M, 1) are wanted;"
            " download it again."
        )
    if kinds[0] not in "fiu" or kinds[1] not in "iu":
        raise DataError(f"{where} has data or label that are no numbers; download it again.")
    return _Opened(file, labels.reshape(-1).astype(np.int64))


def _names(files: Folder | Zip, path: str, count: int, stamps: Mapping[str, str]) -> list[str]:
    """The names of the objects in a file; numbers behind its own where no file says them."""
    stem = path.rpartition(".")[0]
    for beside in (re.sub(r"_?(\d+)$", r"_\1", stem) + "_id2file.json", f"{stem}_id2file.json"):
        if beside in stamps:
            try:
                names = [PurePosixPath(name).stem for name in json.loads(files.read(beside))]
            except (ValueError, TypeError, RecursionError):
                names = []
            if len(names) != count:
                raise DataError(
                    f"{files.where(beside)} is no list of the {count} names of {PurePosixPath(path).name};"
                    " download it again, or remove it to number the objects."
                )
            return names
    return [f"{PurePosixPath(stem).name}_{row:04d}" for row in range(count)]


def _lines(files: Folder | Zip, path: str) -> list[str]:
    text = files.read(path).decode("utf-8", "replace")
    return [line.strip() for line in text.splitlines() if line.strip()]


def _brief(error: Exception) -> str:
    return " ".join(str(error).split())[:80].rstrip(".")
