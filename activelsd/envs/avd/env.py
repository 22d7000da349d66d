"""The Active Vision Dataset world: walk through a recorded home, as registered with Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activelsd.envs.avd.categories import category_of
from activelsd.envs.avd.datasets import sample_scans, scans_in
from activelsd.envs.avd.prepare import prepare
from activelsd.envs.avd.scan import MOVES
from activelsd.envs.avd.splits import HOMES, split_scans
from activelsd.envs.avd.starts import read_scores, starts, starts_by_score
from activelsd.envs.cache import default_cache
from activelsd.envs.episode import EpisodeRules, as_rules
from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.envs.oracle import with_oracle
from activelsd.envs.start_filters import check_starts, frozen_list
from activelsd.envs.viewgraph import ViewGraph, load_graph
from activelsd.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from activelsd.envs.vector import ViewGraphVectorEnv

TASKS = ("instance", "category")
RECORDED, SAMPLE = "avd", "avd-sample"
"""Backends: photographs of real homes, and rendered rooms that stand in for them."""

SAMPLE_NOTE = "sample.json"


def backend_of(path: str | Path | None) -> str:
    """What made the pictures: cameras, or the writer of sample scans, which leaves a note beside them."""
    return SAMPLE if path is None or (Path(path) / SAMPLE_NOTE).exists() else RECORDED


def avd_graph(
    *,
    path: str | Path | None = None,
    split: str = HOMES,
    train: Sequence[str] | None = None,
    test: Sequence[str] | None = None,
    scans: Sequence[str] | None = None,
    width: int = 480,
    height: int = 270,
    seed: int = 0,
    task: str = "instance",
    size: int = 64,
    navigate: Sequence[str] = MOVES,
    visible: bool = True,
    shown_well: bool = False,
    max_difficulty: int = 5,
    min_size: float = 0.0,
    max_size: float = 1.0,
    per_target: int | None = 20,
    scores: str | Path | None = None,
    threshold: float = 0.9,
    cache: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ViewGraph:
    """The views of scans with the moves asked for, made now or taken from the cache.

    Args:
        path: folder of scans; None for sample scans, which are made in the cache on first use.
        split: `homes`, `1`, `2` or `3`, see `splits.split_scans`.
        train: scans to train on; None for the split's.
        test: scans to test on; None for the split's.
        scans: sample scans to make; None for the split's, or twenty.
        width: of sample photographs, in pixels.
        height: of sample photographs, in pixels.
        seed: draws the sample's homes.
        task: name the `instance`, or the `category` of it, see `categories`.
        size: side of frames and crops in pixels.
        navigate: names of moves, out of `scan.MOVES`.
        visible: see `starts.starts`, as are the next four.
        shown_well: also start where the target is shown well.
        max_difficulty: of the start's box.
        min_size: of the start's box.
        max_size: of the start's box.
        per_target: at most so many starts of each target that validates or tests; None for all.
        scores: table of a recogniser's scores, see `starts.starts_by_score`; None for no such filter.
        threshold: score from which a recogniser is sure.
        cache: folder of views and samples; None for `default_cache()`.
        progress: called with what is done and what there is in all.

    Raises:
        DataError: scans are missing or broken, or no start is left.
        ConfigError: a move, scan, split or task is unknown.
    """
    check_moves(navigate)
    if task not in TASKS:
        raise ConfigError(f"There is no task '{task}'; {did_you_mean(task, TASKS)}")
    cache = default_cache() if cache is None else Path(cache)
    root = Path(path) if path is not None else None
    if root is None:
        root = sample_scans(
            cache, split=split, scans=scans, width=width, height=height, seed=seed, progress=progress
        )
    found = scans_in(root)
    chosen = split_scans(list(found), split, train=train, test=test)
    graph = load_graph(
        prepare([found[name] for name in chosen.scans], size=size, cache=cache, progress=progress)
    )
    graph = starts(
        graph,
        chosen,
        visible=visible,
        shown_well=shown_well,
        max_difficulty=max_difficulty,
        min_size=min_size,
        max_size=max_size,
    )
    if scores is not None:
        graph = starts_by_score(graph, read_scores(graph, Path(scores)), threshold)
    check_starts(graph)
    if per_target is not None:
        graph = frozen_list(graph, per_target)
    graph = with_oracle(graph.with_moves(navigate))
    return by_category(graph) if task == "category" else graph


def check_moves(names: Sequence[str]) -> None:
    """Raise ConfigError where a move is unknown."""
    for name in names:
        if name not in MOVES:
            raise ConfigError(f"The AVD world has no move '{name}'; {did_you_mean(name, MOVES)}")


def by_category(graph: ViewGraph) -> ViewGraph:
    """The graph with categories for classes, in order of name."""
    categories = [category_of(instance) for instance in graph.classes]
    names = sorted(set(categories))
    of_class = np.array([names.index(category) for category in categories])
    return replace(graph, classes=tuple(names), labels=of_class[graph.labels])


class AVDEnv(ViewGraphEnv):
    """Look for an object in a recorded home, walk to where it can be told, and name it.

    Observation and info are `ActiveVisionEnv`'s: `frames` are whole photographs squashed to a square, the box
    of the target is in fractions of them, and `crops` show its surroundings cut from the full-resolution
    photograph; box and crop are zeros where the target is out of sight. Actions: the instances in order of
    their id (or the categories in alphabetical order), then the moves of `navigate`. A move that the
    recording does not have is blocked: it stays and costs. Rewards and ends follow `rules`. An episode begins
    at a view and with a target of the subset's scans, drawn uniformly.

    Example:
        >>> env = gymnasium.make("activelsd/AVD-v0", path="ActiveVisionDataset", split="1", subset="test")
    """

    def __init__(
        self,
        *,
        subset: str = "train",
        rules: str | Mapping[str, Any] | EpisodeRules = "V0",
        frames: int = 1,
        render_mode: str | None = None,
        **world: Any,
    ) -> None:
        """Prepare the views on first use.

        Args:
            subset: `train`, `val` or `test`.
            rules: a preset of Table 1 by name, or rules of your own, also as a dict of their fields.
            frames: K, how many views are stacked.
            render_mode: `rgb_array` or None.
            **world: see `avd_graph`.
        """
        super().__init__(
            avd_graph(**world),
            as_rules(rules),
            split=subset,
            frames=frames,
            backend=backend_of(world.get("path")),
            render_mode=render_mode,
        )


def make_vector(
    num_envs: int,
    *,
    subset: str = "train",
    rules: str | Mapping[str, Any] | EpisodeRules = "V0",
    frames: int = 1,
    **world: Any,
) -> ViewGraphVectorEnv:
    """B copies of `AVDEnv` advanced together; see `ViewGraphVectorEnv`."""
    # A process that plays a single environment need not wait for PyTorch.
    from activelsd.envs.vector import ViewGraphVectorEnv

    return ViewGraphVectorEnv(
        avd_graph(**world),
        as_rules(rules),
        num_envs=num_envs,
        split=subset,
        frames=frames,
        backend=backend_of(world.get("path")),
    )
