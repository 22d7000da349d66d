"""Settings: their layers, their types, and what is said of wrong ones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from activelsd import registry
from activelsd.compose import change, load, resolve, sweep
from activelsd.config import RunConfig
from activelsd.envs.settings import WorldSettings
from activelsd.errors import ConfigError
from activelsd.presets import groups
from activelsd.sections import Schema, Setting, dump
from activelsd.train.settings import EpsilonAnneal

ALL_PRESETS = [(group, name) for group, names in groups().items() for name in names]


class HomeSettings(WorldSettings):
    """A world of another package, as the registry finds it."""

    advice: ClassVar[dict[str, Any]] = {"train.gamma": 0.55, "train.envs": 7}
    scan: str = "Home_001_1"

    @classmethod
    def moves(cls) -> tuple[str, ...]:
        return ("on", "back", "up", "down")


@pytest.fixture(autouse=True)
def home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.worlds._added, "home", HomeSettings)


@pytest.mark.parametrize(("group", "name"), ALL_PRESETS)
def test_every_preset_composes(group: str, name: str) -> None:
    world = [] if group == "experiment" else ["env=modelnet"]
    config = resolve([*world, f"{group}={name}"])
    assert isinstance(config, RunConfig)
    if group == "experiment":
        assert config.name == name


def test_paper_experiment_keeps_the_papers_values() -> None:
    config = resolve(["experiment=paper"])
    assert config.env.size == 224
    assert config.env.navigate == ("orbit_cw", "orbit_ccw")
    assert config.env.rules.preset == "V0"
    assert config.env.dataset.split == "lsdnet"
    policy, train = config.policy, config.train
    parts = (policy.trunk.kind, policy.memory.kind, policy.frames, policy.head)
    assert parts == ("alexnet", "stack", 3, "tree")
    assert (train.gamma, train.length, train.reward_clip, train.clip_norm) == (0.5, 10, 1.0, None)
    assert (train.optimiser, train.learning_rate, train.optimiser_epsilon) == ("tf_rmsprop", 3e-4, 0.1)
    assert train.terms == {"supervised": 0}
    assert train.entropy_leaf.start == train.entropy_leaf.end == 0.01


def test_the_authors_preset_differs_from_the_papers_where_their_code_does() -> None:
    paper, authors = (resolve([f"experiment={name}"]) for name in ("paper", "authors"))
    changed = {"gamma": 0.99, "steps": 25_000_000}
    changed |= {f"epsilon_{level}": EpsilonAnneal(start=0, end=0) for level in ("branch", "leaf")}
    assert authors.train == paper.train.model_copy(update=changed)
    assert authors.policy == paper.policy.model_copy(update={"head": "flat"})
    assert authors.env == paper.env


def test_the_authors_seventh_variant_ranks_both_moves_beside_the_answer() -> None:
    words = "policy.head=tree env.navigate=orbit_cw env.branches.ccw=orbit_ccw"
    config = resolve(["experiment=authors", *words.split()])
    assert isinstance(config.env, WorldSettings)
    assert config.env.move_branches == {"navigate": ("orbit_cw",), "ccw": ("orbit_ccw",)}


def test_last_layer_wins(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("env: modelnet\ntrain: paper\ntrain.gamma: 0.7\npolicy:\n  trunk.features: 64\n")
    config = resolve([f"experiment={file}", "train.length=2"])
    assert config.name == "mine"
    assert config.train.learning_rate == 3e-4  # the preset
    assert config.train.gamma == 0.7  # the experiment, over the preset
    assert config.train.length == 2  # the command line, over the preset
    assert config.policy.trunk.own() == {"features": 64}
    assert config.policy.memory.kind == "pool"  # the schema


def test_preset_on_the_command_line_replaces_the_experiments() -> None:
    config = resolve(["train=default", "experiment=paper", "train.gamma=0.9", "train.gamma=0.8"])
    assert config.train.learning_rate == resolve(["env=modelnet"]).train.learning_rate
    assert config.train.gamma == 0.8
    assert config.policy.trunk.kind == "alexnet"


@pytest.mark.parametrize(
    ("word", "key", "value"),
    [
        ("train.learning_rate=3e-4", "train.learning_rate", 3e-4),
        ("train.steps=2e6", "train.steps", 2_000_000),
        ("train.steps=900_000", "train.steps", 900_000),
        ("train.clip_norm=null", "train.clip_norm", None),
        ("train.decay=no", "train.decay", False),
        ("train.epsilon_branch.start=0.5", "train.epsilon_branch.start", 0.5),
        ("env.navigate=orbit_cw,orbit_ccw", "env.navigate", ("orbit_cw", "orbit_ccw")),
        ("env.navigate=[orbit_cw]", "env.navigate", ("orbit_cw",)),
        ("env.elevations=[0, 30]", "env.elevations", (0.0, 30.0)),
        ("env.dataset.classes=[bed,sofa]", "env.dataset.classes", ("bed", "sofa")),
        ("env.dataset.classes=null", "env.dataset.classes", None),
        ("env.dataset.path=/a/b=c", "env.dataset.path", Path("/a/b=c")),
        ("train.loggers=[]", "train.loggers", []),
        ("name=012", "name", "012"),
    ],
)
def test_values_are_converted_by_their_fields_type(word: str, key: str, value: object) -> None:
    found: object = resolve(["env=modelnet", word])
    for part in key.split("."):
        found = getattr(found, part)
    assert found == value
    assert type(found) is type(value) or isinstance(found, Path)


def test_other_half_of_a_nested_default_stays() -> None:
    before = resolve(["env=modelnet"]).train.epsilon_branch
    after = resolve(["env=modelnet", "train.epsilon_branch.start=0.5"]).train.epsilon_branch
    assert (after.start, after.end) == (0.5, before.end)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("train.learning_rat=1", "train.learning_rat is not a setting; did you mean train.learning_rate?"),
        ("polcy=paper", "polcy is not a setting; did you mean policy?"),
        ("gamma=0.9", "gamma is not a setting; did you mean train.gamma?"),
        ("env.gamma=0.9", "env.gamma is not a setting; did you mean train.gamma?"),
        ("polcy.memory=lstm", "polcy.memory is not a setting; did you mean policy.memory?"),
        (
            "train.epsilon_brnch.start=1",
            "train.epsilon_brnch.start is not a setting; did you mean train.epsilon_branch.start?",
        ),
        ("zzz=1", "zzz is not a setting; --dry-run lists all there are."),
        ("policy=pper", "There is no policy preset 'pper'; did you mean paper?"),
        ("policy=zzz", "There is no policy preset 'zzz'; there are authors, default, paper, paper_lstm."),
        ("experiment=dem", "There is no experiment preset 'dem'; did you mean demo?"),
        ("experiment=none.yaml", "none.yaml cannot be read (No such file or directory); name another file."),
        ("train.learning_rate=abc", "train.learning_rate=abc: must be a number."),
        ("train.learning_rate=0", "train.learning_rate=0: must be greater than 0."),
        ("train.steps=1.5", "train.steps=1.5: must be a whole number."),
        ("train.decay=maybe", "train.decay=maybe: must be true or false."),
        ("train.clip_norm=x", "train.clip_norm=x: must be a number, or null."),
        ("train.epsilon_leaf.start=2", "train.epsilon_leaf.start=2: must be at most 1."),
        (
            "train.epsilon_leaf=2",
            "train.epsilon_leaf is a group of settings; set one of train.epsilon_leaf.start,",
        ),
        ("env.size=12", "env.size=12: must be at least 32."),
        ("env.navigate=[a", "env.navigate=[a: must be a list, as in [a,b]."),
        ("env.elevations=x", "env.elevations=x: must be a number."),
        ("env.navigate=[]", "env.navigate=[]: must be a list of at least 1."),
        ("env.navigate=orbit_cww", "The ModelNet world has no move 'orbit_cww'; did you mean orbit_cw?"),
        (
            "env.branches.classify=[orbit_cw]",
            "env.branches.classify: the branch 'classify' is the classes'; name another for these moves.",
        ),
        (
            "env.branches.navigate=[orbit_cw]",
            "env.branches.navigate: the branch 'navigate' is of env.navigate; name another for these",
        ),
        ("env.branches.tilt=orbt_up", "The ModelNet world has no move 'orbt_up'; did you mean orbit_up?"),
        (
            "env.elevations=[60,0]",
            "env.elevations=[60,0] must rise, since orbit_up goes to the next; write [0,60].",
        ),
        ("env.rules=V9", "env.rules.preset=V9: must be 'V0', 'V1', 'V2', 'V3', 'V4', 'V5' or 'V6'"),
        ("policy.memory=pol", "There is no memory 'pol'; did you mean pool?"),
        ("policy.trunk=alexnet policy.trunk.features=8", "policy.trunk.features is not a setting; "),
        ("policy.features=8", "policy.features is called policy.trunk.features now."),
        ("train.guided=1", "train.guided is called train.terms.guided now."),
        ("train.terms.gided=1", "There is no loss term 'gided'; did you mean guided?"),
        ("train.loggers=[tensorbord]", "There is no logger 'tensorbord'; did you mean tensorboard?"),
        ("train.terms.guided=x", "train.terms.guided=x: must be a number."),
        ("name=a/b", "name=a/b: must be letters, digits and . _ + - only, or null."),
        ("env.name=hme", "There is no world 'hme'; did you mean home?"),
        ("env.name=xyz", "There is no world 'xyz'; there are modelnet, avd, thor, home."),
        ("word", "'word' is not a setting; write key=value, as in env=modelnet or seed=1."),
    ],
)
def test_wrong_words_get_one_sentence_with_the_way_out(words: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        resolve(["env=modelnet", *words.split()])
    assert str(error.value).startswith(sentence)


def test_a_world_is_needed() -> None:
    with pytest.raises(ConfigError, match=r"No world is named; add env=modelnet"):
        resolve(["seed=1"])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "env: modelnet\ntrain.gama: 1",
            "train.gama is not a setting (in {file}); did you mean train.gamma?",
        ),
        ("env: modelnet\ntrain: {gamma: x}", "train.gamma=x (in {file}): must be a number."),
        ("env: xyz", "There is no world 'xyz' (in {file}); there are modelnet, avd, thor, home."),
        ("- a\n- b", "{file} holds no settings; write one `key: value` a line."),
        ("a: [", "{file} is not YAML: while parsing"),
    ],
)
def test_wrong_files_are_named(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as error:
        resolve([f"experiment={file}"])
    assert str(error.value).startswith(sentence.format(file=file))


def test_key_of_another_world_says_which() -> None:
    assert resolve(["env.name=home", "env.size=96"]).env.size == 96
    with pytest.raises(
        ConfigError, match=r"^env\.task is a setting of the world avd, and this run's world is h"
    ):
        resolve(["env=home", "env.task=x"])
    with pytest.raises(ConfigError, match=r"^env\.size=x: must be a whole number\.$"):
        resolve(["env=home", "env.size=x"])


@pytest.fixture
def presets(tmp_path: Path) -> Path:
    """Presets of worlds in files: two of homes, and ones that are not right."""
    for name, text in {
        "flat": "name: home",
        "house": "name: home\nscan: House_1\nsize: 96",
        "nameless": "size: 48",
        "two-rooms": "name: home",
        "moon": "name: xyz",
        "both": f"env: [modelnet, {tmp_path}/house.yaml]\nenv.size: 32",
    }.items():
        (tmp_path / f"{name}.yaml").write_text(text + "\n")
    return tmp_path


def test_several_worlds_have_their_own_settings_and_share_what_is_said_to_all(presets: Path) -> None:
    words = [f"env=modelnet,{presets}/flat.yaml,{presets}/house.yaml", "env.house.size=64", "env.size=96"]
    with pytest.raises(ConfigError, match=r"^One network needs frames of one size, not env\.modelnet"):
        resolve(words)
    config = resolve([*words, "env.house.size=96", "env.scan=x", "env.modelnet.navigate=orbit_cw"])
    assert list(config.worlds) == ["modelnet", "flat", "house"]
    assert [type(world).__name__ for world in config.worlds.values()] == [
        "ModelNetSettings",
        "HomeSettings",
        "HomeSettings",
    ]
    assert config.worlds["modelnet"].navigate == ("orbit_cw",)
    assert [config.worlds[name].scan for name in ("flat", "house")] == ["x", "x"]  # type: ignore[union-attr]
    assert config.title == "modelnet+flat+house"
    assert resolve(["env=modelnet"]).title == "modelnet"
    assert list(resolve(["env=modelnet"]).worlds) == ["modelnet"]

    file = presets / "config.yaml"
    file.write_text(dump(config))
    assert load(file) == config
    changed = change(config, ["env.cache=/c"], ("env.cache",), "a run stays as it is")
    assert [world.cache for world in changed.worlds.values()] == [Path("/c")] * 3
    own = change(config, ["env.flat.cache=/c"], ("env.flat.cache",), "a run stays as it is")
    assert own.worlds["modelnet"] == config.worlds["modelnet"]


def test_an_experiment_may_list_worlds(presets: Path) -> None:
    config = resolve([f"experiment={presets}/both.yaml"])
    assert {name: world.size for name, world in config.worlds.items()} == {"modelnet": 32, "house": 32}
    one = resolve([f"experiment={presets}/both.yaml", "env=modelnet"])
    assert list(one.worlds) == ["modelnet"]
    assert one.env.size == 32
    names = [c.name for c in sweep([f"env=modelnet,{presets}/flat.yaml"], ["env.size=64,96"])]
    assert names == ["modelnet+flat-size-64", "modelnet+flat-size-96"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("env=modelnet,modelnet", "env names 'modelnet' twice; name each world once."),
        ("env=modelnet,xyz", "There is no world 'xyz'; there are modelnet, avd, thor, home."),
        (
            "env=modelnet,{0}/nameless.yaml",
            "{0}/nameless.yaml does not say which world it is for; add",
        ),
        ("env=modelnet,{0}/two-rooms.yaml", "{0}/two-rooms.yaml cannot name a world of a joint run;"),
        (
            "env=modelnet,{0}/moon.yaml",
            "There is no world 'xyz' (in {0}/moon.yaml); there are modelnet,",
        ),
        ("env=modelnet,{0}/flat.yaml env.flat.size=x", "env.flat.size=x: must be a whole number."),
        ("env=modelnet,{0}/flat.yaml env.size=12", "env.modelnet.size=12: must be at least 32."),
        (
            "env=modelnet,{0}/flat.yaml env.flat.scn=x",
            "env.flat.scn is not a setting; did you mean env.flat.s",
        ),
        ("env=modelnet,{0}/flat.yaml env.sise=64", "env.sise is not a setting; did you mean env.size?"),
        ("env=modelnet,{0}/flat.yaml env.flat.navigate=[x]", "The Home world has no move 'x'; there are on"),
        ("env.name=joint env.a.name=home", "A joint run needs two worlds or more; name them as in"),
        (
            "env=modelnet,{0}/flat.yaml env.size=96 train.actors=ga3c",
            "train.actors=ga3c plays one world; for several set train.actors=resident.",
        ),
    ],
)
def test_wrong_words_about_several_worlds(presets: Path, words: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        resolve(words.format(presets).split())
    assert str(error.value).startswith(sentence.format(presets))


@pytest.mark.parametrize("actors", ["ga3c", "ray"])
@pytest.mark.parametrize("switch", ["amp", "compile", "cuda_graphs"])
def test_speed_switches_are_for_resident_actors(switch: str, actors: str) -> None:
    assert getattr(resolve(["env=modelnet", f"train.{switch}=true"]).train, switch)
    with pytest.raises(ConfigError, match=rf"^train\.{switch}=true is for train\.actors=resident"):
        resolve(["env=modelnet", f"train.{switch}=true", f"train.actors={actors}"])


def test_a_trunk_brings_advice_and_the_world_its_own_with_it() -> None:
    words = ["policy.trunk=timm:resnet18", "policy.trunk.freeze=none"]
    config = resolve(["env=modelnet", *words])
    assert (config.policy.certainty, config.train.dropout, config.train.mirror) == (True, 0.5, True)
    assert (config.env.rules.preset, config.env.rules.move) == ("V5", -0.03)
    config = resolve(["env=modelnet", *words, "env.rules=V4", "train.dropout=0.1"])
    assert (config.env.rules.preset, config.env.rules.move, config.train.dropout) == ("V4", None, 0.1)
    joint = resolve(["env=modelnet,avd", *words])
    assert joint.policy.certainty
    assert joint.worlds["modelnet"].rules.preset == "V4"
    assert not resolve(["env=modelnet"]).policy.certainty


def test_advice_for_a_part_is_not_for_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HomeSettings, "advice", {"policy.trunk.features": 24, "train.gamma": 0.5})
    assert resolve(["env=home"]).policy.trunk.own() == {"features": 24}
    config = resolve(["env=home", "policy.trunk=alexnet"])
    assert (config.policy.trunk.own(), config.train.gamma) == ({}, 0.5)
    assert resolve(["env=home", "policy=paper"]).policy.trunk.kind == "alexnet"


@pytest.mark.parametrize(
    ("advice", "said"),
    [
        ({"train.gama": 1}, "train.gama is not a setting (in the advice of the world home); did you mean"),
        ({"train.gamma": 9}, "train.gamma=9 (in the advice of the world home): must be at most 1."),
    ],
)
def test_bad_advice_is_a_worlds_own(
    advice: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HomeSettings, "advice", advice)
    with pytest.raises(ConfigError, match=re.escape(said)):
        resolve(["env=home"])


def test_sweep_is_the_cross_product_and_names_its_runs() -> None:
    configs = sweep(["experiment=demo"], ["seed=0,1", "env.navigate=[orbit_cw],[orbit_cw,orbit_ccw]"])
    assert [(c.seed, len(c.env.navigate)) for c in configs] == [(0, 1), (0, 2), (1, 1), (1, 2)]
    assert configs[3].name == "demo-seed-1-navigate-orbit_cw-orbit_ccw"
    assert [c.name for c in sweep(["experiment=demo"], [])] == ["demo"]
    rates = [c.name for c in sweep(["experiment=demo"], ["train.gamma=0.5,.5,0.95"])]
    assert rates == ["demo-gamma-0.5", "demo-gamma-.5", "demo-gamma-0.95"]
    assert all(resolve(["env=modelnet", f"name={c.name}"]) for c in configs)
    with pytest.raises(ConfigError, match="did you mean seed"):
        sweep(["experiment=demo"], ["sed=0,1"])


def test_dump_is_yaml_that_loads_back(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    words = ["experiment=paper", "env.dataset.classes=['null','012',yes]", "train.learning_rate=1e-7"]
    config = resolve(words)
    assert config.env.dataset.classes == ("null", "012", "yes")
    file.write_text(dump(config))
    assert load(file) == config
    assert resolve([f"experiment={file}"]) == config
    assert yaml.safe_load(dump(config))["train"]["gamma"] == 0.5


@settings(max_examples=30)
@given(
    rate=st.floats(1e-12, 1e3),
    gamma=st.floats(0, 1),
    classes=st.none()
    | st.lists(st.text(st.characters(codec="utf-8", exclude_categories=["C"]), min_size=1), min_size=2),
)
def test_any_config_survives_its_file(
    tmp_path_factory: pytest.TempPathFactory, rate: float, gamma: float, classes: list[str] | None
) -> None:
    base = resolve(["env=modelnet"]).model_dump()
    base["train"] |= {"learning_rate": rate, "gamma": gamma}
    base["env"]["dataset"]["classes"] = classes
    config = RunConfig.model_validate(base)
    file = tmp_path_factory.getbasetemp() / "any.yaml"
    file.write_text(dump(config))
    assert load(file) == config


@pytest.mark.parametrize("worlds", ["modelnet", "modelnet,avd"])
def test_a_run_older_than_revisit_is_played_by_the_rules_it_learned(worlds: str, tmp_path: Path) -> None:
    config = resolve([f"env={worlds}"])
    assert not config.worlds["modelnet"].rules.revisit
    file = tmp_path / "config.yaml"
    file.write_text("".join(line for line in dump(config).splitlines(True) if "revisit:" not in line))
    assert {world.rules.revisit for world in load(file).worlds.values()} == {True}


def test_a_dict_is_read_back_with_no_more_than_it_had(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("env: modelnet\ntrain.terms: {}\n")
    config = resolve([f"experiment={file}", "train.terms.guided=0.5"])
    assert config.train.terms == {"guided": 0.5}
    file.write_text(dump(config))
    assert load(file) == config
    assert change(config, ["seed=1"], ["seed"], "").train.terms == {"guided": 0.5}


def test_change_leaves_the_rest_and_guards_what_is_fixed() -> None:
    config = resolve(["experiment=paper", "seed=3"])
    changed = change(config, ["evaluate.split=val"], ("evaluate", "device"), "a run stays as it is")
    assert changed == config.model_copy(update={"evaluate": changed.evaluate})
    assert changed.evaluate.split == "val"
    with pytest.raises(
        ConfigError, match=r"^policy\.memory cannot be changed here, a run stays as it is; what can"
    ):
        change(config, ["policy.memory=lstm"], ("evaluate", "device"), "a run stays as it is")
    with pytest.raises(ConfigError, match=r"did you mean evaluate\.split"):
        change(config, ["evaluate.splt=val"], ("evaluate",), "a run stays as it is")


def test_config_is_frozen_and_every_setting_is_described() -> None:
    config = resolve(["env=modelnet"])
    with pytest.raises(ValidationError):
        config.seed = 1  # type: ignore[misc]
    for world in registry.worlds.own():
        fields = Schema(RunConfig, {"env.name": Setting(world)}).fields
        assert all(field.description for field in fields.values())


def test_relative_paths_keep_their_meaning(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", "/home/someone")
    assert resolve(["env=modelnet", "env.dataset.path=meshes"]).env.dataset.path == tmp_path / "meshes"
    assert resolve(["env=modelnet", "env.cache=~/c"]).env.cache == Path("/home/someone/c")


def test_a_world_says_what_learns_best_there_and_anything_else_outweighs_it(tmp_path: Path) -> None:
    first, second = tmp_path / "hall.yaml", tmp_path / "attic.yaml"
    first.write_text("name: avd\ntrain.gamma: 0.5\ntrain.ga3c.agents: 3\n")
    second.write_text("name: avd\nsize: 64\ntrain: {gamma: 0.6, envs: 7}\n")
    more = tmp_path / "more.yaml"
    more.write_text("gamma: 0.7\n")
    alone = resolve([f"env={first}"])
    assert (alone.train.gamma, alone.train.ga3c.agents) == (0.5, 3)
    assert resolve([f"env={first}", f"train={more}"]).train.gamma == 0.7
    assert resolve([f"env={first}", "train.gamma=0.8"]).train.gamma == 0.8
    both = resolve([f"env={first},{second}"]).train
    assert (both.gamma, both.envs) == (0.5, 7), "where worlds differ the first counts"
    first.write_text("name: avd\ntrain.gama: 0.5\n")
    with pytest.raises(ConfigError, match=rf"train.gama is not a setting \(in {first}\)"):
        resolve([f"env={first}"])
