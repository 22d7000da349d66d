"""Lists the objects of a data set by class and split, whatever kind of files lies at its path."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from activelsd.envs.modelnet import pictures, points
from activelsd.envs.modelnet.files import FOLDERS, Entry, Folder, Zip, class_folders, open_files
from activelsd.envs.modelnet.readers import check_format
from activelsd.envs.modelnet.settings import DatasetSettings
from activelsd.envs.modelnet.sources import FILES, Item, MeshFiles, PictureFiles, PointFiles, Shapes, Source
from activelsd.envs.modelnet.splits import chosen, with_validation
from activelsd.errors import ConfigError, DataError, did_you_mean

_COMPANIONS = frozenset({".mtl", ".bin", ".txt", ".md", ".json", ".csv", ".tsv"})
"""Endings of what may lie beside meshes and pictures without being one."""

_KINDS = dict.fromkeys(pictures.ENDINGS, "pictures") | dict.fromkeys(points.ENDINGS, "points")
"""What files hold, by their ending; others are taken for meshes."""


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """The objects of one dataset; labels follow `classes`, which are in order of names."""

    title: str  # a word for file names
    classes: tuple[str, ...]
    items: tuple[Item, ...]
    source: Source
    origin: Mapping[str, str | int]  # tells data sets apart, whatever is chosen from them


class _Object(NamedTuple):
    """An object found, before it is known whether the rule of the split takes it."""

    category: str
    folder: str
    name: str
    parts: tuple[str, ...]
    stamp: str


def open_dataset(settings: DatasetSettings) -> Dataset:
    """The objects at a path, or the embedded shapes if there is none.

    What is at the path is found by looking: a folder, or the zip of it, with `CLASS/train` and `CLASS/test`,
    holding meshes, point clouds, or twelve pictures of each object.

    Raises:
        DataError: nothing is there, its layout is another, or a class has nothing to train or test on.
        ConfigError: a class is not known.
    """
    path, classes, rule = settings.path, settings.classes, settings.split
    if path is None:
        found, source = _shapes(settings), Shapes(seed=settings.seed)
        return _dataset("shapes", "the embedded shapes", found, source, rule)
    files = open_files(path)
    found, file_source = _in_files(files, classes)
    return _dataset(path.resolve().stem, str(path.resolve()), found, file_source, rule)


def _dataset(
    title: str,
    origin: str,
    found: Mapping[str, Sequence[_Object]],
    source: Source,
    rule: str,
) -> Dataset:
    items: list[Item] = []
    for category, objects in found.items():
        names = Counter(o.name for o in objects)
        for folder in FOLDERS:
            own = {o.parts[0] if names[o.name] > 1 else o.name: o for o in objects if o.folder == folder}
            taken = chosen(list(own), folder, rule)
            if not taken:
                raise DataError(_nothing(origin, category, folder, rule, len(own)))
            splits = with_validation(taken) if folder == "train" else [folder] * len(taken)
            for name, split in zip(taken, splits, strict=True):
                whole = f"{category}/{name.removeprefix(f'{category}/')}"
                parts, stamp = own[name].parts, own[name].stamp
                items.append(Item(name=whole, category=category, split=split, parts=parts, stamp=stamp))
    return Dataset(
        title=title,
        classes=tuple(found),
        items=tuple(items),
        source=source,
        origin={"from": origin} | {k: v for k, v in source.spec().items() if k != "path"},
    )


def _nothing(origin: str, category: str, folder: str, rule: str, found: int) -> str:
    if found:
        return (
            f"Split '{rule}' leaves class '{category}' of {origin} no {folder} objects, as it drops the last;"
            " add objects or use split=official."
        )
    return f"Class '{category}' of {origin} has no {folder} objects; add some or leave the class out."


def _shapes(settings: DatasetSettings) -> dict[str, list[_Object]]:
    """The embedded shapes asked for."""
    from activelsd.scenery.shapes import CATEGORIES  # files do without it

    counts = {"train": settings.train_per_class, "test": settings.test_per_class}
    return {
        category: [
            _Object(category, folder, f"{folder}_{i:05d}", (folder, str(i)), "")
            for folder in FOLDERS
            for i in range(counts[folder])
        ]
        for category in _asked(CATEGORIES, settings.classes, "the embedded shapes")
    }


def _in_files(
    files: Folder | Zip, classes: Sequence[str] | None
) -> tuple[dict[str, list[_Object]], MeshFiles | PointFiles | PictureFiles]:
    """The objects of every class asked for, and what makes them."""
    folders = class_folders(files)
    entries = {
        category: _objects_only(files, folders[category])
        for category in _asked(tuple(folders), classes, str(files.root))
    }
    kind = _kind(files, [entry for own in entries.values() for entry in own])
    source = FILES[kind](files=files)
    if kind == "pictures":
        return {c: _pictured(files, c, own) for c, own in entries.items()}, source
    if kind == "meshes":
        for ending in sorted({PurePosixPath(e.path).suffix.lower() for own in entries.values() for e in own}):
            example = next(e for own in entries.values() for e in own if e.path.lower().endswith(ending))
            check_format(ending, files.where(example.path))
    return {c: [_in_one_file(e) for e in own] for c, own in entries.items()}, source


def kind_at(path: Path) -> str:
    """What lies at a path: `meshes`, `points` or `pictures`. Raises DataError as `open_dataset` does."""
    files = open_files(path)
    return _kind(files, [e for own in class_folders(files).values() for e in _objects_only(files, own)])


def _kind(files: Folder | Zip, entries: Sequence[Entry]) -> str:
    """What files are; `meshes` if there are none. Raises DataError if they are not of one kind."""
    found: dict[str, str] = {}
    for entry in entries:
        ending = PurePosixPath(entry.path).suffix.lower()
        kind = (
            "pictures" if ending in pictures.ENDINGS else "points" if ending in points.ENDINGS else "meshes"
        )
        found.setdefault(kind, files.where(entry.path))
    if len(found) > 1:
        these = " and ".join(f"{kind} ({example})" for kind, example in sorted(found.items()))
        raise DataError(f"{files.root} holds {these} side by side; keep the one kind or the other.")
    return next(iter(found), "meshes")


def _asked(known: Sequence[str], classes: Sequence[str] | None, origin: str) -> list[str]:
    """The classes asked for, in order of names."""
    if classes is None:
        return sorted(known)
    for name in classes:
        if name not in known:
            hint = did_you_mean(name, sorted(known))
            raise ConfigError(f"There is no class '{name}' in {origin}; {hint}")
    return sorted(set(classes))


def _objects_only(files: Folder | Zip, entries: Sequence[Entry]) -> list[Entry]:
    """The meshes or pictures among a class's files; one that would be overlooked is an error."""
    objects = [e for e in entries if PurePosixPath(e.path).suffix.lower() not in _COMPANIONS]
    for entry in objects:
        if entry.folder not in FOLDERS:
            raise DataError(
                f"{files.where(entry.path)} would be overlooked, as it does not stand right in"
                f" {entry.category}/train or {entry.category}/test; move or remove it."
            )
    return objects


def _in_one_file(entry: Entry) -> _Object:
    return _Object(entry.category, entry.folder, PurePosixPath(entry.path).stem, (entry.path,), entry.stamp)


def _pictured(files: Folder | Zip, category: str, entries: Sequence[Entry]) -> list[_Object]:
    stamps = {e.path: e.stamp for e in entries}
    return [
        _Object(category, folder, name, tuple(paths), " ".join(stamps[path] for path in paths))
        for folder in FOLDERS
        for name, paths in pictures.grouped(
            [e.path for e in entries if e.folder == folder], f"{files.root}/{category}/{folder}"
        ).items()
    ]
