"""Reads one scan folder of the Active Vision Dataset's current release: photographs, boxes and moves.

Format (Ammirato et al., ICRA 2017, and the data set's page): photographs in `jpg_rgb`, boxes and moves in
`annotations.json`, poses in `image_structs.mat`. The format does not define what file names mean, so names
are only looked up, never computed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any
from zlib import error as ZlibError

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.avd.photographs import read_photograph
from activelsd.envs.avd.settings import MOVES
from activelsd.envs.images import ENDINGS
from activelsd.errors import DataError, did_you_mean

PHOTOGRAPHS, ANNOTATIONS, POSES = "jpg_rgb", "annotations.json", "image_structs.mat"
PRESENT, INSTANCES = "present_instance_names.txt", "instance_id_map.txt"
BACKGROUND = "background"

MOST_BYTES, MOST_ENTRIES = 64 * 2**20, 100_000
"""Limits for a scan's text files; the largest scan describes about 2,400 photographs in a few MB."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """V photographs of one scan and P boxes in them, in the order of the views. Shapes: see the fields."""

    name: str
    files: tuple[Path, ...]  # V photographs, sorted by name
    width: int  # of every photograph, in pixels
    height: int
    moves: NDArray[np.int32]  # (V, 6) view that each of MOVES leads to, -1 if it is blocked
    poses: NDArray[np.float32]  # (V, 3) x and z in metres, heading in degrees; NaN if unknown
    box_view: NDArray[np.int32]  # (P,) view of each box, ascending
    box_instance: NDArray[np.int32]  # (P,) id in the instance map; at most one box per view and instance
    boxes: NDArray[np.int32]  # (P, 4) xmin, ymin, xmax, ymax in pixels, half-open, inside the photograph
    difficulty: NDArray[np.uint8]  # (P,) 1 (easiest) to 5


def read_instances(root: Path) -> dict[str, int]:
    """The data set's instances, name to id, sorted by id, without the background.

    Raises:
        DataError: the map is missing, a line is not `name id`, or two lines contradict each other.
    """
    file, ids = root / INSTANCES, dict[str, int]()
    for line in map(str.strip, _text(file).splitlines()):
        name, number = (part.strip() for part in line.rpartition(" ")[::2])
        if not line or name == BACKGROUND:
            continue
        if not name or not number.isdecimal():
            raise DataError(f"{file} needs lines like `name id`, not '{line[:40]}'; correct it.")
        if ids.get(name, int(number)) != int(number):
            raise DataError(f"{file} gives '{name[:40]}' two ids; correct it.")
        if int(number) in ids.values() and name not in ids:
            raise DataError(f"{file} gives the id {number} twice, also to '{name[:40]}'; correct it.")
        ids[name] = int(number)
    if not ids:
        raise DataError(f"{file} names no instance; copy it from the data set again.")
    return dict(sorted(ids.items(), key=lambda item: item[1]))


def photographs_of(folder: Path) -> dict[str, Path]:
    """The photographs on disk, by file name without its ending and sorted by it.

    Raises:
        DataError: there are none, one is there twice, or the folder is not a scan of this release.
    """
    check_release(folder)
    found: dict[str, Path] = {}
    try:
        for path in sorted((folder / PHOTOGRAPHS).iterdir()):
            if path.suffix.lower() in ENDINGS and not path.name.startswith("."):
                if path.stem in found:
                    twice = f"{found[path.stem].name} and {path} are the same photograph"
                    raise DataError(f"{twice}; remove one of them.")
                found[path.stem] = path
    except OSError as error:
        raise _unreadable(folder / PHOTOGRAPHS, error) from None
    if not found:
        raise DataError(f"{folder / PHOTOGRAPHS} contains no photograph; unpack the scan's jpg files there.")
    return found


def check_release(folder: Path) -> None:
    """Raises DataError if a folder is a scan of the data set's older release, which is not supported."""
    if not (folder / ANNOTATIONS).exists() and (folder / "rgb").is_dir():
        raise DataError(
            f"{folder} is a scan of the data set's older release (rgb/ and annotations/*_boxes.txt), which"
            f" is not supported; download {folder.name} in the current one, with {ANNOTATIONS}."
        )


def read_scan(folder: Path, instances: Mapping[str, int]) -> Scan:
    """Reads a scan.

    A view is a photograph that is on disk *and* in the annotations, whatever its ending is there; a move that
    leads to anything else is blocked. Boxes are clipped to the photograph, and dropped if nothing remains. If
    an instance has several boxes in one photograph (some products are in a scene twice), the largest is kept.

    Args:
        folder: the scan's folder, named like `Home_001_1`.
        instances: name to id, from `read_instances`.

    Raises:
        DataError: a file is missing, truncated or in another format, or names a photograph outside the scan.
    """
    on_disk = photographs_of(folder)
    file = folder / ANNOTATIONS
    entries = _entries(file)
    names = [name for name in on_disk if name in entries]
    if not names:
        raise DataError(f"{file} describes none of the photographs in {folder / PHOTOGRAPHS}; copy it again.")
    _check_present(folder / PRESENT, instances)
    first = read_photograph(on_disk[names[0]])
    height, width = first.shape
    index = {name: view for view, name in enumerate(names)}
    box_view, rows = _boxes(
        file, [(on_disk[name].name, entries[name]) for name in names], instances, (width, height)
    )
    return Scan(
        name=folder.name,
        files=tuple(on_disk[name] for name in names),
        width=width,
        height=height,
        moves=np.array(
            [[index.get(_stem(entries[name][move]), -1) for move in MOVES] for name in names], np.int32
        ),
        poses=_poses(folder / POSES, names),
        box_view=box_view,
        box_instance=rows[:, 4],
        boxes=rows[:, :4],
        difficulty=rows[:, 5].astype(np.uint8),
    )


def _entries(file: Path) -> dict[str, dict[str, Any]]:
    """The annotations by photograph, without its ending; every move is a checked file name or empty."""
    try:
        entries = json.loads(_text(file))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{file} is not complete JSON ({str(error)[:60]}); copy it again.") from None
    if not isinstance(entries, dict):
        raise DataError(f"{file} must contain one object with a key per photograph; copy it again.")
    if len(entries) > MOST_ENTRIES:
        raise DataError(
            f"{file} describes {len(entries)} photographs, more than any scan has ({MOST_ENTRIES} at most);"
            " copy it again."
        )
    for name, entry in entries.items():
        if not isinstance(entry, dict) or not isinstance(entry.get("bounding_boxes", []), list):
            raise DataError(f"{file} has no boxes and moves for '{name[:60]}'; copy it again.")
        _check_name(file, name)
        for move in MOVES:
            _check_name(file, entry.setdefault(move, ""))
    return {_stem(name): entry for name, entry in entries.items()}


def _stem(name: str) -> str:
    """A photograph's name without its ending, which may be written otherwise on disk: .JPG, .jpeg."""
    return PurePath(name).stem


def _check_name(file: Path, name: object) -> None:
    if not isinstance(name, str):
        raise DataError(
            f"{file} names a photograph {str(name)[:60]}, which is not a file name; copy it again."
        )
    if any(mark in name for mark in "/\\\0") or name in (".", ".."):
        raise DataError(
            f"{file} names '{name[:60]}', which is outside the scan's folder; download the scan from a"
            " source you trust."
        )


def _check_present(file: Path, instances: Mapping[str, int]) -> None:
    """Checks that the map has every listed instance; the list has no other use, boxes say what is seen."""
    for name in filter(None, map(str.strip, _text(file).splitlines())):
        if name not in instances and name != BACKGROUND:
            hint = did_you_mean(name, instances, f"add it to {INSTANCES} or remove it.")
            raise DataError(f"{file} names '{name[:60]}', which is not in {INSTANCES}; {hint}")


def _boxes(
    file: Path,
    entries: Sequence[tuple[str, Mapping[str, Any]]],
    instances: Mapping[str, int],
    size: tuple[int, int],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """View (P,), and (P, 6) xmin, ymin, xmax, ymax, instance, difficulty of every box that is kept."""
    known, width, height = set(instances.values()), *size
    kept: dict[tuple[int, int], tuple[int, ...]] = {}
    for view, (name, entry) in enumerate(entries):
        for box in entry.get("bounding_boxes", []):
            x0, y0, x1, y1, instance, grade = _numbers(file, name, box)
            if instance not in known:
                raise DataError(
                    f"{file} has instance {instance} in '{name}', but {INSTANCES} does not; copy both again."
                )
            x0, x1 = max(x0, 0), min(x1, width)
            y0, y1 = max(y0, 0), min(y1, height)
            if x1 <= x0 or y1 <= y0:
                continue
            other = kept.get((view, instance))
            if other is None or _area(other) < (x1 - x0) * (y1 - y0):
                kept[view, instance] = (x0, y0, x1, y1, instance, grade)
    pairs = sorted(kept)
    rows = np.array([kept[pair] for pair in pairs], np.int32).reshape(-1, 6)
    return np.array([view for view, _ in pairs], np.int32), rows


def _numbers(file: Path, name: str, box: object) -> list[int]:
    try:
        numbers = np.asarray(box, np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if numbers.shape != (6,) or not (np.abs(numbers) < 2**31).all() or not 0 <= numbers[5] <= 255:
        raise DataError(
            f"{file} has a box {str(box)[:60]} in '{name}', which is not"
            " [xmin, ymin, xmax, ymax, instance, difficulty]; copy it again."
        )
    return [int(number) for number in np.rint(numbers)]


def _area(box: tuple[int, ...]) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _poses(file: Path, names: Sequence[str]) -> NDArray[np.float32]:
    """(V, 3) poses of the named photographs; NaN for those whose R is 0x0 or that have no row."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    _check_size(file)
    try:
        content = loadmat(file, variable_names=("image_structs", "scale"))
        scale = float(content["scale"].ravel()[0])
        rows = content["image_structs"].ravel()
        found = {
            _stem(str(row["image_name"].ravel()[0])): _pose(row, scale)
            for row in rows
            if row["image_name"].size
        }
    except OSError as error:
        raise _unreadable(file, error) from None
    except (
        MatReadError,
        NotImplementedError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        ZlibError,
    ) as error:
        # SciPy's error for a truncated or foreign file depends on where reading fails.
        raise DataError(f"{file} is not a table of poses ({str(error)[:60]}); copy it again.") from None
    unknown = (np.nan,) * 3
    return np.array([found.get(name, unknown) for name in names], np.float32)


def _pose(row: Any, scale: float) -> tuple[float, float, float]:
    """x and z on the floor in metres, and the heading in degrees; `world_pos` x `scale` is in millimetres."""
    place, ahead = (np.asarray(row[key], np.float64).ravel() for key in ("world_pos", "direction"))
    if np.size(row["R"]) == 0 or len(place) < 3 or len(ahead) < 3:
        return (np.nan,) * 3
    metres = place * scale / 1000
    return float(metres[0]), float(metres[2]), float(np.degrees(np.arctan2(ahead[0], ahead[2])))


def _text(file: Path) -> str:
    _check_size(file)
    try:
        return file.read_text("utf-8-sig")
    except OSError as error:
        raise _unreadable(file, error) from None
    except UnicodeDecodeError:
        raise DataError(f"{file} is not a text file; copy it again.") from None


def _check_size(file: Path) -> None:
    try:
        size = file.stat().st_size
    except OSError as error:
        raise _unreadable(file, error) from None
    if size > MOST_BYTES:
        raise DataError(
            f"{file} has {size // 2**20} MiB, more than any scan's ({MOST_BYTES // 2**20} at most); copy it"
            " from the data set again."
        )


def _unreadable(file: Path, error: OSError) -> DataError:
    return DataError(f"{file} cannot be read ({error.strerror or error}); copy the scan again.")
