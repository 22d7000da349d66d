"""Images per second that one core renders of a furnished room, with and without shadows.

    python benchmarks/rooms.py --size 84 --triangles 100000

The embedded furniture's triangles are subdivided until there are enough of them. The time is the process's
CPU time, so that other load on the machine has little effect.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from trimesh.remesh import subdivide

from activelsd.scenery.meshes import Mesh
from activelsd.scenery.rooms.floor_grid import draw_floor_grid
from activelsd.scenery.rooms.layout import Placed, Room, furnish, set_out
from activelsd.scenery.rooms.library import Embedded
from activelsd.scenery.rooms.models import Model
from activelsd.scenery.rooms.room_renderer import Camera, RoomRenderer
from activelsd.scenery.rooms.smallthings import KINDS, small_thing


def finer(placed: Placed) -> Placed:
    """The object with every triangle divided into four."""
    model = placed.model
    cut = subdivide(model.mesh.vertices, model.mesh.faces, return_index=True)  # type: ignore[no-untyped-call]
    vertices, faces, index = cut
    origin = np.empty(len(faces), np.int64)
    for old, new in index.items():
        origin[new] = old
    mesh = Mesh(vertices.astype(np.float32), faces.astype(np.int32))
    return placed._replace(model=Model(model.kind, model.number, mesh, model.paint[origin], model.materials))


def detailed(room: Room, triangles: int) -> Room:
    """The room with its objects subdivided one after another until there are enough triangles."""
    things = list(room.things)
    count = sum(len(thing.model.mesh.faces) for thing in things)
    turn = 0
    while count < triangles:
        old = things[turn % len(things)]
        things[turn % len(things)] = finer(old)
        count += 3 * len(old.model.mesh.faces)
        turn += 1
    return replace(room, things=tuple(things))


def main() -> None:
    """Furnishes a room, renders images of it, and prints the rates."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--size", type=int, default=84, help="side of the pictures in pixels")
    parser.add_argument("--triangles", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    small = [small_thing(KINDS[i % len(KINDS)], i) for i in range(20)]
    room = detailed(set_out(furnish(Embedded(), args.seed), small, args.seed), args.triangles)
    points = draw_floor_grid(room, step=0.3, radius=0.2).points
    rng = np.random.default_rng(args.seed)
    for shadows in (True, False):
        renderer = RoomRenderer(room, shadows=shadows)
        began = time.process_time()
        for _ in range(args.frames):
            x, y = points[rng.integers(len(points))].tolist()
            yaw = float(rng.uniform(0, 360))
            renderer.look(Camera(x, y, 1.3, yaw, -12.0, 60.0, args.size, args.size))
        rate = args.frames / (time.process_time() - began)
        print(
            f"{'with' if shadows else 'without'} shadows: {rate:.0f} frames/s per core at"
            f" {args.size}x{args.size}, {len(room.things)} things, {renderer.triangles} triangles"
        )


if __name__ == "__main__":
    main()
