"""Recorded rooms as one graph of views, with the episodes that begin in them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from activelsd.envs.settings import Progress
from activelsd.envs.start_filters import episodes
from activelsd.envs.thor.recordings import recordings
from activelsd.envs.thor.scenes import scenes
from activelsd.envs.thor.settings import THORSettings
from activelsd.envs.thor.starts import starts
from activelsd.envs.viewgraph import SPLITS, ViewGraph, join, load_graph
from activelsd.errors import DataError, some

_LOG = logging.getLogger("activelsd")


def recorded_rooms(
    world: THORSettings, progress: Progress | None = None, *, pictures: bool = True
) -> ViewGraph:
    """The views of a world's rooms, recorded now if they are not in the cache.

    Args:
        world: its settings.
        progress: called with the scenes that are recorded and all.
        pictures: False for a table of what is seen where, its frames and crops zeros that take no room.

    Raises:
        DataError: a scene cannot be recorded, or no start is left.
        UserError: AI2-THOR is not there, or cannot be started here.
    """
    split_of = {
        name: split
        for split in SPLITS
        for room in world.scenes.rooms
        for name in scenes((room,), split)[: getattr(world.scenes, split)]
    }
    recorded = [load_graph(file) for file in recordings(world, list(split_of), progress)]
    parts = [one for one in recorded if one.targets]
    _report_empty([one.scenes[0] for one in recorded if not one.targets], world.classes, parts)
    graph = starts(join(parts) if pictures else _table(parts), split_of, world.starts)
    return episodes(graph, world.starts.per_target, world.move_branches)


def _report_empty(scenes: Sequence[str], classes: Sequence[str], others: Sequence[ViewGraph]) -> None:
    """Log which scenes have nothing to ask for; raise DataError if there are no others."""
    if not others:
        raise DataError(
            f"No scene has any of {', '.join(classes)}; name other types of objects as env.classes."
        )
    if scenes:
        left_out = some(scenes, 3)
        _LOG.warning("Scenes without any of the objects that are asked for are left out: %s.", left_out)


def _table(parts: Sequence[ViewGraph]) -> ViewGraph:
    """Recordings joined without reading their pictures."""
    picture = parts[0].frames.shape[1:]
    graph = join([replace(one, frames=one.frames[..., :0, :0], crops=None) for one in parts])
    assert graph.boxes is not None
    frames, crops = (
        np.broadcast_to(np.uint8(0), (rows, *picture)) for rows in (len(graph.moves), len(graph.boxes))
    )
    return replace(graph, frames=frames, crops=crops)
