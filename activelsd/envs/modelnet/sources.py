"""Where the views of objects come from: files of meshes, points or pictures, or embedded shapes.

A source can be described in JSON (`spec`), so that another process can make the same one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.cameras import Camera, Ring
from activelsd.envs.modelnet.files import Folder, Zip, open_files
from activelsd.envs.modelnet.pictures import decode
from activelsd.envs.modelnet.point_release import points_at
from activelsd.envs.modelnet.points import Points, decode_points
from activelsd.envs.modelnet.readers import read_mesh
from activelsd.envs.workers import Work
from activelsd.errors import DataError
from activelsd.scenery.meshes import Axis, Mesh
from activelsd.sections import Colour

_FOLDERS = ("train", "test")
"""Of embedded shapes; their order is part of the seeds."""


@dataclass(frozen=True, kw_only=True)
class Item:
    """An object of a dataset."""

    name: str  # CLASS/OBJECT, unique in its dataset
    category: str
    split: str  # train, val or test
    parts: tuple[str, ...]  # what its source makes it of: paths of files, or a file and a number in it
    stamp: str  # changes when the files of its parts do
    rings: tuple[Ring, ...] = ()  # where its pictures were taken, if their names tell
    up: Axis = "z"  # which of its files' axes points up
    fault: str = ""  # what is wrong with it already by the names of its files


class Source(Protocol):
    """Gives the views of the items of one dataset."""

    def views(self, item: Item, *, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
        """uint8 (V, [3,] size, size) from every camera; in gray but for colour pictures.

        Raises:
            DataError: with the name of what is broken.
        """
        ...

    def check(self, item: Item) -> None:
        """Raises DataError, as `views` would, as far as that is known before anything is rendered."""
        ...

    def spec(self) -> dict[str, str | int]:
        """The description that `source_from` makes the same source from."""
        ...


@runtime_checkable
class Drawn(Source, Protocol):
    """A source whose views are drawn, from a mesh or from what stands for one."""

    def mesh(self, item: Item) -> Mesh:
        """What is drawn. Raises DataError that names the file if it is broken."""
        ...


@dataclass(frozen=True, kw_only=True)
class MeshFiles:
    """Meshes of a folder or zip."""

    files: Folder | Zip

    def mesh(self, item: Item) -> Mesh:
        """The mesh of an item. Raises DataError that names the file if it is broken."""
        (path,) = item.parts
        return read_mesh(self.files, path, item.up)

    def views(self, item: Item, *, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
        """See `Source`."""
        return _rendered(self.mesh(item), self.files.where(item.parts[0]), size, cameras)

    def check(self, item: Item) -> None:
        """See `Source`."""
        from activelsd.scenery.orbit_renderer import check_mesh

        mesh = self.mesh(item)
        with naming(self.files.where(item.parts[0])):
            check_mesh(mesh)

    def spec(self) -> dict[str, str | int]:
        """See `Source`."""
        return {"kind": "meshes", "path": str(self.files.root)}


@dataclass(frozen=True, kw_only=True)
class PointFiles:
    """Point clouds of a folder or zip, drawn as discs."""

    files: Folder | Zip

    def mesh(self, item: Item) -> Mesh:
        """The discs of an item. Raises DataError that names the file if it is broken."""
        from activelsd.scenery.discs import disc_mesh  # meshes and pictures do without it

        points = self._points(item)
        with naming(self._name(item)):
            return disc_mesh(points.positions, points.normals)

    def views(self, item: Item, *, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
        """See `Source`."""
        return _rendered(self.mesh(item), self._name(item), size, cameras)

    def check(self, item: Item) -> None:
        """See `Source`."""
        from activelsd.scenery.discs import distinct

        points = self._points(item)
        with naming(self._name(item)):
            distinct(points.positions)

    def _points(self, item: Item) -> Points:
        path, *row = item.parts
        if row:
            return points_at(self.files, path, int(row[0])).turned(item.up)
        return decode_points(self.files.read(path), self.files.where(path)).turned(item.up)

    def _name(self, item: Item) -> str:
        return self.files.where(" ".join(item.parts))

    def spec(self) -> dict[str, str | int]:
        """See `Source`."""
        return {"kind": "points", "path": str(self.files.root)}


@dataclass(frozen=True, kw_only=True)
class PictureFiles:
    """Views rendered or photographed by others, in a folder or zip."""

    files: Folder | Zip
    colour: Colour = "gray"

    def views(self, item: Item, *, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
        """See `Source`; the cameras are those they were taken with."""
        del cameras
        if item.fault:
            raise DataError(item.fault)
        return np.stack(
            [decode(self.files.read(path), self.files.where(path), size, self.colour) for path in item.parts]
        )

    def check(self, item: Item) -> None:
        """See `Source`; to read pictures is all there is to do with them."""

    def spec(self) -> dict[str, str | int]:
        """See `Source`."""
        own = {"colour": self.colour} if self.colour != "gray" else {}  # caches of gray views are older
        return {"kind": "pictures", "path": str(self.files.root), **own}


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """The embedded shapes, drawn by number: asking for more of them leaves the earlier ones as they are."""

    seed: int

    def mesh(self, item: Item) -> Mesh:
        """The shape of an item, whose parts are `train` or `test` and its number there."""
        from activelsd.scenery.shapes import CATEGORIES, make_shape  # keeps OFF files fast

        folder, number = item.parts
        words = (self.seed, _FOLDERS.index(folder), CATEGORIES.index(item.category), int(number))
        return make_shape(item.category, np.random.default_rng(np.random.SeedSequence(words)))

    def views(self, item: Item, *, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
        """See `Source`."""
        return _rendered(self.mesh(item), f"The embedded shape {item.name}", size, cameras)

    def check(self, item: Item) -> None:
        """See `Source`; a shape cannot be broken."""

    def spec(self) -> dict[str, str | int]:
        """See `Source`."""
        return {"kind": "shapes", "seed": self.seed}


def source_from(spec: dict[str, str | int]) -> Source:
    """The source that `spec` came from.

    Raises:
        DataError: its files are gone.
    """
    if spec["kind"] == "shapes":
        return Shapes(seed=int(spec["seed"]))
    files = open_files(Path(str(spec["path"])))
    if spec["kind"] == "pictures":
        return PictureFiles(files=files, colour="rgb" if spec.get("colour") == "rgb" else "gray")
    return FILES[str(spec["kind"])](files=files)


FILES: Mapping[str, type[MeshFiles] | type[PointFiles] | type[PictureFiles]] = {
    "meshes": MeshFiles,
    "points": PointFiles,
    "pictures": PictureFiles,
}
"""What makes the views, by the kind of the files."""


WHOLE, BROKEN = b"+", b"-"
"""First byte of what `renderer` and `checker` return: the rest is the result, or why there is none."""


@contextmanager
def renderer(job: Mapping[str, Any]) -> Iterator[Work]:
    """Makes the views of items from the source of a job, see `workers.spread`."""
    source = source_from(job["source"])
    cameras = [Camera(*camera) for camera in job["cameras"]]
    yield work_on(lambda item: source.views(item, size=job["size"], cameras=cameras).tobytes())


@contextmanager
def checker(job: Mapping[str, Any]) -> Iterator[Work]:
    """Checks items of the source of a job, see `workers.spread`."""
    source = source_from(job["source"])

    def check(item: Item) -> bytes:
        source.check(item)
        return b""

    yield work_on(check)


def work_on(do: Callable[[Item], bytes]) -> Work:
    """Work that does something with every item, and whose result says whether the item is broken."""

    def work(item: Mapping[str, Any]) -> bytes:
        try:
            return WHOLE + do(Item(**{**item, "parts": tuple(item["parts"])}))
        except DataError as error:
            return BROKEN + str(error).encode()

    return work


def _rendered(mesh: Mesh, name: str, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
    from activelsd.scenery.orbit_renderer import render_views  # embree is not needed for pictures

    with naming(name):
        return render_views(mesh, size=size, cameras=cameras)


@contextmanager
def naming(name: str) -> Iterator[None]:
    """Adds the name of the object to a DataError inside."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{name} cannot be rendered: {str(error)[0].lower()}{str(error)[1:]}") from None
