"""Broken objects of a data set: all of them are named at once, and views can be had without them.

Which ones were broken is noted beside the views, so that opening these again need not look at the others.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from activelsd.envs.modelnet.splits import FOLDERS
from activelsd.errors import DataError, listed

if TYPE_CHECKING:
    from activelsd.envs.modelnet.datasets import Dataset

_LOG = logging.getLogger("activelsd")


class BrokenObjects(DataError):
    """Raised when objects of a data set cannot be read.

    Attributes:
        reasons: by the object's place in the data set a sentence that names what broke.
    """

    def __init__(self, dataset: Dataset, reasons: Mapping[int, str]) -> None:
        self.reasons = dict(sorted(reasons.items()))
        sentences = list(self.reasons.values())
        skip = "by env.dataset.skip_broken=true"
        what = f"{len(sentences)} objects of {dataset.origin['from']} are broken"
        if len(sentences) == 1:
            super().__init__(f"{sentences[0].rstrip('.')}, or leave it out {skip}.")
        else:
            super().__init__(f"{what}; mend or remove them, or leave them out {skip}:\n{listed(sentences)}")


def without(dataset: Dataset, reasons: Mapping[int, str]) -> Dataset:
    """A data set without its broken objects, which are named on the screen.

    Raises:
        DataError: a class has nothing left to train or to test on.
    """
    if not reasons:
        return dataset
    items = tuple(item for i, item in enumerate(dataset.items) if i not in reasons)
    left = {(item.category, item.split) for item in items}
    for category in dataset.classes:
        for folder in FOLDERS:
            if (category, folder) not in left:
                raise DataError(
                    f"Class '{category}' of {dataset.origin['from']} has no {folder} objects but broken ones:"
                    " mend some, or leave the class out by env.dataset.classes:\n"
                    + listed(list(reasons.values()))
                )
    report_left_out(dataset, reasons)
    return replace(dataset, items=items)


def report_left_out(dataset: Dataset, reasons: Mapping[int, str]) -> None:
    """Names the objects that are left out on the screen, if there are any."""
    if reasons:
        _LOG.warning(
            "%d of %d objects of %s are left out, since they are broken:\n%s",
            len(reasons),
            len(dataset.items),
            dataset.origin["from"],
            listed(list(reasons.values())),
        )


def noted(file: Path) -> dict[str, str]:
    """Why objects were found to be broken, by the names of their frames; none if nothing is noted."""
    with suppress(OSError, ValueError):
        return {str(name): str(reason) for name, reason in json.loads(file.read_text("utf-8")).items()}
    return {}


def note(file: Path, names: Sequence[str], reasons: Mapping[int, str]) -> None:
    """Notes broken objects, by the names of their frames."""
    text = json.dumps({names[i]: reason for i, reason in reasons.items()}, indent=1)
    temporary = file.with_name(file.name + ".tmp")
    temporary.write_text(text + "\n", "utf-8")
    temporary.replace(file)
