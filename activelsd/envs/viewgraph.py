"""Recorded views as arrays: what is seen from every place, and where every move leads.

A `ViewGraph` is how a world is trained on without its simulator: ModelNet is a ring of views per object, the
Active Vision Dataset a graph per scan, and a simulated room can be recorded into one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from activelsd.envs.actions import NAVIGATE
from activelsd.envs.episode import WHOLE_FRAME, Episode
from activelsd.errors import ConfigError, DataError, did_you_mean

SPLITS = ("train", "val", "test")
FORMAT = "activelsd.viewgraph/1"


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewGraph:
    """V views, T targets, E places to start from. See the field comments for shapes."""

    frames: NDArray[np.uint8]  # (V, S, S) gray
    moves: NDArray[np.int32]  # (V, n) view that each move leads to, -1 where it is blocked
    move_names: tuple[str, ...]  # n, unique; those of one branch stand together
    classes: tuple[str, ...]
    targets: tuple[str, ...]  # T names of the objects asked for
    labels: NDArray[np.int64]  # (T,) class of each target
    scenes: tuple[str, ...]
    scene_of: NDArray[np.int32]  # (V,) scene each view belongs to
    view_names: tuple[str, ...]  # V, unique within a scene
    start_view: NDArray[np.int32]  # (E,)
    start_target: NDArray[np.int32]  # (E,)
    start_split: NDArray[np.uint8]  # (E,) index into SPLITS
    move_branches: tuple[str, ...] | None = None  # n, branch of the action tree of each move; None: navigate
    # (V, T) row of boxes, -1 out of sight; None where the target fills every frame
    pair_of: NDArray[np.int32] | None = None
    boxes: NDArray[np.float32] | None = None  # (P, 4) cx, cy, w, h as fractions of the frame
    crops: NDArray[np.uint8] | None = None  # (P, S, S) each box cut from the full-resolution picture
    difficulty: NDArray[np.uint8] | None = None  # (P,) of boxes as annotated, 1 is easiest
    difficulty_names: tuple[str, ...] | None = None  # of 1, 2, …; None: they are called by their numbers
    pixels: NDArray[np.float32] | None = None  # (P,) of the frame, the share that shows the target itself
    # (V, 3) where the camera is and looks: metres x and z, degrees from z towards x; NaN where unknown. Of a
    # simulated room (V, 5): then metres y of the agent, and degrees that it looks down
    poses: NDArray[np.float32] | None = None
    # (E,) fewest views until one shows the target well, -1 where none can be reached
    oracle_views: NDArray[np.int32] | None = None

    @property
    def size(self) -> int:
        """Side of the frames in pixels."""
        return int(self.frames.shape[1])

    @property
    def branches(self) -> dict[str, tuple[str, ...]]:
        """The moves by their branch of the action tree, in the order of the columns of `moves`."""
        branch_of = self.move_branches or (NAVIGATE,) * len(self.move_names)
        found: dict[str, tuple[str, ...]] = {}
        for branch, name in zip(branch_of, self.move_names, strict=True):
            found[branch] = (*found.get(branch, ()), name)
        return found

    def with_moves(self, moves: Sequence[str] | Mapping[str, Sequence[str]]) -> ViewGraph:
        """The graph with these of its moves, in this order, all `navigate` or by branch.

        Raises:
            ConfigError: the graph has no move of a name, or a name is given twice.
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

    def starts(self, split: str) -> NDArray[np.int64]:
        """Rows of the places to start from in a split.

        Raises:
            DataError: the split is unknown or empty.
        """
        if split not in SPLITS:
            raise DataError(f"There is no split '{split}'; choose one of {', '.join(SPLITS)}.")
        rows = np.flatnonzero(self.start_split == SPLITS.index(split))
        if not len(rows):
            raise DataError(f"The '{split}' split has no episode to start; give the dataset more objects.")
        return rows

    def episode(self, row: int) -> Episode:
        """The episode that starts from a row of the starts."""
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
        """The row of the starts that an episode's id names.

        Raises:
            DataError: no start has that id.
        """
        if episode_id not in self._row_of:
            raise DataError(f"No episode '{episode_id}' here; ids look like '{self.episode(0).id}'.")
        return self._row_of[episode_id]

    @cached_property
    def _row_of(self) -> dict[str, int]:
        return {self.episode(row).id: row for row in range(len(self.start_view))}

    def target_box(self, view: int, target: int) -> NDArray[np.float32]:
        """(5,) box of a target in a view: cx, cy, w, h, present; zeros when it is out of sight."""
        if self.pair_of is None:
            return np.array(WHOLE_FRAME, np.float32)
        pair, box = self.pair_of[view, target], np.zeros(5, np.float32)
        if pair >= 0:
            assert self.boxes is not None
            box[:4], box[4] = self.boxes[pair], 1.0
        return box

    def crop(self, view: int, target: int) -> NDArray[np.uint8]:
        """(S, S) crop of a target in a view, zeros when it is out of sight."""
        if self.pair_of is None or self.crops is None:
            raise DataError("This recording has no crops; turn `crops` off or record it with them.")
        pair = self.pair_of[view, target]
        return self.crops[pair] if pair >= 0 else np.zeros_like(self.frames[0])


def join(graphs: Sequence[ViewGraph]) -> ViewGraph:
    """One graph of several with the same moves, classes and fields, and with targets in boxes."""
    first, targets = graphs[0], sum(len(one.targets) for one in graphs)
    renumbered = []
    view = target = pair = scene = 0
    for one in graphs:
        assert (one.move_names, one.classes) == (first.move_names, first.classes)
        assert one.pair_of is not None
        assert one.boxes is not None
        pair_of = np.full((len(one.frames), targets), -1, np.int32)
        pair_of[:, target : target + len(one.targets)] = _from(one.pair_of, pair)
        renumbered.append(
            replace(
                one,
                moves=_from(one.moves, view),
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
        field.name: _joined([getattr(one, field.name) for one in renumbered])
        for field in fields(first)
        if field.name not in shared
    }
    return ViewGraph(**joined, **{name: getattr(first, name) for name in shared})


def _from(numbers: NDArray[np.int32], first: int) -> NDArray[np.int32]:
    """Numbers that count from another first; -1, none, stays."""
    moved: NDArray[np.int32] = np.where(numbers >= 0, numbers + np.int32(first), np.int32(-1))
    return moved


def _joined(parts: Sequence[Any]) -> Any:
    """Tuples or arrays one after another; None where there is nothing."""
    if parts[0] is None:
        return None
    return tuple(chain.from_iterable(parts)) if isinstance(parts[0], tuple) else np.concatenate(parts)


def save_graph(graph: ViewGraph, path: Path, key: Mapping[str, Any]) -> None:
    """Write a graph to HDF5 under a temporary name, then rename; `key` says what it was made from."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    with h5py.File(temporary, "w") as file:
        write_graph(file, graph)
        seal(file, key)
    replace_durably(temporary, path)


def write_graph(file: h5py.File, graph: ViewGraph, *, skip: frozenset[str] = frozenset()) -> None:
    """Write a graph's fields as datasets, less those a caller fills in piece by piece."""
    for field in fields(graph):
        value = getattr(graph, field.name)
        if value is None or field.name in skip:
            continue
        if isinstance(value, tuple):
            file.create_dataset(field.name, data=np.array(value, object), dtype=h5py.string_dtype())
        else:
            file.create_dataset(field.name, data=value)


def seal(file: h5py.File, key: Mapping[str, Any]) -> None:
    """Mark a file as a whole graph made from `key`; a file without the mark is not read."""
    file.attrs["key"] = json.dumps(key, sort_keys=True)
    file.attrs["format"] = FORMAT


def replace_durably(temporary: Path, path: Path) -> None:
    """Rename a finished file into place after its bytes have reached the disk."""
    with temporary.open("rb") as file:
        os.fsync(file.fileno())
    temporary.replace(path)


def read_key(path: Path) -> dict[str, Any] | None:
    """What a cache was made from, or None where there is no cache or it is not a whole graph."""
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                return None
            key: dict[str, Any] = json.loads(file.attrs["key"])
            return key
    except OSError:
        return None


def load_graph(path: Path) -> ViewGraph:
    """Open a graph; frames and crops are memory-mapped (copy on write), the rest is read.

    Raises:
        DataError: the file is missing, truncated, or not a graph.
    """
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise DataError(f"{path} is not a whole recording of views; delete it and prepare it again.")
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
