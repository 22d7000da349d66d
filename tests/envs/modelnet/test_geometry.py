"""What worlds know of their objects beside pictures: depths and panoramas."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from activelsd.envs.modelnet.datasets import open_dataset
from activelsd.envs.modelnet.settings import DatasetSettings, ModelNetSettings
from activelsd.envs.modelnet.sources import Drawn
from activelsd.envs.world import world_settings
from activelsd.errors import ConfigError
from activelsd.scenery.depths import NOTHING, as_levels
from activelsd.scenery.orbit_renderer import render_depths
from activelsd.scenery.panorama import render_panorama

FEW = DatasetSettings(classes=("cup", "vase"), train_per_class=2, test_per_class=1)


def world(cache: Path) -> ModelNetSettings:
    return ModelNetSettings(size=32, azimuths=4, elevations=(0, 30), dataset=FEW, cache=cache)


def test_depths_are_those_of_the_graphs_views_and_kept(tmp_path: Path) -> None:
    own = world(tmp_path)
    graph, depths = own.graph(), own.depths()
    assert depths.levels.shape == graph.frames.shape
    assert depths.cameras.shape == (len(graph.frames), 2)
    source = open_dataset(FEW)
    assert isinstance(source.source, Drawn)
    for i, item in enumerate(source.items):
        cameras = depths.cameras[graph.scene_of == i]
        levels = as_levels(render_depths(source.source.mesh(item), size=32, cameras=cameras))
        np.testing.assert_array_equal(depths.levels[graph.scene_of == i], levels)
        names = [name for name, scene in zip(graph.view_names, graph.scene_of, strict=True) if scene == i]
        assert names == [f"e{elevation:g}_a{azimuth:03g}" for azimuth, elevation in cameras]
    shown = graph.frames < 255
    assert (shown & (depths.levels == NOTHING)).mean() < 0.05, "what is drawn has a depth, edges aside"
    before = {file: file.stat().st_mtime_ns for file in tmp_path.glob("*.h5")}
    own.depths()
    assert {file: file.stat().st_mtime_ns for file in tmp_path.glob("*.h5")} == before
    assert len(before) == 2


def test_panoramas_are_those_of_the_graphs_targets(tmp_path: Path) -> None:
    own = world(tmp_path)
    source = open_dataset(FEW)
    assert isinstance(source.source, Drawn)
    expected = [render_panorama(source.source.mesh(item)) for item in source.items]
    np.testing.assert_array_equal(own.panoramas(), expected)
    assert own.graph().targets == tuple(item.name for item in source.items)


def test_pictures_and_rooms_tell_neither(tmp_path: Path) -> None:
    for split in ("train", "test"):
        for kind in ("cup", "vase"):
            folder = tmp_path / kind / split
            folder.mkdir(parents=True)
            for view in range(1, 5):
                cv2.imwrite(str(folder / f"{kind}_0001_{view:03d}.png"), np.zeros((32, 32), np.uint8))
    pictures = ModelNetSettings(dataset=DatasetSettings(path=tmp_path), cache=tmp_path / "cache")
    with pytest.raises(ConfigError, match=r"holds pictures, which tell no depth of objects; use meshes"):
        pictures.depths()
    with pytest.raises(ConfigError, match=r"which tell no panorama of objects"):
        pictures.panoramas()
    rooms = world_settings("thor", {})
    with pytest.raises(ConfigError, match=r"^env=thor does not know the depths of its views; env=modelnet"):
        rooms.depths()
    with pytest.raises(ConfigError, match=r"^env=thor does not know the shapes of its objects;"):
        rooms.panoramas()
