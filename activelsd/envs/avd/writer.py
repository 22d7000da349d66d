"""Writes sample scans: photographs of furnished rooms, on disk as the Active Vision Dataset's scans are.

The format is the current release's (Ammirato et al., ICRA 2017, and the data set's page). Reconstruction
coordinates have y pointing down and a unit of their own for each scan, which `scale` makes millimetres.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from activelsd.envs.avd.boxes import Box, visible_boxes
from activelsd.envs.avd.homes import DEFAULT_SCANS, HEADINGS, INSTANCES, MOVES, Home, parsed
from activelsd.envs.avd.settings import SAMPLE_NOTE
from activelsd.envs.cache import alone, writing
from activelsd.envs.cores import cores
from activelsd.envs.digest import code_digest
from activelsd.envs.workers import Item, Work, spread
from activelsd.errors import DataError
from activelsd.scenery.rooms.room_renderer import Camera, Picture

_POINTS = 4
"""Points of the grid that a process photographs at a time."""

_JPEG_QUALITY, _PNG_COMPRESSION = 93, 1
_MILLIMETRES = 1000
_MOST_DEPTH = 65_535  # millimetres
_MAT_HEADER = b"MATLAB 5.0 MAT-file".ljust(116)  # SciPy would put the time of day there


class _Job(NamedTuple):
    """Photographs that one process takes in one go."""

    name: str  # of the scan
    folder: str
    first: int  # point of the lattice
    last: int  # one past


class _Sample(NamedTuple):
    """What all photographs have in common."""

    seed: int
    width: int
    height: int


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

    The same arguments give the same bytes. A scan is written beside its place and moved there when it is
    whole, so the next call resumes an interrupted one with the scans that are left. If another process writes
    to the folder, this one waits and goes on with what is left.

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
        ConfigError: a name cannot be a scan's.
        DataError: the folder holds a sample of other settings, or cannot be written.
    """
    for name in scans:
        parsed(name)
    with alone(root / "sample"), writing(root):
        _claim(root, {"width": width, "height": height, "seed": seed, "code": code_digest(__name__)})
        rows = ["background 0", *(f"{name} {i}" for i, name in enumerate(INSTANCES, start=1))]
        (root / "instance_id_map.txt").write_text("\n".join(rows) + "\n")
        points = {name: len(_home(name, seed).lattice.points) for name in scans}
        report = progress or (lambda done, total: None)
        total = HEADINGS * sum(points.values())
        done = HEADINGS * sum(points[name] for name in scans if (root / name).is_dir())
        report(done, total)
        todo = [name for name in scans if not (root / name).is_dir()]
        jobs = [job for name in todo for job in _jobs(root, name, points[name])]
        sample = _Sample(seed, width, height)
        left = Counter(job.name for job in jobs)
        boxes: dict[str, dict[str, list[Box]]] = {name: {} for name in todo}
        work = spread(
            f"{__name__}:photographer",
            sample._asdict(),
            ((i, job._asdict()) for i, job in enumerate(jobs)),
            processes=max(1, min(workers or cores(), len(jobs))),
        )
        with closing(work):
            for i, data in work:
                job, taken = jobs[i], json.loads(data)
                boxes[job.name] |= taken
                left[job.name] -= 1
                done += len(taken)
                report(done, total)
                if not left[job.name]:
                    _complete(root, sample, job, boxes.pop(job.name))
    return root


def _claim(root: Path, settings: dict[str, int | str]) -> None:
    """Note what the sample in the folder is made from, or refuse a folder that holds something else."""
    note = root / SAMPLE_NOTE
    if note.exists():
        if note.read_text() != json.dumps(settings):
            raise DataError(f"{root} holds a sample of other settings; remove it or name another folder.")
    elif any(path.name != "sample.lock" for path in root.iterdir()):
        raise DataError(f"{root} holds other things than sample scans; name an empty or a new folder.")
    else:
        note.write_text(json.dumps(settings))


def _jobs(root: Path, name: str, points: int) -> list[_Job]:
    """A scan's photographs in parts; its folder is made anew."""
    folder = _unfinished(root, name)
    shutil.rmtree(folder, ignore_errors=True)
    for part in ("jpg_rgb", "high_res_depth"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    firsts = range(0, points, _POINTS)
    return [_Job(name, str(folder), first, min(first + _POINTS, points)) for first in firsts]


def _unfinished(root: Path, name: str) -> Path:
    return root / f".{name}.partial"


@contextmanager
def photographer(job: Mapping[str, Any]) -> Iterator[Work]:
    """Takes the photographs of parts of scans, see `workers.spread`; returns their boxes in JSON."""
    sample = _Sample(**job)

    def photograph(item: Item) -> bytes:
        with writing(Path(item["folder"]).parent):
            return json.dumps(_photograph(sample, _Job(**item))).encode()

    yield photograph


@lru_cache(maxsize=2)
def _home(name: str, seed: int) -> Home:
    return Home(name, seed)


def _photograph(sample: _Sample, job: _Job) -> dict[str, list[Box]]:
    """Take and write the photographs of some points; returns their boxes by file name."""
    home, scan, folder = _home(job.name, sample.seed), parsed(job.name), Path(job.folder)
    boxes = {}
    for point in range(job.first, job.last):
        for heading in range(HEADINGS):
            picture = home.look(home.camera(point, heading, sample.width, sample.height))
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


def _complete(root: Path, sample: _Sample, job: _Job, boxes: dict[str, list[Box]]) -> None:
    """Write the files that a scan has one of, and move it to its place."""
    home, folder = _home(job.name, sample.seed), Path(job.folder)
    (folder / "annotations.json").write_text(json.dumps(_annotations(home, job.name, boxes)))
    scale = float(np.random.default_rng((sample.seed, *parsed(job.name))).uniform(200, 900))
    matrices = BytesIO()
    savemat(matrices, {"image_structs": _structs(home, sample, job.name, scale), "scale": scale})
    undated = _MAT_HEADER + matrices.getvalue()[len(_MAT_HEADER) :]
    (folder / "image_structs.mat").write_bytes(undated)
    (folder / "present_instance_names.txt").write_text("\n".join(home.present) + "\n")
    (folder / "cameras.txt").write_text(_camera_text(home.camera(0, 0, sample.width, sample.height)))
    folder.rename(root / job.name)


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


def _structs(home: Home, sample: _Sample, name: str, scale: float) -> NDArray[Any]:
    """The 1 by N struct of poses; X_camera = R X_world + t, cameras looking along z with y down."""
    scan = parsed(name)
    fields = ("image_name", "t", "R", "world_pos", "direction", "cluster_id", "rotate_cw", "rotate_ccw")
    points = len(home.lattice.points)
    structs = np.empty((1, points * HEADINGS), dtype=[(field, object) for field in fields])
    for point in range(points):
        for heading in range(HEADINGS):
            camera = home.camera(point, heading, sample.width, sample.height)
            rotation = _in_world(camera.axes)
            place = _in_world(np.array([(camera.x, camera.y, camera.z)]))[0] * (_MILLIMETRES / scale)
            turned = [home.move(point, heading, move) or (point, heading) for move in fields[-2:]]
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
