"""Worlds as Gymnasium makes them: the command line's defaults, keywords, and what is said of wrong ones."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from pydantic import Field

from activelsd import registry
from activelsd.compose import resolve
from activelsd.envs.avd.settings import AVDSettings
from activelsd.envs.episode import PRESETS, EpisodeRules
from activelsd.envs.modelnet.settings import ModelNetSettings
from activelsd.envs.settings import WorldSettings
from activelsd.envs.thor.settings import THORSettings
from activelsd.envs.world import world_settings
from activelsd.errors import ConfigError
from activelsd.testing import check_world

SHAPES: dict[str, Any] = {"classes": ("cup", "vase"), "train_per_class": 2, "test_per_class": 1, "size": 32}


@pytest.mark.parametrize("world", registry.worlds.own())
def test_gymnasium_and_the_command_line_have_one_set_of_defaults(world: str) -> None:
    settings = resolve([f"env={world}"]).env
    assert world_settings(world, {}) == settings
    assert registry.worlds.get(world)() == settings
    assert settings.name == world


@pytest.mark.parametrize(
    "imports",
    [
        "import activelsd.envs, gymnasium",
        "import gymnasium, activelsd.envs",
        "import activelsd.envs, importlib.util; importlib.util.find_spec('gymnasium'); import gymnasium",
    ],
)
def test_importing_the_package_registers_the_worlds_whichever_comes_first(imports: str) -> None:
    code = f"{imports}; print(sorted(name for name in gymnasium.registry if 'activelsd' in name))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ids = [f"activelsd/{name}-v0" for name in ("AVD", "ModelNet", "THOR", "World")]
    assert done.stdout.strip() == str(ids)


def test_settings_of_a_group_may_be_nested_or_stand_by_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/someone")
    nested = world_settings("modelnet", {"dataset": {"path": "~/x", "train_per_class": 3}})
    assert nested == world_settings("modelnet", {"path": "~/x", "train_per_class": 3})
    assert isinstance(nested, ModelNetSettings)
    assert nested.dataset.path == Path("/home/someone/x")


@pytest.mark.parametrize(
    ("rules", "meant"),
    [
        ("V0", replace(PRESETS["V0"], revisit=False)),  # this world's own
        ({"preset": "V0", "wrong": -1.0, "revisit": True}, PRESETS["V3"]),
        (EpisodeRules(move=-0.1, max_views=3), EpisodeRules(move=-0.1, max_views=3)),
        (PRESETS["V6"], PRESETS["V6"]),
    ],
)
def test_rules_are_a_preset_or_ones_own(rules: Any, meant: EpisodeRules) -> None:
    assert world_settings("modelnet", {"rules": rules}).rules.rules() == meant


@pytest.mark.parametrize(
    ("world", "keywords", "sentence"),
    [
        ("modelnt", {}, "There is no world 'modelnt'; did you mean modelnet?"),
        ("modelnet", {"sise": 64}, "sise is not a setting of this world; did you mean size?"),
        ("modelnet", {"size": 3}, "size=3: must be at least 32."),
        ("modelnet", {"rules": "V9"}, "rules.preset=V9: must be 'V0', 'V1'"),
        (
            "modelnet",
            {"rules": {"mve": 1}},
            "rules.mve is not a setting of this world; did you mean rules.move?",
        ),
        ("modelnet", {"split": "lsd"}, "dataset.split=lsd: must be 'official', 'mvcnn' or 'lsdnet'"),
        ("modelnet", {"dataset": 3}, "dataset is a group of settings; give it as a dict, as in dataset={"),
        ("avd", {"navigate": ["foward"]}, "The AVD world has no move 'foward'; did you mean forward?"),
    ],
)
def test_a_wrong_keyword_is_one_sentence(world: str, keywords: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        gymnasium.make("activelsd/World-v0", world=world, **keywords)
    assert str(error.value).startswith(sentence)


def test_a_branch_of_ones_own_goes_from_the_settings_to_the_tree(tmp_path: Path) -> None:
    settings = world_settings(
        "modelnet", {**SHAPES, "elevations": [0, 30], "branches": {"tilt": ["orbit_up", "orbit_down"]}}
    )
    assert settings.move_branches["tilt"] == ("orbit_up", "orbit_down")
    env = settings.env()
    assert env.tree.branches == ("classify", "navigate", "tilt")
    env.reset(options={"episode": "train:cup/train_00000:cup/train_00000:e0_a000"})
    *_, info = env.step(env.tree.index("tilt", "orbit_up"))
    assert info["moved"]
    rest = world_settings("thor", {"branches": {"tilt": ["look_up", "look_down"]}})
    assert rest.navigate == THORSettings.moves()[:6], "the other moves stay where they were"
    with pytest.raises(ConfigError, match="'orbit_cw' is named twice"):
        world_settings("modelnet", {**SHAPES, "branches": {"back": ["orbit_cw"]}}).open()


class Halls(AVDSettings):
    """A subclass with a branch by default."""

    branches: dict[str, tuple[str, ...]] = Field({"turn": ("rotate_cw", "rotate_ccw")})


def test_a_class_may_have_a_branch_by_default() -> None:
    assert Halls().move_branches == {
        "navigate": ("forward", "backward", "left", "right"),
        "turn": ("rotate_cw", "rotate_ccw"),
    }


SMALL: dict[str, WorldSettings] = {
    "modelnet": world_settings("modelnet", {**SHAPES, "train_per_class": 3}),
    "modelnet with a branch": world_settings(
        "modelnet",
        {
            **SHAPES,
            "train_per_class": 3,
            "elevations": [0, 30],
            "branches": {"tilt": ["orbit_up", "orbit_down"]},
        },
    ),
    "avd": world_settings(
        "avd", {"scans": ("Home_001_1", "Home_002_1"), "width": 96, "height": 54, "size": 32}
    ),
    "thor": world_settings(
        "thor",
        {"backend": "standin", "rooms": ("bathroom",), "train": 1, "val": 1, "test": 1, "size": 32}
        | {"width": 64, "height": 64, "step": 1.0, "horizons": [0.0], "navigate": THORSettings.moves()[:6]},
    ),
}


@pytest.mark.parametrize("world", SMALL)
def test_own_worlds_pass_the_conformance_suite(world: str, tmp_path: Path) -> None:
    check_world(SMALL[world].model_copy(update={"cache": tmp_path}), train_steps=600)
