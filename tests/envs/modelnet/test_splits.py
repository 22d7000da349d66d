"""Split rules, against the published counts and, where they are at hand, the ids of LSD-Net's authors."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from activelsd.envs.modelnet.splits import chosen, with_validation

IDS = Path(__file__).parents[4] / "shared/data/lsdnet_split.tsv"


def names(n):
    return [f"cup_{i:04d}" for i in range(n)]


@pytest.mark.parametrize(
    ("rule", "folder", "there", "taken"),
    [
        ("official", "train", 515, 515),
        ("mvcnn", "train", 515, 80),
        ("mvcnn", "train", 64, 64),
        ("mvcnn", "test", 100, 20),
        ("lsdnet", "train", 515, 79),
        ("lsdnet", "train", 79, 78),
        ("lsdnet", "train", 64, 63),
        ("lsdnet", "test", 20, 19),
        ("lsdnet", "test", 1, 0),
    ],
)
def test_a_rule_takes_the_first_in_order_of_names(rule, folder, there, taken):
    assert chosen(names(there)[::-1], folder, rule) == names(there)[:taken]


@pytest.mark.skipif(not IDS.is_file(), reason="the table of the LSD-Net authors' ids is not there")
def test_the_authors_ids_follow_from_larger_folders():
    ids = defaultdict(list)
    with IDS.open() as file:
        for row in csv.DictReader(file, delimiter="\t"):
            ids[row["class"], row["split"]].append(row["object"])
    totals = {"train": 0, "test": 0}
    for (category, folder), listed in ids.items():
        later = 1 if category in {"bowl", "cup"} and folder == "train" else 400
        there = listed + [f"{listed[-1]}_{i:03d}" for i in range(later)]
        assert chosen(there[::-1], folder, "lsdnet") == sorted(listed)
        totals[folder] += len(listed)
    assert totals == {"train": 3143, "test": 760}


@given(st.integers(0, 300), st.integers(0, 300), st.sampled_from(["official", "mvcnn", "lsdnet"]))
def test_validation_is_a_tenth_and_stays_when_objects_are_added(n, more, rule):
    splits = with_validation(chosen(names(n), "train", rule))
    assert (
        with_validation(chosen(names(n + more), "train", rule))[: len(splits)] == splits or rule == "lsdnet"
    )
    assert splits.count("val") == (len(splits) + 8) // 10
    if splits:
        assert splits[0] == "train"
    if len(splits) > 1:
        assert "val" in splits
