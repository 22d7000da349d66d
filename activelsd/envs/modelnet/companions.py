"""Tells objects from what lies beside them: notes, materials, textures, and files that have to be named."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from pathlib import PurePosixPath

from activelsd.envs.images import ENDINGS, FOREIGN_ENDINGS
from activelsd.envs.modelnet.files import ARCHIVES, Folder, Zip
from activelsd.envs.modelnet.layout import TEXTURES, Entry, Layout
from activelsd.errors import DataError

_ENDINGS = frozenset(
    {".mtl", ".bin", ".binvox", ".txt", ".md", ".rst", ".json", ".csv", ".tsv", ".xml", ".yaml", ".yml"}
    | {".html", ".pdf", ".log", ".md5", ".sha256", ".url", ".lnk", ".webloc"}
)
"""Of materials, notes and lists."""

_NAMES = frozenset(
    {"readme", "license", "licence", "copying", "notice", "authors", "changelog", "citation", "manifest"}
    | {"version", "checksums", "makefile"}
)
"""Of notes without an ending, in small letters."""

_TEXTURED = frozenset({".obj", ".gltf", ".glb", ".dae", ".ply", ".3mf", ".fbx", ".wrl"})
"""Endings of meshes that may have pictures as their texture."""

_ALL_PICTURES = ENDINGS | FOREIGN_ENDINGS


def ending(path: str) -> str:
    """The ending of a file's name with its dot, in small letters."""
    return PurePosixPath(path).suffix.lower()


def class_names(layout: Layout) -> list[str]:
    """The classes of a data set; a folder of nothing but notes is none."""
    return [
        name
        for name, entries in layout.classes.items()
        if not entries or not all(entry.split is None and _is_note(entry.path) for entry in entries)
    ]


def objects_only(files: Folder | Zip, layout: Layout, classes: Iterable[str]) -> dict[str, list[Entry]]:
    """The meshes, point clouds or pictures of some classes.

    Raises:
        DataError: a file may be an object, and would be overlooked.
    """
    found = {
        category: [entry for entry in layout.classes[category] if not _is_note(entry.path)]
        for category in classes
    }
    if not any(found.values()):  # then texts are no notes, but may be points
        found = {
            category: [e for e in layout.classes[category] if e.split and ending(e.path) == ".txt"]
            for category in found
        }
    meshes = {_unit(e) for own in found.values() for e in own if ending(e.path) in _TEXTURED}
    for category, own in found.items():
        if meshes:
            found[category] = [entry for entry in own if not _is_texture(entry, meshes)]
        for entry in found[category]:
            _check(files, layout, entry)
    for path, _ in layout.outside:
        if not (_is_note(path) or ending(path) in _ALL_PICTURES | ARCHIVES | {""}):
            there = f"{'train/CLASS' if layout.split_first else 'CLASS/train'} of {files.where(layout.top)}"
            raise DataError(
                f"{files.where(path)} would be overlooked, as objects stand in {there}; move or remove it."
            )
    return found


def _is_note(path: str) -> bool:
    name = PurePosixPath(path)
    return name.suffix.lower() in _ENDINGS or name.name.lower() in _NAMES


def _is_texture(entry: Entry, meshes: AbstractSet[tuple[object, ...]]) -> bool:
    """Whether a picture lies beside a mesh that may use it, in its object's folder, or in one of textures."""
    return ending(entry.path) in _ALL_PICTURES and (
        _unit(entry) in meshes or any(part.lower() in TEXTURES for part in entry.path.split("/")[:-1])
    )


def _unit(entry: Entry) -> tuple[object, ...]:
    """The folder of objects, or of one object, that a file is in."""
    return (entry.category, entry.split, entry.owner[:1])


def _check(files: Folder | Zip, layout: Layout, entry: Entry) -> None:
    """Refuse a file that is no object, or stands where none is looked for, by its own name."""
    name, kind = files.where(entry.path), ending(entry.path)
    if kind in ARCHIVES:
        raise DataError(f"{name} is packed, and what is in it would be overlooked; unpack or remove it.")
    if not kind:
        raise DataError(f"{name} has no ending that tells its format; name it by its format or remove it.")
    if kind in FOREIGN_ENDINGS:
        raise DataError(f"{name} is a picture in a format that is not read; convert it to PNG or remove it.")
    if entry.split is None:
        places = [layout.place(entry.category, split) for split in ("train", "test")]
        raise DataError(
            f"{name} would be overlooked, as it does not stand in {' or '.join(places)}; move or remove it."
        )
