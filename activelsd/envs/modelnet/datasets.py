"""Lists the objects of a data set by class and split, whatever kind of files lies at its path."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from activelsd.envs.images import ENDINGS
from activelsd.envs.modelnet import pictures, point_release, points
from activelsd.envs.modelnet.broken import BrokenObjects
from activelsd.envs.modelnet.cameras import Ring
from activelsd.envs.modelnet.companions import class_names, ending, objects_only
from activelsd.envs.modelnet.files import Folder, Zip, open_files, readable
from activelsd.envs.modelnet.layout import Entry, Layout, find_layout
from activelsd.envs.modelnet.readers import check_format, other_files, says_up
from activelsd.envs.modelnet.settings import DatasetSettings
from activelsd.envs.modelnet.sources import FILES, Item, MeshFiles, PictureFiles, PointFiles, Shapes, Source
from activelsd.envs.modelnet.splits import FOLDERS, chosen, with_validation
from activelsd.errors import ConfigError, DataError, did_you_mean
from activelsd.scenery.meshes import Axis
from activelsd.sections import Colour


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
    split: str  # the folder it was found in
    name: str
    parts: tuple[str, ...]
    stamp: str
    rings: tuple[Ring, ...] = ()
    up: Axis = "z"
    fault: str = ""


def open_dataset(settings: DatasetSettings, colour: Colour = "gray") -> Dataset:
    """The objects at a path, or the embedded shapes if there is none.

    What is at the path is found by looking: a folder, or the zip of it, with meshes, point clouds, or
    pictures of each object, see `layout.find_layout`, or a release of `point_release`.
    A class's own `val` folder is its validation split.

    Raises:
        BrokenObjects: objects lack pictures, and are not to be skipped.
        DataError: nothing is there, its layout is another, or a class has nothing to train or test on.
        ConfigError: a class is not known, or pictures are to be turned.
    """
    path, classes, rule = settings.path, settings.classes, settings.split
    if path is None:
        found, source = _shapes(settings), Shapes(seed=settings.seed)
        return _dataset("shapes", "the embedded shapes", found, source, rule)
    files = open_files(path)
    found, file_source = _in_files(files, classes, None if settings.up == "auto" else settings.up)
    if isinstance(file_source, PictureFiles):  # all others draw in gray
        file_source = replace(file_source, colour=colour)
    whole = path.resolve()
    dataset = _dataset(readable(whole.stem), readable(str(whole)), found, file_source, rule)
    faults = {i: item.fault for i, item in enumerate(dataset.items) if item.fault}
    if faults and not settings.skip_broken:
        raise BrokenObjects(dataset, faults)
    return dataset


def _dataset(
    title: str,
    origin: str,
    found: Mapping[str, Sequence[_Object]],
    source: Source,
    rule: str,
) -> Dataset:
    items: list[Item] = []
    for category, objects in found.items():
        own = _told_apart(objects, origin)
        held_out = any(one.split == "val" for one in objects)
        for folder in ("train", "val", "test") if held_out else FOLDERS:
            names = [name for name, one in own.items() if one.split == folder]
            taken = chosen(names, folder, rule)
            if not taken:
                raise DataError(_nothing(origin, category, folder, rule, len(names)))
            splits = [folder] * len(taken) if held_out or folder == "test" else with_validation(taken)
            for name, split in zip(taken, splits, strict=True):
                whole = f"{category}/{name.removeprefix(f'{category}/')}"
                one = own[name]
                items.append(
                    Item(
                        name=whole,
                        category=category,
                        split=split,
                        parts=one.parts,
                        stamp=one.stamp,
                        rings=one.rings,
                        up=one.up,
                        fault=one.fault,
                    )
                )
    return Dataset(
        title=title,
        classes=tuple(found),
        items=tuple(items),
        source=source,
        origin={"from": origin} | {k: v for k, v in source.spec().items() if k != "path"},
    )


def _told_apart(objects: Sequence[_Object], origin: str) -> dict[str, _Object]:
    """The objects of a class by name; those of one name by their files."""
    names = Counter(one.name for one in objects)
    own: dict[str, _Object] = {}
    for one in objects:
        name = one.name if names[one.name] == 1 else readable(one.parts[0])
        if name in own:
            raise DataError(f"{origin} has two objects called {name}; rename one of them.")
        own[name] = one
    return own


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
    files: Folder | Zip, classes: Sequence[str] | None, up: Axis | None
) -> tuple[dict[str, list[_Object]], MeshFiles | PointFiles | PictureFiles]:
    """The objects of every class asked for, and what makes them."""
    release = point_release.folder_of(files)
    if release is not None:
        rows = point_release.objects(files, release)
        asked = _asked(tuple(rows), classes, files.where(""))
        return {c: [_in_row(row, up) for row in rows[c]] for c in asked}, PointFiles(files=files)
    layout = find_layout(files)
    entries = objects_only(files, layout, _asked(class_names(layout), classes, files.where("")))
    kind = _kind(files, [entry for own in entries.values() for entry in own])
    source = FILES[kind](files=files)
    if kind == "pictures":
        if up is not None:
            raise ConfigError(
                f"env.dataset.up turns meshes and points, but {files.where('')} holds pictures;"
                " leave that setting out."
            )
        return {c: _pictured(files, layout, c, own) for c, own in entries.items()}, source
    if kind == "meshes":
        examples = {ending(e.path): e.path for own in entries.values() for e in reversed(own)}
        for name, example in sorted(examples.items()):
            check_format(name, files.where(example))
    return {c: _in_one_file(files, own, up) for c, own in entries.items()}, source


def kind_at(path: Path) -> str:
    """What lies at a path: `meshes`, `points` or `pictures`. Raises DataError as `open_dataset` does."""
    files = open_files(path)
    if point_release.folder_of(files) is not None:
        return "points"
    layout = find_layout(files)
    return _kind(files, [e for own in objects_only(files, layout, class_names(layout)).values() for e in own])


def _kind(files: Folder | Zip, entries: Sequence[Entry]) -> str:
    """What files are; `meshes` if there are none. Raises DataError if they are not of one kind."""
    examples: dict[str, str] = {}
    for entry in entries:
        examples.setdefault(ending(entry.path), entry.path)
    found: dict[str, str] = {}
    for suffix, path in examples.items():
        if suffix in ENDINGS:
            kind = "pictures"
        elif suffix == ".ply":
            kind = "meshes" if points.has_faces(files.read(path)) else "points"
        else:
            kind = "points" if suffix in points.ENDINGS or suffix == ".txt" else "meshes"
        found.setdefault(kind, files.where(path))
    if len(found) > 1:
        these = " and ".join(f"{kind} ({example})" for kind, example in sorted(found.items()))
        raise DataError(f"{files.where('')} holds {these} side by side; keep the one kind or the other.")
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


def _in_one_file(files: Folder | Zip, entries: Sequence[Entry], up: Axis | None) -> list[_Object]:
    """An object for every file; one in a folder of its own has the folder's name."""
    found: dict[tuple[str, ...], Entry] = {}
    for entry in entries:
        folder = (str(entry.split), *entry.owner[:1])
        if entry.owner and folder in found:
            first, second = (PurePosixPath(e.path) for e in (found[folder], entry))
            raise DataError(
                f"{files.where(str(first))} and {second.name} are in the folder of one object; keep one"
                " of them, or put both where the folder is."
            )
        found[folder if entry.owner else (entry.path,)] = entry
    return [
        _Object(
            category=entry.category,
            split=str(entry.split),
            name=_name(entry),
            parts=(entry.path,),
            stamp=_with_axis(_stamp(files, entry), up, says_up(entry.path)),
            up=up or says_up(entry.path),
        )
        for entry in found.values()
    ]


def _stamp(files: Folder | Zip, entry: Entry) -> str:
    """The stamps of a file and of those that it refers to."""
    return " ".join([entry.stamp, *map(files.stamp, other_files(files, entry.path))])


def _with_axis(stamp: str, up: Axis | None, says: Axis) -> str:
    """A stamp, with the axis that is to be up if files of its kind are seen otherwise."""
    return stamp if up in (None, says) else f"{stamp} {up} up"


def _in_row(row: point_release.Row, up: Axis | None) -> _Object:
    return _Object(
        category=row.category,
        split=row.split,
        name=readable(row.name),
        parts=(row.path, f"{row.row:06d}"),
        stamp=_with_axis(row.stamp, up, point_release.UP),
        up=up or point_release.UP,
    )


def _name(entry: Entry) -> str:
    return readable(entry.owner[0] if entry.owner else PurePosixPath(entry.path).stem)


def _pictured(files: Folder | Zip, layout: Layout, category: str, entries: Sequence[Entry]) -> list[_Object]:
    stamps = {e.path: e.stamp for e in entries}
    return [
        _Object(
            category,
            split,
            readable(name),
            tuple(series.paths),
            " ".join(stamps[path] for path in series.paths),
            series.rings,
            fault=series.fault,
        )
        for split in sorted({str(e.split) for e in entries})
        for name, series in pictures.grouped(
            [(e.path, e.owner) for e in entries if e.split == split],
            files.where(layout.place(category, split)),
        ).items()
    ]
