"""Sorts a data set's files by class, split and object, in whichever order their folders stand.

`CLASS/SPLIT/FILE` as in ModelNet, `SPLIT/CLASS/FILE` as in many sets of pictures, and either with a folder
for each object in place of the file. All of it may stand in a folder of its own, as in ModelNet's zips.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import PurePosixPath
from typing import NamedTuple

from activelsd.envs.modelnet.files import ARCHIVES, Folder, Member, Zip, readable
from activelsd.errors import DataError

TEXTURES = frozenset({"texture", "textures", "tex", "material", "materials", "maps", "images", "screenshots"})
"""Folders of what belongs to meshes, in small letters."""

_SPLITS = {
    "train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val",
    "test": "test", "testing": "test",
}  # fmt: skip
"""The split that a folder's name, in small letters, stands for."""

Parts = tuple[str, ...]
"""The folders of a path, from the root."""


class Entry(NamedTuple):
    """A file in the folder of a class."""

    category: str
    split: str | None  # train, val or test; None: it stands in none of them
    owner: Parts  # folders below class and split: the object's, if it has any, and those in it
    path: str
    stamp: str


class Layout(NamedTuple):
    """Every class with its files, both in order of names, and the files that belong to none."""

    classes: dict[str, list[Entry]]
    outside: list[Member]
    split_first: bool
    top: str  # the folder of all of it, from the root

    def place(self, category: str, split: str) -> str:
        """The folder of a class and split, for messages."""
        return f"{split}/{category}" if self.split_first else f"{category}/{split}"


def find_layout(files: Folder | Zip) -> Layout:
    """How the files are laid out.

    Raises:
        DataError: they are not laid out in one of the known ways.
    """
    members = sorted(files.members())
    paths = [tuple(member.path.split("/")) for member in members]
    folders = {path[:i] for path in paths for i in range(1, len(path))}
    children: dict[Parts, list[str]] = {}
    for folder in sorted(folders):
        children.setdefault(folder[:-1], []).append(folder[-1])
    holders = {
        folder: {_SPLITS[name.lower()] for name in names if name.lower() in _SPLITS}
        for folder, names in children.items()
    }
    holders = {folder: splits for folder, splits in holders.items() if splits}
    if not holders:
        raise DataError(_unknown(files, members, bool(folders)))
    whole = [folder for folder, splits in holders.items() if {"train", "test"} <= splits] or list(holders)
    outer = [folder for folder in whole if not any(folder[:i] in whole for i in range(len(folder)))]
    split_first = len(outer) == 1 and _is_split_first(files, outer[0], children)
    tops = outer if split_first else sorted({folder[:-1] for folder in outer})
    if len(tops) > 1:
        first, second = (files.where("/".join(top)) for top in tops[:2])
        raise DataError(f"Class folders stand both in {first} and in {second}; give one of the two.")
    (top,) = tops
    if split_first and not {"train", "test"} <= holders[top]:
        there = " and ".join(f"{split}/" for split in sorted(holders[top]))
        raise DataError(f"{files.where('/'.join(top))} has only {there}; {_looked_for(files)}")
    names = children[top]
    if split_first:
        splits = {name: _SPLITS[name.lower()] for name in names if name.lower() in _SPLITS}
        classes = {child for name in splits for child in children.get((*top, name), [])}
        return _by_class(members, top, classes, splits)
    classes = {name for name in names if name.lower() not in TEXTURES or (*top, name) in holders}
    return _by_class(members, top, classes, None)


def _by_class(
    members: Sequence[Member], top: Parts, classes: AbstractSet[str], splits: Mapping[str, str] | None
) -> Layout:
    """The files by class; `splits` are the folders of `top` that are splits; None: they are classes."""
    found: dict[str, list[Entry]] = {readable(name): [] for name in sorted(classes)}
    outside = []
    for member in members:
        *parents, file = member.path.split("/")
        if not file:  # a folder
            continue
        first, second = (*parents[len(top) :], "", "")[:2]
        category, folder = (first, second) if splits is None else (second, first)
        if tuple(parents[: len(top)]) != top or category not in classes or (splits and first not in splits):
            outside.append(member)
            continue
        name, split = readable(category), _SPLITS.get(folder.lower())
        found[name].append(Entry(name, split, tuple(parents[len(top) + 2 :]), *member))
    return Layout(found, outside, splits is not None, "/".join(top))


def _is_split_first(files: Folder | Zip, holder: Parts, children: dict[Parts, list[str]]) -> bool:
    """Whether the only folder that holds `train` and `test` holds all classes, or is a class itself.

    It is a class if its splits have no folder's name in common: those are objects' folders then.
    """
    inside: dict[str, set[str]] = {}
    for name in children[holder]:
        if name.lower() in _SPLITS:
            inside.setdefault(_SPLITS[name.lower()], set()).update(children.get((*holder, name), []))
    shared = inside.get("train", set()) & inside.get("test", set())
    if holder and not shared:
        return False
    if not any(inside.values()):
        raise DataError(
            f"{_shown(files)} has no class folders, as its train and test hold files themselves; if it is one"
            f" class, give the folder above it, or else {_looked_for(files)}"
        )
    if not shared and len(inside) > 1:
        raise DataError(
            f"{files.where('/'.join(holder))} has no class both in train and in test; {_looked_for(files)}"
        )
    return True


def _unknown(files: Folder | Zip, members: Sequence[Member], folders: bool) -> str:
    root = _shown(files)
    if not members:
        return f"{root} is empty; {_looked_for(files)}"
    if files.root.name.lower() in _SPLITS:
        return f"{root} is the folder of one split; give the folder that holds all of them."
    archives = [m.path for m in members if PurePosixPath(m.path).suffix.lower() in ARCHIVES]
    if len(archives) == len([m for m in members if not m.path.endswith("/")]) and archives:
        archive = files.where(archives[0])
        packed = archive.lower().endswith(".zip") and isinstance(files, Folder)
        way = f"give env.dataset.path={archive}" if packed else "unpack it and give the folder"
        return f"{root} holds no class folders but the archive {archive}; {way}."
    if folders:
        return f"{root} has folders, but none of them is called train or test; {_looked_for(files)}"
    return f"{root} has no class folders; {_looked_for(files)}"


def _shown(files: Folder | Zip) -> str:
    return files.where("").rstrip("/")


def _looked_for(files: Folder | Zip) -> str:
    root = _shown(files)
    return (
        f"objects are looked for in {root}/CLASS/train and {root}/CLASS/test, or in {root}/train/CLASS and"
        f" {root}/test/CLASS."
    )
