"""Splits scans into train, val and test: the published splits, a split by homes, or the user's own lists.

Scans of one home are never in both train and test: an agent is tested in homes that it has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from activelsd.errors import ConfigError, DataError, did_you_mean

HOMES = "homes"
TEST_SCANS: dict[str, tuple[str, ...]] = {
    "1": ("Home_001_1", "Home_001_2", "Home_008_1"),
    "2": ("Home_003_1", "Home_003_2", "Office_001_1"),
    "3": ("Home_014_1", "Home_014_2", "Home_002_1"),
}
"""Test scans of the published splits; the other scans of `PUBLISHED` are for training."""

PUBLISHED = tuple(
    sorted(
        {scan for scans in TEST_SCANS.values() for scan in scans}
        | {"Home_004_1", "Home_004_2", "Home_005_1", "Home_005_2", "Home_006_1"}
    )
)

HOMES_WORTH_ONE = 4
"""With at least this many training homes, one of them is held out for validation."""

VAL_EVERY, VAL_OFFSET = 10, 1


class Split(NamedTuple):
    """Names of scans; `val` is empty if a tenth of the training targets is used for validation."""

    train: tuple[str, ...]
    val: tuple[str, ...]
    test: tuple[str, ...]

    @property
    def scans(self) -> tuple[str, ...]:
        """All scans, sorted by name."""
        return tuple(sorted(self.train + self.val + self.test))


def home_of(scan: str) -> str:
    """The home of a scan: `Home_001` for `Home_001_2`."""
    return scan.rpartition("_")[0]


def split_scans(
    found: Sequence[str],
    rule: str = HOMES,
    *,
    train: Sequence[str] | None = None,
    test: Sequence[str] | None = None,
) -> Split:
    """Splits scans by a rule or by lists.

    `1`, `2` and `3` are the published splits. `homes` tests on the last quarter of the available homes by
    name, at least one. Lists of scans replace the rule's. If there are four or more training homes, one is
    held out for validation: the one with the fewest scans, and the last by name among equals. If there are
    fewer, a tenth of the training *targets* is used for validation, in rooms that are also trained in: a
    weaker test than a new home, but it leaves scans to train on.

    Args:
        found: names of the available scans.
        rule: `homes`, `1`, `2` or `3`.
        train: names of scans to train on; None for the rule's.
        test: names of scans to test on; None for the rule's.

    Raises:
        ConfigError: the rule or a scan is unknown, or a home would be in both train and test.
        DataError: a scan that the rule needs is missing.
    """
    tested = _tested(found, rule) if test is None else tuple(test)
    homes = {home_of(scan) for scan in tested}
    if train is None:
        pool = found if rule == HOMES or test is not None else PUBLISHED
        train = [scan for scan in pool if home_of(scan) not in homes]
    for scan in (*train, *tested):
        if scan not in found:
            raise _missing(scan, found, rule, published=scan in PUBLISHED and rule in TEST_SCANS)
    both = sorted(homes & {home_of(scan) for scan in train})
    if both:
        raise ConfigError(f"{both[0]} would be in both train and test; name scans of different homes.")
    if not train or not tested:
        raise DataError(
            f"The only scans are {', '.join(found)}; scans of at least two homes are needed, one to train in"
            " and one to test in."
        )
    held_out = _held_out(train)
    return Split(
        train=tuple(sorted(scan for scan in train if home_of(scan) != held_out)),
        val=tuple(sorted(scan for scan in train if home_of(scan) == held_out)),
        test=tuple(sorted(tested)),
    )


def validates(number: int) -> bool:
    """Whether a training target, given by its index in order of name, is used for validation."""
    return number % VAL_EVERY == VAL_OFFSET


def _tested(found: Sequence[str], rule: str) -> tuple[str, ...]:
    if rule in TEST_SCANS:
        return TEST_SCANS[rule]
    homes = sorted({home_of(scan) for scan in found})
    last = homes[-max(1, len(homes) // 4) :]
    return tuple(scan for scan in found if home_of(scan) in last)


def _held_out(train: Sequence[str]) -> str | None:
    homes = sorted({home_of(scan) for scan in train})
    if len(homes) < HOMES_WORTH_ONE:
        return None
    return min(reversed(homes), key=lambda home: sum(home_of(scan) == home for scan in train))


def _missing(scan: str, found: Sequence[str], rule: str, *, published: bool) -> ConfigError | DataError:
    if published:
        return DataError(
            f"Split {rule} needs {scan}, which is not among the scans ({', '.join(found)}); download it, or"
            " name other scans in env.dataset.train and env.dataset.test."
        )
    return ConfigError(f"There is no scan '{scan}'; {did_you_mean(scan, found)}")
