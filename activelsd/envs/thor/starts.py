"""Where episodes begin in simulated rooms: views that show a target, and not yet well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from activelsd.envs.oracle import shows_well
from activelsd.envs.thor.settings import SightsSettings
from activelsd.envs.viewgraph import SPLITS, ViewGraph


def starts(graph: ViewGraph, split_of: Mapping[str, str], settings: SightsSettings) -> ViewGraph:
    """The recorded graph with the starts that pass the filters; `split_of` gives every scene's split."""
    assert graph.pair_of is not None
    assert graph.pixels is not None
    assert graph.difficulty is not None
    good = (graph.pixels >= settings.min_pixels) & (graph.difficulty <= settings.max_difficulty)
    if not settings.shown_well:
        good &= ~shows_well(graph)
    view, target = np.nonzero(np.append(good, False)[graph.pair_of])
    numbers = np.array([SPLITS.index(split_of[scene]) for scene in graph.scenes], np.uint8)
    return replace(
        graph,
        start_view=view.astype(np.int32),
        start_target=target.astype(np.int32),
        start_split=numbers[graph.scene_of[view]],
    )
