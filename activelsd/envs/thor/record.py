"""Records a scene as a view graph: every view of its lattice once, with boxes and crops of its targets.

A scene is a file of its own in the cache, so that it is kept if a later one fails, and is shared by all
settings that need it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.crops import cut_out, squashed
from activelsd.envs.episode import View
from activelsd.envs.thor.lattice import HEADINGS, Lattice
from activelsd.envs.thor.room import Event, Scene, Sight, WalkableRoom, photograph, sight, unhindered
from activelsd.envs.thor.settings import MOVES
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import DataError
from activelsd.sections import Colour

EASY, MODERATE, HARD = 1, 2, 3
DIFFICULTIES = ("easy", "moderate", "hard")
"""Difficulties of a view of a target, and their names."""

CHECKED = 0.01
"""Share of a recording's views that are taken a second time."""

TOLERANCE = 2.0
"""Mean difference of two pictures of one view, in gray levels, that a simulator is allowed."""

_EASY, _MODERATE = 0.25, 0.05
"""Least shares of the most pixels that a target has anywhere."""

_HIDDEN = 0.25
"""Share of a target's extent in the picture; if fewer pixels show it, it is hard."""


class ViewMaker:
    """Makes the views of an agent from a simulator's answers."""

    def __init__(self, size: int, field_of_view: float, colour: Colour = "gray") -> None:
        """Make frames and crops of `size` pixels; the camera sees so many degrees from top to bottom."""
        self.size, self.field_of_view, self.colour = size, field_of_view, colour

    def photograph(self, event: Event) -> NDArray[np.uint8]:
        """What an event shows, uint8 (H, W) in gray or (H, W, 3) RGB."""
        return photograph(event, self.colour)

    def view(self, event: Event, name: str) -> View:
        """What is seen of one object, by the simulator's name of it."""
        picture, seen = self.photograph(event), sight(event, name)
        frame = squashed(picture, self.size)
        if seen is None:
            return View(frame, np.zeros(5, np.float32), np.zeros_like(frame))
        target = np.append(fractions([seen], picture.shape)[0], np.float32(1))
        return View(frame, target, self.crop(picture, seen))

    def crop(self, picture: NDArray[np.uint8], seen: Sight) -> NDArray[np.uint8]:
        """uint8 ([3,] S, S) around an object, cut from a picture (H, W) or (H, W, 3)."""
        return cut_out(picture, np.array(seen.box, np.int32), self.size)


def fractions(sights: Sequence[Sight], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(P, 4) cx, cy, w, h of boxes as fractions of a picture of shape (H, W) or (H, W, 3)."""
    boxes = np.array([one.box for one in sights], np.float64).reshape(-1, 4)
    whole = np.array([shape[1], shape[0]])
    low, high = boxes[:, :2] / whole, boxes[:, 2:] / whole
    return np.concatenate([(low + high) / 2, high - low], 1).astype(np.float32)


def record(
    room: WalkableRoom,
    name: str,
    *,
    camera: ViewMaker,
    classes: Sequence[str],
    progress: Callable[[int, int], None] | None = None,
    seed: int = 0,
) -> ViewGraph:
    """Walk all of a scene's lattice once.

    A cell in which the agent does not land where it was sent is left out with all its views. Afterwards some
    views are taken once more, and must look as they did.

    Args:
        room: the simulator.
        name: of the scene.
        camera: makes pictures of what the simulator answers.
        classes: types of objects, in the order of their numbers.
        progress: called with the number of views taken and of all.
        seed: of the views that are taken twice.

    Returns:
        A graph of one scene whose targets are named `SCENE/OBJECT`; its starts are all views that show a
        target, in no split but the first.

    Raises:
        DataError: the scene has nothing to ask for or to stand on, or looks different the second time.
    """
    scene = room.enter(name)
    if not scene.targets:
        raise DataError(f"{name} has none of the objects that are asked for; leave that scene out.")
    taken = _Taken(camera, scene)
    kept = [taken.cell(room, cell, progress) for cell in range(len(scene.lattice.cells))]
    lattice = scene.lattice.only(np.array(kept))
    if not len(lattice.cells):
        raise DataError(f"The agent lands nowhere in {name} where it is sent; leave that scene out.")
    graph = taken.graph(lattice, classes)
    _check(room, scene._replace(lattice=lattice), graph, camera, seed)
    return graph


class _Taken:
    """The views of a scene that were taken so far."""

    def __init__(self, camera: ViewMaker, scene: Scene) -> None:
        self._camera, self._scene = camera, scene
        self._frames: list[NDArray[np.uint8]] = []
        self._crops: list[NDArray[np.uint8]] = []
        self._pairs: list[tuple[int, int]] = []  # view, target
        self._sights: list[Sight] = []
        self._shown: list[float] = []
        self._shape: tuple[int, ...] = ()

    def cell(self, room: WalkableRoom, cell: int, progress: Callable[[int, int], None] | None) -> bool:
        """Look from a cell in all directions; False, and nothing is kept, if the agent lands elsewhere."""
        lattice, camera = self._scene.lattice, self._camera
        per_cell = HEADINGS * len(lattice.horizons)
        marks = len(self._frames), len(self._pairs)
        for view in range(cell * per_cell, (cell + 1) * per_cell):
            pose = lattice.pose(view)
            event = room.stand(pose)
            if event is None:
                del self._frames[marks[0] :], self._pairs[marks[1] :]
                del self._crops[marks[1] :], self._sights[marks[1] :], self._shown[marks[1] :]
                return False
            picture = camera.photograph(event)
            self._shape = picture.shape[:2]
            for number, target in enumerate(self._scene.targets):
                seen = sight(event, target.id)
                if seen is not None:
                    self._pairs.append((len(self._frames), number))
                    self._sights.append(seen)
                    self._crops.append(camera.crop(picture, seen))
                    extent = unhindered(event, target, pose, camera.field_of_view)
                    self._shown.append(seen.pixels / max(extent, 1.0))
            self._frames.append(squashed(picture, camera.size))
            if progress is not None:
                progress(view + 1, lattice.views)
        return True

    def graph(self, lattice: Lattice, classes: Sequence[str]) -> ViewGraph:
        """The graph of all views, on the lattice of the cells that were kept."""
        scene = self._scene
        pairs = np.array(self._pairs, np.int32).reshape(-1, 2)
        if not len(pairs):
            raise DataError(f"No view of {scene.name} shows an object that is asked for; leave it out.")
        pair_of = np.full((lattice.views, len(scene.targets)), -1, np.int32)
        pair_of[tuple(pairs.T)] = np.arange(len(pairs))
        pixels = np.array([one.pixels for one in self._sights]) / np.prod(self._shape)
        return ViewGraph(
            frames=np.stack(self._frames),
            moves=lattice.moves(),
            move_names=MOVES,
            classes=tuple(classes),
            targets=tuple(f"{scene.name}/{target.id}" for target in scene.targets),
            labels=np.array([classes.index(target.kind) for target in scene.targets]),
            scenes=(scene.name,),
            scene_of=np.zeros(lattice.views, np.int32),
            view_names=view_names(lattice),
            start_view=pairs[:, 0],
            start_target=pairs[:, 1],
            start_split=np.zeros(len(pairs), np.uint8),
            pair_of=pair_of,
            boxes=fractions(self._sights, self._shape),
            crops=np.stack(self._crops),
            difficulty_names=DIFFICULTIES,
            difficulty=difficulties(pixels, np.array(self._shown), pairs[:, 1]),
            pixels=pixels.astype(np.float32),
            poses=lattice.poses(),
        )


def view_names(lattice: Lattice) -> tuple[str, ...]:
    """`x_z_rotation_horizon` of every view, in cells and degrees."""
    names = []
    for view in range(lattice.views):
        pose = lattice.pose(view)
        column, row = lattice.cells[view // (HEADINGS * len(lattice.horizons))]
        names.append(f"{column}_{row}_{pose.rotation:.0f}_{pose.horizon:.0f}")
    return tuple(names)


def difficulties(
    pixels: NDArray[np.float64], shown: NDArray[np.float64], targets: NDArray[np.int32]
) -> NDArray[np.uint8]:
    """(P,) easy, moderate or hard.

    Args:
        pixels: (P,) that show the target.
        shown: (P,) the same as a share of `room.unhindered`.
        targets: (P,) number of each pair's target.
    """
    best = np.zeros(targets.max() + 1)
    np.maximum.at(best, targets, pixels)
    share = pixels / best[targets]
    found = np.where(share >= _EASY, EASY, MODERATE)
    found[(share < _MODERATE) | (shown < _HIDDEN)] = HARD
    return found.astype(np.uint8)


def _check(room: WalkableRoom, scene: Scene, graph: ViewGraph, camera: ViewMaker, seed: int) -> None:
    """Raise DataError if views that are taken again differ from the recorded ones."""
    count = max(1, round(CHECKED * scene.lattice.views))
    for view in np.random.default_rng(seed).choice(scene.lattice.views, count, replace=False).tolist():
        event = room.stand(scene.lattice.pose(view))
        if event is not None:
            again = squashed(camera.photograph(event), camera.size).astype(np.int16)
            if np.abs(again - graph.frames[view]).mean() <= TOLERANCE:
                continue
        raise DataError(
            f"View {graph.view_names[view]} of {scene.name} is not what it was when it was recorded: the"
            " simulator's scene changes by itself; leave that scene out."
        )
