"""The ablation's table checked by hand, and a study that is stopped and gone on with."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest

from activelsd.errors import ConfigError

BASE = ("env=modelnet",)


@pytest.fixture
def ablation(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    monkeypatch.delitem(sys.modules, "ablation", raising=False)
    import ablation

    return ablation


def test_variants_are_those_that_differ_from_the_default(ablation: ModuleType) -> None:
    modelnet = ablation.variants(BASE)
    assert next(iter(modelnet)) == "default"
    assert modelnet["flat"] == ("env=modelnet", "policy.head=flat")
    assert "moves-30" in modelnet
    assert not {"tree", "pool", "supervised", "V4", "dropout-0", "gamma-0.98", "rate-2e-3"} & modelnet.keys()
    flat = ablation.variants((*BASE, "policy.head=flat"))
    assert "tree" in flat
    assert "flat" not in flat
    homes = ablation.variants(("env=avd",))
    assert {"dropout-0", "gamma-0.98", "rate-7e-4"} < homes.keys()
    assert not {"dropout-0.5", "gamma-0.99", "rate-2e-3", "moves-30"} & homes.keys()
    assert list(ablation.variants(BASE, ["V0", "flat", "tree"])) == ["default", "flat", "V0"]
    with pytest.raises(ConfigError, match="no variant 'flatt'"):
        ablation.variants(BASE, ["flatt"])


def test_every_interval_and_difference_of_the_table(ablation: ModuleType) -> None:
    def words(name: str) -> list[tuple[str, str]]:
        return [(name, f"seed={seed}") for seed in range(3)]

    def results(name: str, *figures: tuple[float, float]) -> dict[tuple[str, str], object]:
        return {
            own: ablation.Result(name, own, "val", accuracy, views)
            for own, (accuracy, views) in zip(words(name), figures, strict=False)
        }

    wanted = {name: words(name) for name in ("default", "whole", "half", "single", "none")}
    done = results("default", (0.90, 2.0), (0.92, 2.2), (0.94, 2.4))
    done |= results("whole", (0.93, 3.0), (0.94, 3.0), (0.98, 3.0))
    done |= results("half", (0.80, 1.0), (0.84, 1.0))
    done |= results("single", (0.5, 12.0))
    # t is 4.303 for three seeds: 92 ± 4.303·2/√3; the differences 3, 2, 4 ± 4.303·1/√3, and those of views
    # 1.0, 0.8, 0.6 ± 4.303·0.2/√3. It is 12.706 for two: 82 ± 12.706·2.83/√2; -10, -8 ± 12.706·1.41/√2.
    assert ablation.table(wanted, done).splitlines()[2:] == [
        "| default | 3 | 92.0 ± 5.0 |  | 2.20 ± 0.50 |  |",
        "| whole | 3 | 95.0 ± 6.6 | 3.0 ± 2.5 | 3.00 ± 0.00 | 0.80 ± 0.50 |",
        "| half | 2 | 82.0 ± 25.4 | -9.0 ± 12.7 | 1.00 ± 0.00 | -1.10 ± 1.27 |",
        "| single | 1 | 50.0 | -40.0 | 12.00 | 10.00 |",
        "| none | 0 |  |  |  |  |",
    ]


def test_a_study_goes_on_where_it_was_stopped(
    ablation: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[tuple[str, str, str]] = []

    def apart(variant: str, words: tuple[str, ...], split: str, runs: Path) -> object:
        asked.append((variant, words[-1], split))
        if asked[-1] == ("flat", "seed=1", "val") and len(asked) == 4:
            raise KeyboardInterrupt
        return ablation.Result(variant, words, split, 0.5 if variant == "flat" else 0.75, 2.0)

    monkeypatch.setattr(ablation, "in_own_process", apart)
    wanted = {
        name: [(*words, f"seed={seed}") for seed in range(2)]
        for name, words in ablation.variants(BASE, ["flat"]).items()
    }
    with pytest.raises(KeyboardInterrupt):
        ablation.study(wanted, "val", tmp_path, 1)
    assert "| flat | 1 | 50.0 | -25.0 |" in (tmp_path / "val.md").read_text()
    assert ablation.study(wanted, "val", tmp_path, 1) == (tmp_path / "val.md").read_text()
    assert asked[4:] == [("flat", "seed=1", "val")]
    assert "| flat | 2 | 50.0 ± 0.0 | -25.0 ± 0.0 |" in (tmp_path / "val.md").read_text()
    ablation.study(wanted, "val", tmp_path, 1)
    assert len(asked) == 5
    ablation.study(wanted, "test", tmp_path, 1)
    assert [split for _, _, split in asked[5:]] == ["test"] * 4


def test_an_experiment_takes_up_the_run_there_is(ablation: ModuleType, tmp_path: Path) -> None:
    words = (
        *("env=modelnet", "device=cpu", "env.dataset.classes=[cup,vase]", "env.dataset.train_per_class=3"),
        *("env.dataset.test_per_class=2", "env.size=32", "policy.trunk.features=8", "train.envs=4"),
        "train.steps=40",
    )
    first = ablation.experiment("small", words, "val", tmp_path)
    assert 0 <= first.accuracy <= 1
    assert 1 <= first.views <= 12
    assert ablation.experiment("small", words, "val", tmp_path) == first
    assert ablation.experiment("small", words, "test", tmp_path).split == "test"
    assert len(list(tmp_path.iterdir())) == 1
    ablation.experiment("small", (*words, "seed=1"), "val", tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
