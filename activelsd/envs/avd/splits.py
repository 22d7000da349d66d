"""Which scans train, validate and test: the published splits, whole homes in turn, or lists of your own.

Two scans of one home never straddle training and testing: an agent is tested in homes it has not seen.
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
"""The published splits by their test scans; training is the rest of `PUBLISHED`."""

PUBLISHED = tuple(
    sorted(
        {scan for scans in TEST_SCANS.values() for scan in scans}
        | {"Home_004_1", "Home_004_2", "Home_005_1", "Home_005_2", "Home_006_1"}
    )
)

HOMES_WORTH_ONE = 4
"""Training homes from which on one of them is held out to validate."""

VAL_EVERY, VAL_OFFSET = 10, 1


class Split(NamedTuple):
    """Names of scans; `val` is empty where a tenth of the training targets validates."""

    train: tuple[str, ...]
    val: tuple[str, ...]
    test: tuple[str, ...]

    @property
    def scans(self) -> tuple[str, ...]:
        """All of them, in order of name."""
        return tuple(sorted(self.train + self.val + self.test))


def home_of(scan: str) -> str:
    """The place of a scan: `Home_001` of `Home_001_2`."""
    return scan.rpartition("_")[0]


def split_scans(
    found: Sequence[str],
    rule: str = HOMES,
    *,
    train: Sequence[str] | None = None,
    test: Sequence[str] | None = None,
) -> Split:
    """The scans of a split.

    `1`, `2` and `3` are the published ones. `homes` tests on the last quarter of the homes there are, in
    order of name, at least one. Lists of scans take the rule's place. To validate, one training home is held
    out where there are four or more: of those with the fewest scans the last by name; so no training view is
    of a home that validates. With fewer homes a tenth of the training *targets* validates, in rooms that are
    trained in: that says less than a new home does, but leaves scans to train on.

    Args:
        found: names of the scans there are.
        rule: `homes`, `1`, `2` or `3`.
        train: names of scans to train on; None for the rule's.
        test: names of scans to test on; None for the rule's.

    Raises:
        ConfigError: the rule or a scan is unknown, or a home would both train and test.
        DataError: scans that the rule needs are not there.
    """
    tested = _tested(found, rule) if test is None else tuple(test)
    homes = {home_of(scan) for scan in tested}
    if train is None:
        pool = found if rule == HOMES or test is not None else PUBLISHED
        train = [scan for scan in pool if home_of(scan) not in homes]
    for scan in (*train, *tested):
        if scan not in found:
            raise _missing(scan, found, rule, own=scan in PUBLISHED and rule in TEST_SCANS)
    both = sorted(homes & {home_of(scan) for scan in train})
    if both:
        raise ConfigError(f"{both[0]} would both train and test; name scans of different homes.")
    if not train or not tested:
        raise DataError(
            f"There {'is' if len(found) == 1 else 'are'} {', '.join(found)} only; scans of at least two homes"
            " are needed, one to train in and one to test in."
        )
    held = _held_out(train)
    return Split(
        train=tuple(sorted(scan for scan in train if home_of(scan) != held)),
        val=tuple(sorted(scan for scan in train if home_of(scan) == held)),
        test=tuple(sorted(tested)),
    )


def validates(number: int) -> bool:
    """Whether a training target, by its number in order of name, is of the tenth that validates."""
    return number % VAL_EVERY == VAL_OFFSET


def _tested(found: Sequence[str], rule: str) -> tuple[str, ...]:
    if rule in TEST_SCANS:
        return TEST_SCANS[rule]
    if rule != HOMES:
        rules = [HOMES, *TEST_SCANS]
        raise ConfigError(f"There is no split '{rule}' of scans; {did_you_mean(rule, rules)}")
    homes = sorted({home_of(scan) for scan in found})
    last = homes[-max(1, len(homes) // 4) :]
    return tuple(scan for scan in found if home_of(scan) in last)


def _held_out(train: Sequence[str]) -> str | None:
    homes = sorted({home_of(scan) for scan in train})
    if len(homes) < HOMES_WORTH_ONE:
        return None
    return min(reversed(homes), key=lambda home: sum(home_of(scan) == home for scan in train))


def _missing(scan: str, found: Sequence[str], rule: str, *, own: bool) -> ConfigError | DataError:
    if own:
        return DataError(
            f"Split {rule} needs {scan}, which is not among the scans ({', '.join(found)}); get it, or name"
            " scans of your own by env.dataset.train and env.dataset.test."
        )
    return ConfigError(f"There is no scan '{scan}'; {did_you_mean(scan, found)}")
