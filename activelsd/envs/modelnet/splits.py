"""Which objects train, validate and test: the official split, MVCNN's part of it, and the LSD-Net authors'.

A rule works on the sorted names of one class in one folder (`train` or `test`), so it can be used with every
data set. Objects for validation are taken from `train`, unless there is a folder `val`.
"""

from __future__ import annotations

from collections.abc import Sequence

FOLDERS = ("train", "test")
"""What every data set has; some have `val` too."""

MVCNN_LIMIT = {"train": 80, "test": 20}
VAL_EVERY = 10
VAL_OFFSET = 1


def chosen(names: Sequence[str], folder: str, rule: str) -> list[str]:
    """The objects that a rule takes from one class and folder.

    `official` takes all. `mvcnn` takes the first 80 of `train` and the first 20 of `test` in order of names
    (Su et al. 2015). `lsdnet` takes those without the last one, also if there are fewer: the LSD-Net authors'
    lists are one short in every class, which makes 3143 and 760 of ModelNet40.

    Args:
        names: of all objects of a class in a folder, in any order.
        folder: `train`, `test`, or `val`, which every rule takes whole.
        rule: as `env.dataset.split`.
    """
    in_order = sorted(names)
    if rule == "official" or folder == "val":
        return in_order
    first = in_order[: MVCNN_LIMIT[folder]]
    return first[:-1] if rule == "lsdnet" else first


def with_validation(names: Sequence[str]) -> list[str]:
    """`train` or `val` for every training object of a class, given in order of names.

    The second of every ten is for validation. So adding objects at the end changes nothing for those before,
    every class of two objects or more has one to validate on, and one to train on is always left.
    """
    return ["val" if i % VAL_EVERY == VAL_OFFSET else "train" for i in range(len(names))]
