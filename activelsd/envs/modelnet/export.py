"""Writes views as the picture folders of MVCNN and RotationNet, whose public links are dead.

MVCNN (Su et al. 2015; Su et al. 2018): `CLASS/SPLIT/NAME.obj.shaded_v001.png` and on, 224 pixels, 12 cameras
every 30 degrees, 30 degrees above the object. RotationNet (Kanezaki et al. 2018): `CLASS/SPLIT/NAME_001.png`
and on, from 12 such cameras or from the 20 vertices of a dodecahedron.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.cores import cores
from activelsd.envs.digest import code_digest
from activelsd.envs.locks import locked
from activelsd.envs.modelnet import sources
from activelsd.envs.modelnet.broken import BrokenObjects, report_left_out
from activelsd.envs.modelnet.cameras import Camera, Dodecahedron, Rings
from activelsd.envs.modelnet.datasets import Dataset
from activelsd.envs.modelnet.settings import AZIMUTHS, ELEVATION
from activelsd.envs.modelnet.sources import BROKEN, WHOLE, Drawn, Item, naming, source_from
from activelsd.envs.modelnet.splits import with_validation
from activelsd.envs.settings import Progress
from activelsd.envs.workers import Work, spread
from activelsd.errors import DataError

_LOG = logging.getLogger("activelsd")

MANIFEST = "export.json"
"""What was exported, and from what; also tells a folder that may be written to from others."""

_SHARE = 4
"""Objects for which starting another process is worth it."""

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"

Layout = Literal["mvcnn", "rotationnet"]
Kind = Literal["shaded", "depth"]
CAMERAS = {12: Rings.even(AZIMUTHS, [ELEVATION]).cameras, 20: Dodecahedron().cameras}
"""By the number of views."""


@dataclass(frozen=True, kw_only=True)
class Form:
    """How pictures are named and what they show."""

    layout: Layout
    views: int
    kind: Kind
    size: int

    def names(self, name: str) -> list[str]:
        """The names of an object's pictures, in the order of the cameras."""
        begin = f"{name}.obj.{self.kind}_v" if self.layout == "mvcnn" else f"{name}_"
        return [f"{begin}{number:03d}.png" for number in range(1, self.views + 1)]


class Exported(NamedTuple):
    """What there is after an export."""

    objects: int
    pictures: int
    written: int  # of the pictures, this time


def export(
    dataset: Dataset, folder: Path, form: Form, *, skip_broken: bool = False, progress: Progress | None = None
) -> Exported:
    """Writes the pictures of all objects that are not there yet.

    Every picture is written under another name, then renamed, so one that is there is whole. Pictures of
    objects that have changed since are made anew. Objects held out for validation stand in `train`, as in the
    published folders; reading them back holds out the same ones.

    Args:
        dataset: the objects; meshes, points or embedded shapes.
        folder: where to; new, empty, or with an export of the same form.
        form: how.
        skip_broken: leave out broken objects and name them on the screen.
        progress: called with the number of objects done and of all.

    Raises:
        BrokenObjects: objects are broken; those that are not are exported nevertheless.
        DataError: the folder holds something else or cannot be written, or the objects are pictures.
    """
    if not isinstance(dataset.source, Drawn):
        raise DataError(
            f"{dataset.origin['from']} holds pictures already; export draws meshes, points and embedded"
            " shapes."
        )
    if folder.exists() and not folder.is_dir():
        raise DataError(f"{folder} is a file; name a folder to export to.")

    def waiting(holder: str) -> None:
        _LOG.warning("Waiting for %s, which is exporting to %s.", holder, folder)

    _check_folder(folder, form)
    with _writing(folder), locked(folder / f"{MANIFEST}.lock", f"process {os.getpid()}", waiting):
        return _export(dataset, folder, form, skip_broken, progress or (lambda done, total: None))


def _export(dataset: Dataset, folder: Path, form: Form, skip_broken: bool, progress: Progress) -> Exported:
    places, known = _places(dataset), _check_folder(folder, form)
    stamps = {place: _stamp(dataset, item) for place, item in zip(places, dataset.items, strict=True)}
    files = [[f"{place.parent}/{name}" for name in form.names(place.name)] for place in places]
    for place, own in zip(places, files, strict=True):
        if known.get(str(place), stamps[place]) != stamps[place]:
            for file in own:
                (folder / file).unlink(missing_ok=True)
    known |= {str(place): stamp for place, stamp in stamps.items()}
    _replace(folder / MANIFEST, json.dumps(_told(form) | {"objects": known}, indent=1).encode())
    for place in dict.fromkeys(place.parent for place in places):
        (folder / place).mkdir(parents=True, exist_ok=True)

    missing = {
        i: [n for n, file in enumerate(own) if not _is_whole(folder / file, form)]
        for i, own in enumerate(files)
    }
    todo = {i: numbers for i, numbers in missing.items() if numbers}
    done, broken = len(files) - len(todo), dict[int, str]()
    progress(done, len(files))
    job = {"source": dataset.source.spec(), "folder": str(folder), "form": asdict(form)}
    work = (
        (
            i,
            {
                "name": dataset.items[i].name,
                "item": asdict(dataset.items[i]),
                "numbers": n,
                "files": files[i],
            },
        )
        for i, n in todo.items()
    )
    processes = max(1, min(cores(), len(todo) // _SHARE))
    with closing(spread(f"{__name__}:exporter", job, work, processes=processes)) as answers:
        for i, answer in answers:
            if answer[:1] == BROKEN:
                broken[i] = answer[1:].decode()
            done += 1
            progress(done, len(files))
    if broken and not skip_broken:
        raise BrokenObjects(dataset, broken)
    report_left_out(dataset, broken)
    written = sum(len(numbers) for i, numbers in todo.items() if i not in broken)
    whole = len(files) - len(broken)
    return Exported(whole, whole * form.views, written)


@contextmanager
def exporter(job: Mapping[str, Any]) -> Iterator[Work]:
    """Writes pictures of items of the source of a job, see `workers.spread`."""
    import cv2  # checking a folder needs none of it

    from activelsd.scenery.orbit_renderer import render_depths

    source, folder, form = source_from(job["source"]), Path(job["folder"]), Form(**job["form"])
    assert isinstance(source, Drawn)

    def draw(item: Item, cameras: Sequence[Camera]) -> NDArray[np.uint8] | NDArray[np.uint16]:
        if form.kind == "shaded":
            return source.views(item, size=form.size, cameras=cameras)
        mesh = source.mesh(item)
        with naming(item.name):
            return render_depths(mesh, size=form.size, cameras=cameras)

    def write(piece: Mapping[str, Any]) -> bytes:
        item = Item(**{**piece["item"], "parts": tuple(piece["item"]["parts"])})
        cameras = [CAMERAS[form.views][number] for number in piece["numbers"]]
        try:
            pictures = draw(item, cameras)
        except DataError as error:
            return BROKEN + str(error).encode()
        with _writing(folder):
            for number, picture in zip(piece["numbers"], pictures, strict=True):
                _, data = cv2.imencode(".png", picture)
                _replace(folder / piece["files"][number], data.tobytes())
        return WHOLE

    yield write


def _places(dataset: Dataset) -> list[PurePosixPath]:
    """`CLASS/SPLIT/NAME` of every object."""
    splits: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for item in dataset.items:
        if item.split != "test":
            splits[item.category].append((item.name, item.split))
    # Those that reading the folder back holds out again stand in `train`.
    held_out = {
        category: own == sorted(own)
        and [split for _, split in own] == with_validation([name for name, _ in own])
        for category, own in splits.items()
    }
    places = []
    for item in dataset.items:
        split = "train" if item.split == "val" and held_out[item.category] else item.split
        name = PurePosixPath(item.name)
        # Objects of one name in several splits are called by their whole paths.
        short = name.name if len(name.parts) == 2 else name.stem
        places.append(PurePosixPath(item.category, split, short))
    names = Counter(places)
    unique = [
        place if names[place] == 1 else place.with_name("_".join(item.name.split("/")[1:]).replace(".", "_"))
        for place, item in zip(places, dataset.items, strict=True)
    ]
    for place, times in Counter(unique).items():
        if times > 1:
            raise DataError(f"Two objects would be exported as {place}; rename one of them.")
    return unique


def _stamp(dataset: Dataset, item: Item) -> str:
    """Changes with what an object is drawn from and how that is read, but not with where it lies."""
    source = {key: value for key, value in dataset.origin.items() if key != "from"}
    own = {key: value for key, value in asdict(item).items() if key not in ("name", "split")}
    return hashlib.sha256(json.dumps([source, own], sort_keys=True).encode()).hexdigest()[:16]


def _told(form: Form) -> dict[str, Any]:
    return {"format": "activelsd.export/1", **asdict(form), "code": code_digest(sources.__name__)}


def _check_folder(folder: Path, form: Form) -> dict[str, str]:
    """What each object in a folder was exported from; none if the folder is new or empty.

    Raises:
        DataError: it holds something else, or pictures of another form.
    """
    with _writing(folder):
        held = [path.name for path in islice(folder.iterdir(), 9)] if folder.exists() else []
    if all(name.startswith(f"{MANIFEST}.") for name in held):
        return {}
    told: dict[str, Any] = {}
    with suppress(OSError, ValueError):
        told = json.loads((folder / MANIFEST).read_text("utf-8"))
    if not isinstance(told, dict) or not isinstance(known := told.pop("objects", None), dict):
        raise DataError(f"{folder} holds something that is no export; name a new folder.")
    for key, now in _told(form).items():
        if told.get(key) != now:
            what = "another version of activelsd" if key in ("format", "code") else f"{key} {told.get(key)}"
            raise DataError(f"{folder} holds an export of {what}; name a new folder, or remove that one.")
    return known


def _is_whole(path: Path, form: Form) -> bool:
    """Whether a picture is there, of this size and depth, and ends as it should."""
    try:
        with path.open("rb") as file:
            head = file.read(26)
            file.seek(-len(_PNG_END), os.SEEK_END)
            end = file.read()
    except OSError:
        return False
    sides, bits = form.size.to_bytes(4, "big") * 2, 8 if form.kind == "shaded" else 16
    return head[:8] == _PNG and head[16:] == sides + bytes([bits, 0]) and end == _PNG_END


def _replace(path: Path, data: bytes) -> None:
    """Writes a file under a hidden name, then renames it."""
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_bytes(data)
    temporary.replace(path)


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turns an OSError inside into a DataError that names the folder."""
    try:
        yield
    except OSError as error:
        raise DataError(
            f"{folder} cannot be written ({error.strerror or error}); make room there or name another folder."
        ) from None
