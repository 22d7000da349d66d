"""Which scans train, validate and test."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from activelsd.envs.avd.splits import PUBLISHED, Split, home_of, split_scans
from activelsd.errors import ConfigError, DataError

FOUND = st.lists(st.tuples(st.integers(1, 20), st.integers(1, 3)), min_size=1, unique=True)

# The table of the data set, written out a second time.
TRAIN = {
    "1": "002_1 003_1 003_2 004_1 004_2 005_1 005_2 006_1 014_1 014_2 Office_001_1",
    "2": "001_1 001_2 002_1 004_1 004_2 005_1 005_2 006_1 008_1 014_1 014_2",
    "3": "001_1 001_2 003_1 003_2 004_1 004_2 005_1 005_2 006_1 008_1 Office_001_1",
}
TEST = {"1": "001_1 001_2 008_1", "2": "003_1 003_2 Office_001_1", "3": "014_1 014_2 002_1"}


def scans(text: str) -> set[str]:
    return {word if word.startswith("Office") else f"Home_{word}" for word in text.split()}


@pytest.mark.parametrize("rule", ["1", "2", "3"])
def test_published_splits_are_the_published_ones(rule: str) -> None:
    split = split_scans([*PUBLISHED, "Home_016_1"], rule)
    assert set(split.test) == scans(TEST[rule])
    assert set(split.train + split.val) == scans(TRAIN[rule])
    assert len({home_of(scan) for scan in split.val}) == 1, "a training home is held out to validate"


def test_a_published_split_needs_all_its_scans() -> None:
    with pytest.raises(
        DataError, match=r"Split 1 needs Home_006_1, which is not among the scans .*; download it, or"
    ):
        split_scans([scan for scan in PUBLISHED if scan != "Home_006_1"], "1")


def check(split: Split) -> None:
    assert split.train
    assert split.test
    homes = [{home_of(scan) for scan in part} for part in split]
    assert not homes[0] & homes[1]
    assert not homes[0] & homes[2]
    assert not homes[1] & homes[2]


@given(FOUND)
def test_homes_never_straddle(numbers: list[tuple[int, int]]) -> None:
    found = sorted(f"Home_{home:03d}_{scan}" for home, scan in numbers)
    homes = {home_of(scan) for scan in found}
    if len(homes) == 1:
        with pytest.raises(DataError, match="scans of at least two homes are needed"):
            split_scans(found)
        return
    split = split_scans(found)
    check(split)
    assert list(split.scans) == found
    assert bool(split.val) == (len(homes) - max(1, len(homes) // 4) >= 4)
    assert split == split_scans(found), "always the same"


def test_lists_of_scans_take_the_rules_place() -> None:
    found = ["Home_001_1", "Home_001_2", "Home_002_1", "Home_003_1"]
    assert split_scans(found, train=["Home_002_1"], test=["Home_001_2"]).scans == ("Home_001_2", "Home_002_1")
    only_test = split_scans(found, test=["Home_002_1"])
    assert only_test.train == ("Home_001_1", "Home_001_2", "Home_003_1")
    only_train = split_scans(found, train=["Home_001_1"])
    assert only_train.test == ("Home_003_1",)
    assert split_scans(found, "1", train=["Home_002_1"], test=["Home_003_1"]).test == ("Home_003_1",)
    with pytest.raises(
        ConfigError, match="Home_001 would be in both train and test; name scans of different homes"
    ):
        split_scans(found, train=["Home_001_1"], test=["Home_001_2"])
    with pytest.raises(ConfigError, match="There is no scan 'Home_004_1'; did you mean"):
        split_scans(found, train=["Home_001_1"], test=["Home_004_1"])
