"""The ModelNet world: a ring of 12 cameras around a CAD object, as registered with Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from activelsd.envs.cache import default_cache
from activelsd.envs.episode import EpisodeRules, as_rules
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.modelnet.datasets import open_dataset
from activelsd.envs.modelnet.orbit import with_moves
from activelsd.envs.modelnet.prepare import prepare
from activelsd.envs.viewgraph import ViewGraph, load_graph

if TYPE_CHECKING:
    from activelsd.envs.vector import ViewGraphVectorEnv

NAVIGATE = ("orbit_cw", "orbit_ccw")
"""The paper's moves."""


def modelnet_graph(
    *,
    path: str | Path | None = None,
    split: str = "official",
    train_per_class: int = 150,
    test_per_class: int = 20,
    dataset_seed: int = 0,
    classes: Sequence[str] | None = None,
    size: int = 64,
    elevations: Sequence[float] = (30.0,),
    navigate: Sequence[str] = NAVIGATE,
    cache: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ViewGraph:
    """The views of a dataset with the moves asked for, rendered now or taken from the cache.

    Args:
        path: folder or zip of meshes, or folder of rendered views; None for the embedded shapes.
        split: `official`, `mvcnn` or `lsdnet`: which objects train and which test.
        train_per_class: embedded shapes to train on, per class.
        test_per_class: embedded shapes to test on, per class.
        dataset_seed: draws the embedded shapes.
        classes: only these classes; None for all.
        size: side of the frames in pixels.
        elevations: of the cameras, in degrees; episodes start on the first.
        navigate: names of moves, see `orbit.ORBIT_MOVES`.
        cache: folder of the rendered views; None for `default_cache()`.
        progress: called with objects done and objects in all while rendering.

    Raises:
        DataError: the dataset is missing, empty or broken.
        ConfigError: a move or class is unknown.
    """
    dataset = open_dataset(
        None if path is None else Path(path),
        split=split,
        train_per_class=train_per_class,
        test_per_class=test_per_class,
        seed=dataset_seed,
        classes=classes,
    )
    file = prepare(
        dataset,
        size=size,
        elevations=elevations,
        cache=default_cache() if cache is None else Path(cache),
        progress=progress,
    )
    return with_moves(load_graph(file), navigate)


class ModelNetEnv(ViewGraphEnv):
    """Look at an object from a ring of cameras, step around it, and name it.

    Observation and info are `ActiveVisionEnv`'s; the target fills the frame. Actions: the dataset's classes
    in alphabetical order, then the moves of `navigate`. Rewards and ends follow `rules`. An episode begins at
    one of the 12 views of the first elevation of an object of the split, both drawn uniformly.

    Example:
        >>> env = gymnasium.make("activelsd/ModelNet-v0", rules="V4", navigate=["orbit_cw", "orbit_ccw"])
    """

    def __init__(
        self,
        *,
        subset: str = "train",
        rules: str | Mapping[str, Any] | EpisodeRules = "V0",
        frames: int = 3,
        render_mode: str | None = None,
        **world: Any,
    ) -> None:
        """Prepare the views on first use.

        Args:
            subset: `train`, `val` or `test` objects.
            rules: a preset of Table 1 by name, or rules of your own, also as a dict of their fields.
            frames: K, how many views are stacked.
            render_mode: `rgb_array` or None.
            **world: see `modelnet_graph`.
        """
        super().__init__(
            modelnet_graph(**world),
            as_rules(rules),
            split=subset,
            frames=frames,
            backend="modelnet",
            render_mode=render_mode,
        )


def make_vector(
    num_envs: int,
    *,
    subset: str = "train",
    rules: str | Mapping[str, Any] | EpisodeRules = "V0",
    frames: int = 3,
    **world: Any,
) -> ViewGraphVectorEnv:
    """B copies of `ModelNetEnv` advanced together; see `ViewGraphVectorEnv`."""
    # A process that plays a single environment need not wait for PyTorch.
    from activelsd.envs.vector import ViewGraphVectorEnv

    return ViewGraphVectorEnv(
        modelnet_graph(**world),
        as_rules(rules),
        num_envs=num_envs,
        split=subset,
        frames=frames,
        backend="modelnet",
    )
