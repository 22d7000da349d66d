"""Photographs from all around in colour, 16 of an object or 8, JPEG and PNG: trained and compared."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from activelsd import cli
from activelsd.policy.checkpoint import load_network
from activelsd.train.run import Run

SETTINGS = (
    *("env=modelnet", "env.size=32", "env.colour=rgb", "env.rules.max_views=16", "device=cpu", "threads=1"),
    *("policy.trunk.features=8", "train.envs=8", "train.steps=400", "train.evaluate_every=400"),
)

COLOURS = {"apple": (40, 40, 200), "pear": (40, 200, 40)}  # blue, green, red


def photographs(root: Path) -> Path:
    """Two classes that differ in colour alone; some objects have 16 pictures in JPEG, others 8 in PNG."""
    rng = np.random.default_rng(0)
    for kind, colour in COLOURS.items():
        for number in range(6):
            views, ending = ((16, "jpg"), (8, "png"))[number % 2]
            folder = root / kind / ("train" if number < 4 else "test") / f"{kind}{number}"
            folder.mkdir(parents=True)
            for view in range(views):
                picture = rng.integers(0, 40, (40, 40, 3)).astype(np.uint8)
                picture[8:32, 8 + view : 16 + view] = colour
                cv2.imwrite(str(folder / f"{kind}{number}-{view:03d}.{ending}"), picture)
    return root


def test_rings_of_16_and_8_train_and_compare(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = f"env.dataset.path={photographs(tmp_path / 'photographs')}"
    assert cli.main(["prepare", path, *SETTINGS]) == 0
    said = capsys.readouterr()
    assert "12 objects of 2 classes\n144 views of 32 pixels" in said.out
    assert cli.main(["train", path, *SETTINGS]) == 0
    run = Run(Path(capsys.readouterr().out.splitlines()[-1]))
    assert load_network(run.checkpoint).shape.channels == 3
    assert cli.main(["compare", str(run.folder), "--baselines", "all_views,no_move,random_walk"]) == 0
    result = json.loads((run.folder / "comparison.json").read_text())
    views = {player["name"]: player["views"] for player in result["players"]}
    assert views["no_move"] == 1
    rows = [json.loads(line) for line in (run.folder / "episodes.jsonl").read_text().splitlines()]
    for row in rows:
        number = 16 if row["target"][-1] in "024" else 8
        if row["player"] == "all_views":
            assert row["views"] == number == len(set(row["path"]))
    assert len([row for row in rows if row["player"] == "all_views"]) == 2 * (16 + 8)
    assert views["all_views"] == pytest.approx((16 * 16 + 8 * 8) / 24), "every view is a start"
    figure = cv2.imread(str(run.folder / "comparison.png")).astype(int)
    for colour in COLOURS.values():
        assert (np.abs(figure - colour).max(2) < 12).sum() > 200, "filmstrips are in colour"
