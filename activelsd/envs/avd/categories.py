"""Maps an instance's name to a category.

The data set has no categories; these are ours, for its 33 grocery products. They were written without access
to the data, so they match the beginning of a name. The category of any other name is its first word, which is
also how sample scans name their instances: `CATEGORY_…`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activelsd.envs.viewgraph import ViewGraph

PRODUCTS: dict[str, tuple[str, ...]] = {
    "medicine": ("advil", "pepto_bismol"),
    "syrup": ("aunt_jemima",),
    "can": ("bumblebee", "progresso", "hunts"),
    "hot_sauce": ("cholula", "crystal", "tapatio"),
    "drink": ("coca_cola", "red_bull"),
    "toothpaste": ("crest",),
    "mouthwash": ("listerine",),
    "marker": ("expo_marker",),
    "candy": ("hersheys", "spongebob"),
    "cereal": ("honey_bunches",),
    "rice": ("mahatma",),
    "snack_bar": ("nature_valley", "nutrigrain", "quaker"),
    "soap": ("palmolive", "softsoap"),
    "cleaner": ("windex",),
    "shampoo": ("vo5",),
    "snack": ("pop_secret", "pringles"),
    "tableware": ("paper_", "red_cup"),
}
"""For each category, the beginnings of its products' names."""


def category_of(instance: str) -> str:
    """The category of an instance's name."""
    for category, beginnings in PRODUCTS.items():
        if instance.startswith(beginnings):
            return category
    return instance.partition("_")[0]


def by_category(graph: ViewGraph) -> ViewGraph:
    """The graph with categories for classes, in order of name."""
    categories = [category_of(instance) for instance in graph.classes]
    names = sorted(set(categories))
    of_class = np.array([names.index(category) for category in categories])
    return replace(graph, classes=tuple(names), labels=of_class[graph.labels])
