"""Tells objects from what lies beside them: notes, materials, textures, and files that have to be named."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet
from pathlib import PurePosixPath

from activelsd.envs.images import ENDINGS, FOREIGN_ENDINGS
from activelsd.envs.modelnet.files import ARCHIVES, Folder, Zip
from activelsd.envs.modelnet.layout import TEXTURES, Entry, Layout
from activelsd.errors import DataError, listed

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
    if meshes:
        found = {name: [e for e in own if not _is_texture(e, meshes)] for name, own in found.items()}
    entries = [entry for own in found.values() for entry in own]
    wrong = [*filter(None, (_wrong(files, layout, e) for e in entries)), *_strays(files, layout)]
    if len(wrong) == 1:
        raise DataError(wrong[0])
    if wrong:
        what = f"{len(wrong)} files of {files.where('')} are no objects, and might hold some"
        raise DataError(f"{what}; mend, move or remove them:\n{listed(wrong)}")
    return found


def _strays(files: Folder | Zip, layout: Layout) -> Iterator[str]:
    """What is wrong with files outside all class folders that may be objects."""
    there = f"{'train/CLASS' if layout.split_first else 'CLASS/train'} of {files.where(layout.top)}"
    for path, _ in layout.outside:
        if not (_is_note(path) or ending(path) in _ALL_PICTURES | ARCHIVES | {""}):
            yield f"{files.where(path)} would be overlooked, as objects stand in {there}; move or remove it."


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


def _wrong(files: Folder | Zip, layout: Layout, entry: Entry) -> str | None:
    """What is wrong with a file that is no object, or stands where none is looked for."""
    name, kind = files.where(entry.path), ending(entry.path)
    if kind in ARCHIVES:
        return f"{name} is packed, and what is in it would be overlooked; unpack or remove it."
    if not kind:
        return f"{name} has no ending that tells its format; name it by its format or remove it."
    if kind in FOREIGN_ENDINGS:
        return f"{name} is a picture in a format that is not read; convert it to PNG or remove it."
    if entry.split is None:
        there = " or ".join(layout.place(entry.category, split) for split in ("train", "test"))
        return f"{name} would be overlooked, as it does not stand in {there}; move or remove it."
    return None
