"""What kind of thing an instance is, by its name.

The data set has no categories; these are ours, over its 33 grocery products. The names were written down
without the data at hand, so they go by how a name begins, and a name that is not listed is of the category
that its first word says. That is also how sample scans name theirs: `CATEGORY_…`.
"""

from __future__ import annotations

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
"""Category to how the names of its products begin."""


def category_of(instance: str) -> str:
    """The category of an instance's name."""
    for category, beginnings in PRODUCTS.items():
        if instance.startswith(beginnings):
            return category
    return instance.partition("_")[0]
