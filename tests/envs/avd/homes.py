"""Scans written by hand from the description of the format alone; no code of the project's is used."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.io import savemat

INSTANCES = ("advil_liqui_gels", "coca_cola_glass_bottle", "red_bull", "hunts_sauce")
WIDTH, HEIGHT = 160, 90


def name(index: int, scene: str = "0001", scan: int = 1) -> str:
    """File name of a photograph: type and scene, scan, index from 1, camera, 01 for colour."""
    return f"{scene}{scan}{index:06d}0101.jpg"


def entry(boxes: Sequence[Sequence[int]] = (), **moves: str) -> dict[str, Any]:
    """What the annotations say of a photograph; moves that are not named are empty."""
    ways = ("rotate_ccw", "rotate_cw", "forward", "backward", "left", "right")
    return {"bounding_boxes": [list(box) for box in boxes], **{way: moves.get(way, "") for way in ways}}


def pose(
    image: str, x: float = 0.0, z: float = 0.0, towards: tuple[float, float] = (0.0, 1.0)
) -> dict[str, Any]:
    """A row of image_structs, in units of `scale`."""
    return {
        "image_name": image,
        "t": np.zeros((3, 1)),
        "R": np.eye(3),
        "world_pos": np.array([[x], [0.3], [z]]),
        "direction": np.array([[towards[0]], [0.0], [towards[1]]]),
        "cluster_id": 1.0,
        "rotate_cw": -1.0,
        "rotate_ccw": -1.0,
    }


def write_map(root: Path, names: Sequence[str] = INSTANCES) -> None:
    root.mkdir(parents=True, exist_ok=True)
    lines = ["background 0", *(f"{one} {i}" for i, one in enumerate(names, 1))]
    (root / "instance_id_map.txt").write_text("\n".join(lines) + "\n")


def photograph(path: Path, seed: int = 0, size: tuple[int, int] = (WIDTH, HEIGHT)) -> None:
    blocks = np.random.default_rng(seed).integers(0, 256, (9, 16), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), cv2.resize(blocks, size, interpolation=cv2.INTER_NEAREST))


def write_scan(
    folder: Path,
    annotations: Mapping[str, Any],
    *,
    on_disk: Sequence[str] | None = None,
    poses: Sequence[Mapping[str, Any]] | None = None,
    scale: float = 1000.0,
    present: str = "\n".join(INSTANCES) + "\n",
) -> Path:
    """A scan of the current release; a photograph per annotation unless told otherwise."""
    for i, image in enumerate(annotations if on_disk is None else on_disk):
        photograph(folder / "jpg_rgb" / image, seed=i)
    (folder / "annotations.json").write_text(json.dumps(annotations))
    rows = [pose(image) for image in annotations] if poses is None else poses
    savemat(folder / "image_structs.mat", {"image_structs": structs(rows), "scale": np.array([[scale]])})
    (folder / "present_instance_names.txt").write_text(present)
    return folder


def structs(rows: Sequence[Mapping[str, Any]]) -> np.ndarray[Any, Any]:
    """MATLAB's 1 x N struct."""
    array = np.empty((1, len(rows)), [(key, object) for key in pose("")])
    for i, row in enumerate(rows):
        for key, value in row.items():
            array[key][0, i] = value
    return array


def ring(
    count: int, boxes: Mapping[int, Sequence[Sequence[int]]], *, scene: str = "0001", scan: int = 1
) -> dict[str, Any]:
    """A point with `count` headings, rotations all around; boxes by index."""
    return {
        name(i, scene, scan): entry(
            boxes.get(i, ()),
            rotate_cw=name(i % count + 1, scene, scan),
            rotate_ccw=name((i - 2) % count + 1, scene, scan),
        )
        for i in range(1, count + 1)
    }


def write_homes(root: Path, homes: int = 3, headings: int = 4) -> Path:
    """Homes of one scan each, where every instance is seen from some headings, large from one of them."""
    write_map(root)
    for home in range(1, homes + 1):
        boxes: dict[int, list[tuple[int, ...]]] = {}
        for instance in range(1, len(INSTANCES) + 1):
            best = (instance + home) % headings + 1
            boxes.setdefault(best, []).append((20, 10, 100, 70, instance, 1))
            boxes.setdefault(best % headings + 1, []).append((60, 30, 90, 50, instance, 4))
        scene = f"0{home:03d}"
        write_scan(root / f"Home_{home:03d}_1", ring(headings, boxes, scene=scene))
    return root
