"""Small made-up view graphs: rings around objects, and rooms with all that a recorded walk can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.cameras import Rings
from activelsd.envs.modelnet.datasets import Dataset, open_dataset
from activelsd.envs.modelnet.orbit import with_moves
from activelsd.envs.modelnet.settings import AZIMUTHS, DatasetSettings
from activelsd.envs.viewgraph import ViewGraph

MOVES = ("forward", "back", "left", "right")


def ring_graph(
    *,
    objects: int = 24,
    classes: int = 4,
    size: int = 16,
    elevations: int = 1,
    moves: Sequence[str] = ("orbit_cw", "orbit_ccw"),
    telling: Sequence[int] | None = None,
    seed: int = 0,
) -> ViewGraph:
    """Rings of 12 views per elevation; the target fills the frame, every class is in every split.

    A frame's upper half is a pattern of the azimuth, and its lower half one of the class.

    Args:
        objects: how many; a third of them train, a third val, a third test.
        classes: how many.
        size: of the frames, in pixels.
        elevations: rings per object; episodes start on the first.
        moves: names of orbit moves.
        telling: azimuths (0 to 11) whose views show the class; the others are the same for all objects. None:
            all views show it, and no two views are the same.
        seed: draws the patterns.
    """
    rng = np.random.default_rng(seed)
    half, views = size // 2, AZIMUTHS * elevations
    places = rng.integers(0, 256, (views, half, size))
    kinds = rng.integers(0, 256, (classes, half, size))
    labels = np.arange(objects) % classes
    frames = np.full((objects, views, size, size), 128)
    frames[:, :, :half] = places
    shows = np.isin(np.arange(views) % AZIMUTHS, range(AZIMUTHS) if telling is None else telling)
    frames[:, shows, half:] = kinds[labels][:, None]
    if telling is None:
        frames += rng.integers(-20, 21, frames.shape)
    starts = np.arange(objects)[:, None] * views + np.arange(AZIMUTHS)
    names = tuple(f"object_{i}" for i in range(objects))
    graph = ViewGraph(
        frames=frames.clip(0, 255).astype(np.uint8).reshape(-1, size, size),
        moves=np.zeros((objects * views, 0), np.int32),
        move_names=(),
        classes=tuple(f"class_{i}" for i in range(classes)),
        targets=names,
        labels=labels,
        scenes=names,
        scene_of=np.repeat(np.arange(objects), views).astype(np.int32),
        view_names=tuple(f"{i // AZIMUTHS}_{i % AZIMUTHS * 30:03}" for i in range(views)) * objects,
        start_view=starts.ravel().astype(np.int32),
        start_target=np.repeat(np.arange(objects), AZIMUTHS).astype(np.int32),
        start_split=np.repeat(np.arange(objects) // classes % 3, AZIMUTHS).astype(np.uint8),
    )
    return with_moves(graph, moves, [Rings.even(AZIMUTHS, range(elevations))] * objects)


def room_graph(*, crops: bool = True, size: int = 12, rooms: int = 3, seed: int = 0) -> ViewGraph:
    """Rooms of 9 views joined at random: blocked moves, one-way edges, moves that stay where they are.

    Each room holds four targets, seen in boxes from some of its views only; an episode may start where its
    target is out of sight. Room 0 trains, room 1 is val, room 2 test, and so on around.

    Args:
        crops: whether crops of the boxes are recorded.
        size: of the frames, in pixels.
        rooms: how many.
        seed: draws everything.
    """
    rng = np.random.default_rng(seed)
    here, things = 9, 4
    views, targets = rooms * here, rooms * things
    room_of, room_of_target = np.repeat(np.arange(rooms), here), np.repeat(np.arange(rooms), things)
    moves = rng.integers(0, here, (views, len(MOVES))) + room_of[:, None] * here
    moves[rng.random(moves.shape) < 0.3] = -1

    # Rows of boxes are shuffled, so that none is by chance the number of its view or target.
    seen = (room_of[:, None] == room_of_target) & (rng.random((views, targets)) < 0.6)
    pair_of = np.full((views, targets), -1, np.int32)
    pair_of[seen] = rng.permutation(int(seen.sum()))
    extent = rng.uniform(0.1, 0.5, (seen.sum(), 2))
    centre = rng.uniform(0.25, 0.75, extent.shape)
    pictures = rng.integers(1, 256, (seen.sum(), size, size), dtype=np.uint8)
    asked = room_of[:, None] == room_of_target
    start_view, start_target = np.nonzero(asked)
    return ViewGraph(
        frames=rng.integers(0, 256, (views, size, size), dtype=np.uint8),
        moves=moves.astype(np.int32),
        move_names=MOVES,
        classes=("cup", "lamp", "book"),
        targets=tuple(f"thing_{i}" for i in range(targets)),
        labels=rng.integers(0, 3, targets),
        scenes=tuple(f"room_{i}" for i in range(rooms)),
        scene_of=room_of.astype(np.int32),
        view_names=tuple(f"view_{i % here}" for i in range(views)),
        start_view=start_view.astype(np.int32),
        start_target=start_target.astype(np.int32),
        start_split=(room_of[start_view] % 3).astype(np.uint8),
        pair_of=pair_of,
        boxes=np.concatenate([centre, extent], 1).astype(np.float32),
        crops=pictures if crops else None,
    )


def coloured(graph: ViewGraph, seed: int = 0) -> ViewGraph:
    """The graph with pictures of random hues, in which every channel counts."""
    rng = np.random.default_rng(seed)

    def tinted(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
        hue = rng.uniform(0.3, 1.0, (len(gray), 3, 1, 1))
        return np.asarray(np.rint(gray[:, None] * hue), np.uint8)

    crops = None if graph.crops is None else tinted(graph.crops)
    return replace(graph, frames=tinted(graph.frames), crops=crops)


def opened(path: Path | None, **options: object) -> Dataset:
    """A dataset with these settings, whatever the schema would say of them."""
    return open_dataset(DatasetSettings.model_construct(path=path, **options))
