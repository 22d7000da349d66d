"""What can be known of drawn objects beside their pictures: depths from cameras, and distance panoramas."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from activelsd.envs.modelnet.cameras import Camera
from activelsd.envs.modelnet.sources import Drawn, Item, checker, naming, source_from, work_on
from activelsd.envs.workers import Work
from activelsd.scenery.meshes import Mesh

__all__ = ["DRAWINGS", "checker", "renderer"]


def _depths(mesh: Mesh, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
    from activelsd.scenery.depths import as_levels
    from activelsd.scenery.orbit_renderer import render_depths

    return as_levels(render_depths(mesh, size=size, cameras=cameras))


def _panorama(mesh: Mesh, size: int, cameras: Sequence[Camera]) -> NDArray[np.uint8]:
    from activelsd.scenery.panorama import render_panorama

    return render_panorama(mesh)[None]


DRAWINGS: Mapping[str, Callable[[Mesh, int, Sequence[Camera]], NDArray[np.uint8]]] = {
    "depth": _depths,
    "panorama": _panorama,
}
"""By kind, what is drawn of a mesh, uint8 (V, H, W); a panorama is one view, whatever the cameras."""


@contextmanager
def renderer(job: Mapping[str, Any]) -> Iterator[Work]:
    """Draws items from the source of a job, see `sources.renderer`."""
    source, draw = source_from(job["source"]), DRAWINGS[job["kind"]]
    assert isinstance(source, Drawn)
    cameras = [Camera(*camera) for camera in job["cameras"]]

    def draw_item(item: Item) -> bytes:
        mesh = source.mesh(item)
        with naming(item.name):
            return draw(mesh, job["size"], cameras).tobytes()

    yield work_on(draw_item)
