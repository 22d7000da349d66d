"""Recorded views as arrays: the image at every viewpoint, and the view that every move leads to.

With a `ViewGraph` an agent trains without a simulator: ModelNet is a ring of views per object, the Active
Vision Dataset a graph per scan, and a simulated room can be recorded into one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.actions import NAVIGATE
from activelsd.envs.episode import WHOLE_FRAME, Episode
from activelsd.errors import ConfigError, DataError, did_you_mean

if TYPE_CHECKING:
    from activelsd.sections import Colour

SPLITS = ("train", "val", "test")
FORMAT = "activelsd.viewgraph/1"


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewGraph:
    """V views, T targets, E episode starts. See the field comments for shapes."""

    frames: NDArray[np.uint8]  # (V, S, S) gray, or (V, 3, S, S) red, green and blue; crops likewise
    moves: NDArray[np.int32]  # (V, n) view that each move leads to, -1 if it is blocked
    move_names: tuple[str, ...]  # n, unique; the moves of one branch are adjacent
    classes: tuple[str, ...]
    targets: tuple[str, ...]  # T names of the objects to recognise
    labels: NDArray[np.int64]  # (T,) class of each target
    scenes: tuple[str, ...]
    scene_of: NDArray[np.int32]  # (V,) scene each view belongs to
    view_names: tuple[str, ...]  # V, unique within a scene
    start_view: NDArray[np.int32]  # (E,)
    start_target: NDArray[np.int32]  # (E,)
    start_split: NDArray[np.uint8]  # (E,) index into SPLITS
    move_branches: tuple[str, ...] | None = None  # n, branch of the action tree of each move; None: navigate
    left_out: tuple[str, ...] | None = None  # objects of the data set that are broken; not kept in files
    # (V, T) row of `boxes`, -1 if the target is out of sight; None if the target fills every frame
    pair_of: NDArray[np.int32] | None = None
    boxes: NDArray[np.float32] | None = None  # (P, 4) cx, cy, w, h as fractions of the frame
    crops: NDArray[np.uint8] | None = None  # (P, [3,] S, S) each box cropped from the full-resolution image
    # each (N + 1, F): what a frozen trunk finds in the N pictures it is shown, crops if there are any, else
    # frames, and in a black one; then in their variants, see `activelsd.features`. Not part of recordings
    features: tuple[NDArray[np.float16], ...] | None = None
    difficulty: NDArray[np.uint8] | None = None  # (P,) annotated difficulty of each box, 1 is easiest
    difficulty_names: tuple[str, ...] | None = None  # names of grades 1, 2, …; None: numbers
    pixels: NDArray[np.float32] | None = None  # (P,) fraction of the frame's pixels that show the target
    # (V, 3) camera pose: x and z in metres, heading in degrees from z towards x; NaN if unknown. A simulated
    # room has (V, 5): also the agent's y in metres and the camera's downward tilt in degrees
    poses: NDArray[np.float32] | None = None
    # (V, 2) azimuth and elevation in degrees of a camera that looks at an object from outside
    directions: NDArray[np.float32] | None = None
    # (E,) fewest views until one shows the target well, -1 if no such view can be reached
    oracle_views: NDArray[np.int32] | None = None

    @property
    def size(self) -> int:
        """Side of the frames in pixels."""
        return int(self.frames.shape[-1])

    @property
    def channels(self) -> int:
        """C, the channels of a picture: 1 in gray, 3 in colour."""
        return 1 if self.frames.ndim == 3 else int(self.frames.shape[1])

    def in_colour(self, colour: Colour) -> ViewGraph:
        """The graph with pictures in `gray` or `rgb`.

        Gray pictures in `rgb` have three equal channels, which take no memory; colour pictures in `gray` are
        computed now.
        """
        if self.channels == (3 if colour == "rgb" else 1):
            return self
        change = _repeated if colour == "rgb" else _gray
        crops = None if self.crops is None else change(self.crops)
        return replace(self, frames=change(self.frames), crops=crops)

    @property
    def branches(self) -> dict[str, tuple[str, ...]]:
        """Move names by branch of the action tree, in the order of the columns of `moves`."""
        branch_of = self.move_branches or (NAVIGATE,) * len(self.move_names)
        branches: dict[str, tuple[str, ...]] = {}
        for branch, name in zip(branch_of, self.move_names, strict=True):
            branches[branch] = (*branches.get(branch, ()), name)
        return branches

    def with_moves(self, moves: Sequence[str] | Mapping[str, Sequence[str]]) -> ViewGraph:
        """The graph with only these moves, in this order: a list for `navigate`, or lists by branch.

        Raises:
            ConfigError: the graph has no move of that name, or a name is given twice.
        """
        branches = moves if isinstance(moves, Mapping) else {NAVIGATE: moves}
        pairs = [(branch, name) for branch, names in branches.items() for name in names]
        names = tuple(name for _, name in pairs)
        for name in names:
            if name not in self.move_names:
                raise ConfigError(f"There is no move '{name}' here; {did_you_mean(name, self.move_names)}")
            if names.count(name) > 1:
                raise ConfigError(f"The move '{name}' is named twice; name it once, in one branch.")
        columns = [self.move_names.index(name) for name in names]
        return replace(
            self,
            moves=np.ascontiguousarray(self.moves[:, columns]),
            move_names=names,
            move_branches=tuple(branch for branch, _ in pairs) if branches.keys() != {NAVIGATE} else None,
        )

    def with_classes(self, classes: Sequence[str]) -> ViewGraph:
        """The graph with other classes, in this order, which contain its own."""
        order = np.array([classes.index(name) for name in self.classes], self.labels.dtype)
        return replace(self, classes=tuple(classes), labels=order[self.labels])

    def starts(self, split: str) -> NDArray[np.int64]:
        """Indices of a split's episode starts.

        Raises:
            DataError: the split is unknown or empty.
        """
        if split not in SPLITS:
            raise DataError(f"There is no split '{split}'; choose one of {', '.join(SPLITS)}.")
        rows = np.flatnonzero(self.start_split == SPLITS.index(split))
        if not len(rows):
            raise DataError(f"The '{split}' split has no episode; give the dataset more objects.")
        return rows

    def episode(self, row: int) -> Episode:
        """The episode of a start, given by its row."""
        view, target = int(self.start_view[row]), int(self.start_target[row])
        scene, name = self.scenes[self.scene_of[view]], self.targets[target]
        split, start = SPLITS[self.start_split[row]], self.view_names[view]
        return Episode(
            id=f"{split}:{scene}:{name}:{start}",
            scene=scene,
            target=name,
            label=int(self.labels[target]),
            start=start,
            split=split,
            oracle_views=None if self.oracle_views is None else int(self.oracle_views[row]),
            difficulty=self._difficulty(view, target),
        )

    def _difficulty(self, view: int, target: int) -> str | None:
        pair = -1 if self.pair_of is None else int(self.pair_of[view, target])
        if self.difficulty is None or pair < 0:
            return None
        number = int(self.difficulty[pair])
        return str(number) if self.difficulty_names is None else self.difficulty_names[number - 1]

    def find(self, episode_id: str) -> int:
        """The start row of the episode with this id.

        Raises:
            DataError: no episode has that id.
        """
        if episode_id not in self._row_of:
            raise DataError(f"There is no episode '{episode_id}'; ids look like '{self.episode(0).id}'.")
        return self._row_of[episode_id]

    @cached_property
    def _row_of(self) -> dict[str, int]:
        return {self.episode(row).id: row for row in range(len(self.start_view))}

    def target_box(self, view: int, target: int) -> NDArray[np.float32]:
        """(5,) box of a target in a view: cx, cy, w, h, present; zeros if it is out of sight."""
        if self.pair_of is None:
            return np.array(WHOLE_FRAME, np.float32)
        pair, box = self.pair_of[view, target], np.zeros(5, np.float32)
        if pair >= 0:
            assert self.boxes is not None
            box[:4], box[4] = self.boxes[pair], 1.0
        return box

    def crop(self, view: int, target: int) -> NDArray[np.uint8]:
        """([3,] S, S) crop of a target in a view; zeros if it is out of sight."""
        if self.pair_of is None or self.crops is None:
            raise DataError("This recording has no crops; turn `crops` off or record again with crops.")
        pair = self.pair_of[view, target]
        return self.crops[pair] if pair >= 0 else np.zeros_like(self.frames[0])

    @property
    def features_shape(self) -> tuple[int, int] | None:
        """(W, F) of the features: how many variants there are, and how wide they are; None without any."""
        return None if self.features is None else (len(self.features), int(self.features[0].shape[1]))

    def features_of(self, view: int, target: int) -> NDArray[np.float16]:
        """(W, F) features of the picture that a trunk is shown of a target in a view."""
        assert self.features is not None
        row = view if self.crops is None or self.pair_of is None else int(self.pair_of[view, target])
        return np.stack(
            [one[row] for one in self.features]
        )  # -1, out of sight, is the last row, the black one


def _repeated(pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(N, S, S) as (N, 3, S, S) whose channels share their memory."""
    (n, height, width), (row, line, pixel) = pictures.shape, pictures.strides
    # Not `broadcast_to`: PyTorch warns of arrays that cannot be written to.
    return np.lib.stride_tricks.as_strided(pictures, (n, 3, height, width), (row, 0, line, pixel))


def _gray(pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(N, 3, S, S) as (N, S, S)."""
    from activelsd.envs.colour import in_colour

    gray = np.empty((len(pictures), *pictures.shape[2:]), np.uint8)
    for i, picture in enumerate(pictures):
        gray[i] = in_colour(picture.transpose(1, 2, 0), "gray")
    return gray


def join(graphs: Sequence[ViewGraph]) -> ViewGraph:
    """Joins graphs that have the same moves, classes and fields, and whose targets have boxes."""
    first, targets = graphs[0], sum(len(one.targets) for one in graphs)
    shifted = []
    view = target = pair = scene = 0
    for one in graphs:
        assert (one.move_names, one.classes) == (first.move_names, first.classes)
        assert one.pair_of is not None
        assert one.boxes is not None
        pair_of = np.full((len(one.frames), targets), -1, np.int32)
        pair_of[:, target : target + len(one.targets)] = _add_offset(one.pair_of, pair)
        shifted.append(
            replace(
                one,
                moves=_add_offset(one.moves, view),
                pair_of=pair_of,
                scene_of=one.scene_of + np.int32(scene),
                start_view=one.start_view + np.int32(view),
                start_target=one.start_target + np.int32(target),
            )
        )
        view, target = view + len(one.frames), target + len(one.targets)
        pair, scene = pair + len(one.boxes), scene + len(one.scenes)
    shared = ("move_names", "move_branches", "classes", "difficulty_names")
    joined = {
        field.name: _concatenate([getattr(one, field.name) for one in shifted])
        for field in fields(first)
        if field.name not in shared
    }
    return replace(first, **joined)


def _add_offset(indices: NDArray[np.int32], offset: int) -> NDArray[np.int32]:
    """Adds an offset to indices; -1 (none) is kept."""
    return np.asarray(np.where(indices >= 0, indices + np.int32(offset), np.int32(-1)))


def _concatenate(parts: Sequence[Any]) -> Any:
    """Concatenates tuples or arrays; None if the parts are None."""
    if parts[0] is None:
        return None
    return tuple(chain.from_iterable(parts)) if isinstance(parts[0], tuple) else np.concatenate(parts)


def save_graph(graph: ViewGraph, path: Path, key: Mapping[str, Any]) -> None:
    """Writes a graph to a temporary HDF5 file, then renames it; `key` describes what it was made from."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    with open_hdf5(temporary, "w") as file:
        write_graph(file, graph)
        seal(file, key)
    replace_durably(temporary, path)


def open_hdf5(path: Path, mode: str = "r") -> h5py.File:
    """Opens an HDF5 file without HDF5's own lock, which fails on disks that have none."""
    return h5py.File(path, mode, locking=False)


def write_graph(file: h5py.File, graph: ViewGraph, *, skip: frozenset[str] = frozenset()) -> None:
    """Writes a graph's fields as datasets, except `skip`, which the caller writes in parts."""
    for field in fields(graph):
        value = getattr(graph, field.name)
        if value is None or field.name in skip:
            continue
        if isinstance(value, tuple):
            file.create_dataset(field.name, data=np.array(value, object), dtype=h5py.string_dtype())
        else:
            file.create_dataset(field.name, data=value)


def seal(file: h5py.File, key: Mapping[str, Any]) -> None:
    """Marks a file as a complete graph made from `key`; a file without this mark is not read."""
    file.attrs["key"] = json.dumps(key, sort_keys=True)
    file.attrs["format"] = FORMAT


def replace_durably(temporary: Path, path: Path) -> None:
    """Renames a finished file to its final name after its bytes have reached the disk."""
    with temporary.open("r+b") as file:  # Windows flushes only what may be written
        os.fsync(file.fileno())
    temporary.replace(path)


def read_key(path: Path) -> dict[str, Any] | None:
    """The key of a cached graph; None if the file is missing or is not a complete graph."""
    try:
        with open_hdf5(path) as file:
            if file.attrs.get("format") != FORMAT:
                return None
            key: dict[str, Any] = json.loads(file.attrs["key"])
            return key
    except OSError:
        return None


def load_graph(path: Path) -> ViewGraph:
    """Opens a graph; frames and crops are memory-mapped (copy on write), the rest is read.

    Raises:
        DataError: the file is missing, truncated, or not a graph.
    """
    try:
        with open_hdf5(path) as file:
            if file.attrs.get("format") != FORMAT:
                raise DataError(f"{path} is not a complete recording; delete it and prepare it again.")
            present = [field.name for field in fields(ViewGraph) if field.name in file]
            return ViewGraph(**{name: _read(file, name, path) for name in present})
    except OSError as error:
        raise DataError(f"{path} cannot be read as HDF5 ({error}); delete it and prepare it again.") from None


def _read(file: h5py.File, name: str, path: Path) -> Any:
    dataset = file[name]
    if h5py.check_string_dtype(dataset.dtype):
        return tuple(dataset.asstr()[:])
    offset = dataset.id.get_offset()
    if name in {"frames", "crops"} and offset is not None:
        return np.memmap(path, dataset.dtype, "c", offset, dataset.shape)
    return dataset[:]
