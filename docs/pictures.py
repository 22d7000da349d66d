"""Draws pictures of these pages.

python docs/pictures.py shapes                    the embedded shapes, six views each
python docs/pictures.py points                    embedded shapes as meshes, and as points drawn as discs
python docs/pictures.py export                    what `activelsd export` writes
python docs/pictures.py axes                      which axis of a file points where
python docs/pictures.py curves RUN [RUN ...]      metrics of runs during training
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from activelsd.envs.modelnet.cameras import Dodecahedron, Rings
from activelsd.envs.world import world_settings
from activelsd.scenery.discs import disc_mesh
from activelsd.scenery.meshes import upright
from activelsd.scenery.orbit_renderer import DISTANCE, FRAME_RADIUS, render_depths, render_views
from activelsd.scenery.shapes import make_shape

HERE = Path(__file__).parent / "pictures"
CURVES = {
    "accuracy": "accuracy of answers given",
    "accuracy_at_first_view": "accuracy at the first view",
    "views": "views seen when answering",
    "navigate": "probability of navigating",
    "policy_entropy_loss": "-log max π (the paper's Figure 3)",
    "val/accuracy": "accuracy on validation objects",
}


def shapes() -> Figure:
    """Two training objects of each class, each from three sides."""
    graph = world_settings("modelnet", {}).open()
    figure = Figure(figsize=(11, 8.4), dpi=90)
    grid = figure.subplots(8, 2, gridspec_kw={"wspace": 0.02, "hspace": 0.28})
    for axes, category in zip(grid.T.flat, graph.classes, strict=True):
        scenes = [i for i, name in enumerate(graph.scenes) if name.startswith(f"{category}/train")][:2]
        views = [graph.frames[12 * scene + azimuth] for scene in scenes for azimuth in (1, 5, 9)]
        axes.imshow(np.concatenate(views, 1), cmap="gray", vmin=0, vmax=255)
        axes.set_title(category, fontsize=11, loc="left", pad=2)
        axes.set_axis_off()
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.96)
    return figure


def points() -> Figure:
    """An object of eight embedded classes in a column each: its mesh, and ever fewer points on it."""
    categories = ("bench", "cup", "desk", "laptop", "piano", "sofa", "table", "vase")
    rng = np.random.default_rng(0)
    figure = Figure(figsize=(11, 6.1), dpi=90)
    grid = figure.subplots(4, len(categories), gridspec_kw={"wspace": 0.02, "hspace": 0.02})
    for column, category in zip(grid.T, categories, strict=True):
        mesh = make_shape(category, np.random.default_rng(7))
        a, b, c = mesh.vertices.astype(np.float64)[mesh.faces].transpose(1, 0, 2)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        for axes, count in zip(column, (None, 2048, 1024, 512), strict=True):
            drawn = mesh
            if count is not None:
                faces = rng.choice(len(areas), count, p=areas / areas.sum())
                across, along = np.sort(rng.random((2, count, 1)), axis=0)
                drawn = disc_mesh(across * a[faces] + (along - across) * b[faces] + (1 - along) * c[faces])
            view = render_views(drawn, size=128, cameras=[(60, 30)])[0]
            axes.imshow(view, cmap="gray", vmin=0, vmax=255)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
            if category == categories[0]:
                axes.set_ylabel("mesh" if count is None else f"{count:,} points", fontsize=11)
        column[0].set_title(category, fontsize=11, pad=2)
    figure.subplots_adjust(0.03, 0.01, 0.99, 0.95)
    return figure


def export() -> Figure:
    """A piano from a ring of twelve cameras and from a dodecahedron's vertices, shaded and as depths."""
    mesh, rigs = make_shape("piano", np.random.default_rng(3)), (Rings.even(12, [30.0]), Dodecahedron())
    figure = Figure(figsize=(11, 5.5), dpi=90)
    panels = [
        (rig, part, draw)
        for rig, parts in zip(rigs, ((slice(12),), (slice(10), slice(10, 20))), strict=True)
        for draw in (render_views, render_depths)
        for part in parts
    ]
    for axes, (rig, part, draw) in zip(figure.subplots(6, 1), panels, strict=True):
        views = draw(mesh, size=112, cameras=rig.cameras[part])
        axes.imshow(np.concatenate(list(views), 1), cmap="gray", vmin=0, vmax=np.iinfo(views.dtype).max)
        axes.set(xticks=[], yticks=[], anchor="W")
        if part.start is None:
            axes.set_ylabel("depth" if draw is render_depths else f"{len(rig.cameras)} views", fontsize=10)
        axes.spines[:].set_visible(False)
    figure.subplots_adjust(0.03, 0.01, 0.99, 0.99, hspace=0.04)
    return figure


def axes_of_files() -> Figure:
    """A chair from azimuth 60 and elevation 30, with the axes of files of which z, y or x is up."""
    mesh, size = make_shape("sofa", np.random.default_rng(5)), 320
    view = render_views(mesh, size=size, cameras=[(60, 30)])[0]
    a, e = np.radians((60, 30))
    right, up, back = (
        np.array((-np.sin(a), np.cos(a), 0)),
        np.array((-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e))),
        np.array((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e))),
    )

    def pixel(point: np.ndarray) -> np.ndarray:
        scale = size / 2 / FRAME_RADIUS / (DISTANCE - point @ back)
        return np.array((size / 2 + point @ right * scale, size / 2 - point @ up * scale))

    figure = Figure(figsize=(11, 4), dpi=90)
    titles = {
        "z": "z up: all other formats",
        "y": "y up: glTF, PointNet's HDF5",
        "x": "x up: with env.dataset.up=x",
    }
    for panel, (axis, title) in zip(figure.subplots(1, 3), titles.items(), strict=True):
        panel.imshow(view, cmap="gray", vmin=0, vmax=255)
        for name, direction in zip("xyz", upright(np.eye(3), axis), strict=True):
            end, label = pixel(0.95 * direction), pixel(1.08 * direction)
            style = {"arrowstyle": "-|>", "color": "#cf222e", "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
            panel.annotate("", end, pixel(np.zeros(3)), arrowprops=style)
            panel.text(*label, name, color="#cf222e", fontsize=13, ha="center", va="center")
        panel.set_title(title, fontsize=11, loc="left", pad=2)
        panel.set(xlim=(-20, size + 20), ylim=(size + 12, -12))
        panel.set_axis_off()
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.94, wspace=0.02)
    return figure


def curves(runs: list[Path]) -> Figure:
    """The metrics of runs against environment steps."""
    figure = Figure(figsize=(11, 5.6), dpi=90, layout="constrained")
    for axes, (key, title) in zip(figure.subplots(2, 3).flat, CURVES.items(), strict=True):
        for run in runs:
            rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
            points = [(row["step"] / 1000, row[key]) for row in rows if key in row]
            axes.plot(*zip(*points, strict=True), linewidth=1.2, label=run.name)
        axes.set_title(title, fontsize=10.5, loc="left")
        axes.set_xlabel("environment steps, thousands", fontsize=9)
        axes.grid(color="#d0d7de", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def main() -> None:
    """Write the chosen picture to `pictures`."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("picture", choices=("shapes", "points", "export", "axes", "curves"))
    parser.add_argument("runs", nargs="*", type=Path)
    options = parser.parse_args()
    draw = {
        "shapes": shapes,
        "points": points,
        "export": export,
        "axes": axes_of_files,
        "curves": lambda: curves(options.runs),
    }
    figure = draw[options.picture]()
    FigureCanvasAgg(figure)
    figure.savefig(HERE / f"{options.picture}.png")


if __name__ == "__main__":
    main()
