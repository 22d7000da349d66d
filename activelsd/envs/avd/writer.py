"""Writes sample scans: photographs of furnished rooms, on disk as the Active Vision Dataset's scans are.

The format is the current release's (Ammirato et al., ICRA 2017, and the data set's page). Reconstruction
coordinates have y pointing down and a unit of their own for each scan, which `scale` makes millimetres.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from importlib import resources
from io import BytesIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from activelsd.envs.avd.boxes import Box, visible_boxes
from activelsd.envs.avd.homes import DEFAULT_SCANS, HEADINGS, INSTANCES, MOVES, Home, parsed
from activelsd.envs.cache import alone, writing
from activelsd.envs.cores import cores
from activelsd.errors import ConfigError, DataError
from activelsd.scenery.rooms.room_renderer import Camera, Picture

_POINTS = 4
"""Points of the grid that a process photographs at a time."""

_JPEG_QUALITY, _PNG_COMPRESSION = 93, 1
_MILLIMETRES = 1000
_MOST_DEPTH = 65_535  # millimetres
_MAT_HEADER = b"MATLAB 5.0 MAT-file".ljust(116)  # SciPy would put the time of day there
_SOURCES = (
    ("activelsd.envs.avd", ("homes.py", "boxes.py", "writer.py")),
    ("activelsd.scenery.rooms", None),
    ("activelsd.scenery.shapes", None),
)
"""Modules, None for all of a package, on which what is written depends."""


class _Job(NamedTuple):
    """Photographs that one process takes in one go."""

    scan: str
    seed: int
    width: int
    height: int
    folder: str
    first: int  # point of the lattice
    last: int  # one past


def write_sample(
    root: Path,
    *,
    scans: Sequence[str] = DEFAULT_SCANS,
    width: int = 480,
    height: int = 270,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    workers: int | None = None,
) -> Path:
    """Write sample scans into a folder; whole scans that are there already stay.

    The same arguments give the same bytes. A scan is written beside its place and put there when it is whole,
    so what an interruption leaves is gone on with, scan by scan.

    Args:
        root: folder for them, made if need be; the world's instance map is put there too.
        scans: their names, like `Home_001_1`; scans of one home share the furniture.
        width: of the photographs in pixels.
        height: of the photographs in pixels.
        seed: draws homes and where things stand in them.
        progress: called with the number of photographs taken and of all, at the start and as they are taken.
        workers: how many processes take them; None for as many as there are cores, 1 for this one.

    Returns:
        `root`.

    Raises:
        ConfigError: a name cannot be a scan's, or the size cannot be a photograph's.
        DataError: the folder holds a sample of other settings, cannot be written, or is being written to.
    """
    for name in scans:
        parsed(name)
    if min(width, height) < 16:
        raise ConfigError(f"Photographs of {width}x{height} pixels cannot be; choose sides of at least 16.")
    with writing(root):
        root.mkdir(parents=True, exist_ok=True)
    with alone(root / "sample"), writing(root):
        _claim(root, {"width": width, "height": height, "seed": seed, "code": code_digest()})
        rows = ["background 0", *(f"{name} {i}" for i, name in enumerate(INSTANCES, start=1))]
        (root / "instance_id_map.txt").write_text("\n".join(rows) + "\n")
        points = {name: len(_home(name, seed).lattice.points) for name in scans}
        report = progress or (lambda done, total: None)
        total = HEADINGS * sum(points.values())
        done = HEADINGS * sum(points[name] for name in scans if (root / name).is_dir())
        report(done, total)
        todo = [name for name in scans if not (root / name).is_dir()]
        jobs = [job for name in todo for job in _jobs(root, name, seed, width, height, points[name])]
        boxes: dict[str, list[Box]] = {}
        with _photographed(jobs, workers) as found:
            for job, taken in zip(jobs, found, strict=True):
                boxes |= taken
                done += len(taken)
                report(done, total)
                if job.last == points[job.scan]:
                    _complete(root, job, boxes)
                    boxes = {}
    return root


def _claim(root: Path, settings: dict[str, int | str]) -> None:
    """Note what the sample in the folder is made from, or refuse one that is of something else."""
    note = root / "sample.json"
    if note.exists():
        if note.read_text() != json.dumps(settings):
            raise DataError(f"{root} holds a sample of other settings; remove it or name another folder.")
    elif any(path.name != "sample.lock" for path in root.iterdir()):
        raise DataError(f"{root} holds other things than sample scans; name an empty or a new folder.")
    else:
        note.write_text(json.dumps(settings))


def code_digest() -> str:
    """A digest of the modules that draw homes and photograph them."""
    digest = hashlib.sha256()
    for package, names in _SOURCES:
        for module in sorted(resources.files(package).iterdir(), key=lambda m: m.name):
            if module.name.endswith(".py") and (names is None or module.name in names):
                digest.update(module.read_bytes())
    return digest.hexdigest()[:16]


def _jobs(root: Path, name: str, seed: int, width: int, height: int, points: int) -> list[_Job]:
    """A scan's photographs shared out, its folder made anew."""
    folder = _unfinished(root, name)
    shutil.rmtree(folder, ignore_errors=True)
    for part in ("jpg_rgb", "high_res_depth"):
        (folder / part).mkdir(parents=True)
    firsts = range(0, points, _POINTS)
    return [
        _Job(name, seed, width, height, str(folder), first, min(first + _POINTS, points)) for first in firsts
    ]


def _unfinished(root: Path, name: str) -> Path:
    return root / f".{name}.partial"


@contextmanager
def _photographed(jobs: Sequence[_Job], workers: int | None) -> Iterator[Iterator[dict[str, list[Box]]]]:
    """The boxes of every job's photographs, by file name, in order of the jobs."""
    count = min(workers or cores(), len(jobs))
    if count <= 1:
        yield map(_photograph, jobs)
        return
    pool = ProcessPoolExecutor(count, get_context("spawn"), initializer=_undisturbed)
    try:
        yield pool.map(_photograph, jobs)
    finally:
        pool.shutdown(cancel_futures=True)


def _undisturbed() -> None:
    """Ctrl-C is for the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@lru_cache(maxsize=2)
def _home(name: str, seed: int) -> Home:
    return Home(name, seed)


def _photograph(job: _Job) -> dict[str, list[Box]]:
    """Take and write the photographs of some points; their boxes by file name."""
    home, scan, folder = _home(job.scan, job.seed), parsed(job.scan), Path(job.folder)
    boxes = {}
    for point in range(job.first, job.last):
        for heading in range(HEADINGS):
            picture = home.look(home.camera(point, heading, job.width, job.height))
            index = _index(point, heading)
            stem = scan.image(index, "01")
            _write(folder / "jpg_rgb" / f"{stem}.jpg", _jpeg(picture))
            _write(folder / "high_res_depth" / f"{scan.image(index, '03')}.png", _png(picture))
            boxes[f"{stem}.jpg"] = visible_boxes(home.instance_of[picture.things])
    return boxes


def _index(point: int, heading: int) -> int:
    """Images count from 1, point after point."""
    return point * HEADINGS + heading + 1


def _jpeg(picture: Picture) -> NDArray[np.uint8]:
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    return cv2.imencode(".jpg", picture.colour[..., ::-1], options)[1]


def _png(picture: Picture) -> NDArray[np.uint8]:
    millimetres = np.minimum(np.rint(picture.depth * _MILLIMETRES), _MOST_DEPTH).astype(np.uint16)
    return cv2.imencode(".png", millimetres, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_COMPRESSION])[1]


def _write(path: Path, data: NDArray[np.uint8]) -> None:
    path.write_bytes(data.tobytes())


def _complete(root: Path, job: _Job, boxes: dict[str, list[Box]]) -> None:
    """Write what is one for the scan, and put it in its place."""
    home, folder = _home(job.scan, job.seed), Path(job.folder)
    (folder / "annotations.json").write_text(json.dumps(_annotations(home, job.scan, boxes)))
    scale = float(np.random.default_rng((job.seed, *parsed(job.scan))).uniform(200, 900))
    matrices = BytesIO()
    savemat(matrices, {"image_structs": _structs(home, job, scale), "scale": scale})
    undated = _MAT_HEADER + matrices.getvalue()[len(_MAT_HEADER) :]
    (folder / "image_structs.mat").write_bytes(undated)
    (folder / "present_instance_names.txt").write_text("\n".join(home.present) + "\n")
    (folder / "cameras.txt").write_text(_camera_text(home.camera(0, 0, job.width, job.height)))
    folder.rename(root / job.scan)


def _annotations(home: Home, name: str, boxes: dict[str, list[Box]]) -> dict[str, Any]:
    """Boxes and moves by file name."""
    scan = parsed(name)
    entries: dict[str, Any] = {}
    for point in range(len(home.lattice.points)):
        for heading in range(HEADINGS):
            file = f"{scan.image(_index(point, heading), '01')}.jpg"
            entries[file] = {"bounding_boxes": boxes[file]}
            for move in MOVES:
                there = home.move(point, heading, move)
                entries[file][move] = "" if there is None else f"{scan.image(_index(*there), '01')}.jpg"
    return entries


def _structs(home: Home, job: _Job, scale: float) -> NDArray[Any]:
    """The 1 by N struct of poses; X_camera = R X_world + t, cameras looking along z with y down."""
    scan = parsed(job.scan)
    names = ("image_name", "t", "R", "world_pos", "direction", "cluster_id", "rotate_cw", "rotate_ccw")
    points = len(home.lattice.points)
    structs = np.empty((1, points * HEADINGS), dtype=[(name, object) for name in names])
    for point in range(points):
        for heading in range(HEADINGS):
            camera = home.camera(point, heading, job.width, job.height)
            rotation = _in_world(camera.axes)
            place = _in_world(np.array([(camera.x, camera.y, camera.z)]))[0] * (_MILLIMETRES / scale)
            turned = [home.move(point, heading, move) or (point, heading) for move in names[-2:]]
            structs[0, _index(point, heading) - 1] = (
                f"{scan.image(_index(point, heading), '01')}.jpg",
                -(rotation * place).sum(axis=1).reshape(3, 1),
                rotation,
                place.reshape(3, 1),
                rotation[2].reshape(3, 1),
                point,
                *(f"{scan.image(_index(*pose), '01')}.jpg" for pose in turned),
            )
    return structs


def _in_world(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (N, 3) of the room, z up, in the reconstruction's axes: the floor is x and z, y points down."""
    return np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], axis=1)


def _camera_text(camera: Camera) -> str:
    """COLMAP's list of one camera."""
    f, x, y = camera.focal, camera.width / 2, camera.height / 2
    return (
        "# Camera list with one line of data per camera:\n"
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        "# Number of cameras: 1\n"
        f"1 OPENCV {camera.width} {camera.height} {f:.6f} {f:.6f} {x:.6f} {y:.6f} 0 0 0 0\n"
    )
