"""Composes a config from words: schema defaults < presets < `experiment=` < `key=value`, the last one wins.

Between the defaults and the presets stands what a world says of other groups: what learns best there.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from itertools import product
from pathlib import Path

import yaml

from activelsd import registry, sections
from activelsd.config import JOINT, JointSettings, RunConfig
from activelsd.errors import ConfigError, did_you_mean
from activelsd.presets import is_file, preset_file, read_settings
from activelsd.sections import Schema, Setting, TextLoader, dump, flatten, is_path
from activelsd.versions import check_parts

EXPERIMENT, ENV, ENV_NAME = "experiment", "env", "env.name"
GROUPS = (ENV, EXPERIMENT, "policy", "train")

RENAMED = {
    "policy.features": "policy.trunk.features",
    "train.supervised": "train.terms.supervised",
    "train.guided": "train.terms.guided",
}
"""Settings of older runs by what they are called now."""


def resolve(words: Sequence[str]) -> RunConfig:
    """Compose a config from `group=preset`, `experiment=NAME or FILE` and `key=value` words.

    An experiment's file says what the command line would: presets of groups by name, and keys. A preset on
    the command line takes the place of the one that the experiment names for that group. `env` may list
    several worlds, for one network that plays them all.

    Raises:
        ConfigError: a group, preset, key or value is not one there is.
    """
    presets: dict[str, Setting] = {}
    keys: dict[str, Setting] = {}
    for key, setting in map(_split_word, words):
        (presets if key in GROUPS else keys)[key] = setting

    written: dict[str, Setting] = {}
    if EXPERIMENT in presets:
        file = preset_file(EXPERIMENT, presets.pop(EXPERIMENT))
        for key, setting in read_settings(file).items():
            if key in GROUPS:
                presets.setdefault(key, setting)
            else:
                written[key] = setting
        written.setdefault("name", Setting(file.stem, file))

    layers: dict[str, Setting] = {}
    for group, setting in presets.items():
        own = (
            _env_layers(setting) if group == ENV else read_settings(preset_file(group, setting), f"{group}.")
        )
        layers |= own
    layers = _advice_in_files(layers) | layers
    members = _members(layers | written | keys)
    layers |= _spread(written, members, layers) | _spread(keys, members, layers)
    config = _build(_worlds_advice(layers, members) | layers)
    for kind, name in config.parts():
        kind.check(name)
    return config


def sweep(words: Sequence[str], sweeps: Sequence[str]) -> list[RunConfig]:
    """A config per combination of `key=a,b,c` sweeps, named after its values; without any, just one."""
    axes = []
    for key, setting in map(_split_word, sweeps):
        values = re.split(r",(?![^\[]*\])", setting.value)  # commas inside brackets stay
        axes.append([f"{key}={value}" for value in values])
    configs = []
    for combination in product(*axes):
        config = resolve([*words, *combination])
        if combination:
            tails = (_tail(word) for word in combination)
            name = "-".join([config.title, *tails])
            config = config.model_copy(update={"name": name})
        configs.append(config)
    return configs


def _tail(word: str) -> str:
    """The last part of a key and its value, as a part of a file's name."""
    key, _, value = word.partition("=")
    return re.sub(r"[^\w.+-]+", "-", f"{key.rpartition('.')[2]}={value}").strip("-")


def load(file: Path) -> RunConfig:
    """Read a resolved config, as `dump` writes it; settings of older runs are read by their new names.

    Raises:
        ConfigError: the file is missing or does not fit the schema, or a part is not installed here.
    """
    layers = {RENAMED.get(key, key): setting for key, setting in read_settings(file).items()}
    trunk = layers.get("policy.trunk", Setting("compact")).value
    if trunk != "compact" and "policy.trunk.kind" not in layers:  # AlexNet's width was never a setting
        layers.pop("policy.trunk.features", None)
    try:
        if ENV_NAME in layers:  # a run that says nothing of these is older than they are
            older = {f"{ENV}.colour": Setting("gray"), f"{ENV}.rules.revisit": Setting(True)}
            layers = _spread(older, _members(layers), layers) | layers
        return _build(_whole(layers))
    except ConfigError:
        check_parts(file.parent)
        raise


def change(config: RunConfig, words: Sequence[str], allowed: Collection[str], why: str) -> RunConfig:
    """A copy of a run's config with `key=value` words applied.

    Args:
        config: the config of a run there is.
        words: what to change.
        allowed: keys, or sections, that may be changed; the world's paths always may, since data move.
        why: the reason that others may not, for the sentence of the error.

    Raises:
        ConfigError: a key or value is not one there is, or the key may not be changed.
    """
    layers = {key: Setting(value) for key, value in flatten(yaml.load(dump(config), TextLoader))}
    keys = dict(map(_split_word, words))
    members = _members(layers)
    changed = _build(_whole(layers) | _spread(keys, members, layers))
    schemas = [Schema(RunConfig, {ENV_NAME: Setting(kind)}) for kind in members.values()]
    for key in keys:
        inside = re.sub(rf"^{ENV}\.({'|'.join(members)})\.", f"{ENV}.", key) if members else key
        found = (schema.find(inside) for schema in schemas or [Schema(RunConfig, layers)])
        place = inside.startswith(f"{ENV}.") and any(one and is_path(one[1]) for one in found)
        if not place and not any(
            one == name or one.startswith(f"{name}.") for one in (key, inside) for name in allowed
        ):
            what = ", ".join([*allowed, "paths such as env.dataset.path"])
            raise ConfigError(f"{key} cannot be changed here, {why}; what can: {what}.")
    return changed


def _whole(layers: dict[str, Setting]) -> dict[str, Setting]:
    """The layers of a dumped config, whose dicts are complete: entries of their defaults are not added."""
    fields = Schema(RunConfig, layers).fields if ENV_NAME in layers else {}
    dicts = (key for key, field in fields.items() if isinstance(field.default, dict))
    given = {key for key in dicts if any(name.startswith(f"{key}.") for name in layers)}
    return {key: Setting({}) for key in given} | layers


def _split_word(word: str) -> tuple[str, Setting]:
    key, equals, text = word.partition("=")
    if not equals or not key:
        raise ConfigError(f"'{word}' is not a setting; write key=value, as in env=modelnet or seed=1.")
    return key, Setting(text, None)


def _env_layers(setting: Setting) -> dict[str, Setting]:
    """The settings that `env=modelnet`, `env=FILE.yaml` or `env=modelnet,avd` stands for.

    Several worlds stand each below its own name. A file may write them as a list.
    """
    listed = setting.value
    if not isinstance(listed, list):
        text = str(listed)
        listed = text.removeprefix("[").removesuffix("]").split(",") if "," in text else [text]
    worlds = [Setting(str(name).strip(), setting.file) for name in listed]
    if len(worlds) == 1:
        return _world_layers(worlds[0], f"{ENV}.")
    layers = {ENV_NAME: Setting(JOINT, setting.file)}
    for world in worlds:
        name = Path(world.value).stem if is_file(world.value) else world.value
        if f"{ENV}.{name}.name" in layers:
            raise ConfigError(f"{ENV} names '{name}' twice{setting.place}; name each world once.")
        own = _world_layers(world, f"{ENV}.{name}.")
        if not name.isidentifier() or name in ("name", "size"):
            raise ConfigError(
                f"{world.value} cannot name a world of a joint run; name the file as in kitchen.yaml."
            )
        layers |= own
    return layers


def _world_layers(world: Setting, prefix: str) -> dict[str, Setting]:
    """A world's settings from its file, or nothing but its name."""
    if is_file(world.value):
        own = read_settings(Path(world.value).expanduser(), prefix)
        if f"{prefix}name" not in own:
            raise ConfigError(
                f"{world.value} does not say which world it is for; add a line as in name: modelnet."
            )
        return own
    _check_world(world)
    return {f"{prefix}name": world}


def _check_world(world: Setting) -> None:
    registry.worlds.check(str(world.value), world.place)


def _advice_in_files(layers: dict[str, Setting]) -> dict[str, Setting]:
    """Moves keys such as `train.gamma` out of files of worlds; if two worlds set one key, the first wins."""
    advice: dict[str, Setting] = {}
    for key in list(layers):
        found = re.fullmatch(rf"{ENV}\.(?:\w+\.)?((?:policy|train)\.[\w.]+)", key)
        if found:
            advice.setdefault(found[1], layers.pop(key))
    return advice


def _worlds_advice(layers: Mapping[str, Setting], members: Mapping[str, str]) -> dict[str, Setting]:
    """What worlds, and the trunk named, advise for other groups; of two who advise on one key the first wins.

    Advice for a part of the network does not hold for another part, where the layers name one.
    """
    named = layers.get(ENV_NAME)
    kinds = list(members.values()) or ([] if named is None else [str(named.value)])
    advice: dict[str, Setting] = {}
    for kind in kinds:
        for key, value in registry.worlds.get(kind).advice.items():
            advice.setdefault(key, Setting(value, f"the advice of the world {kind}"))
    # A world's settings have other keys in a joint run.
    advice = _trunks_advice(layers, None if members or not kinds else kinds[0]) | advice
    schema, chosen = Schema(RunConfig, {**advice, **layers}), {key.removesuffix(".kind") for key in layers}
    lost = [key for key in advice if key.rpartition(".")[0] in chosen and schema.find(key) is None]
    return {key: setting for key, setting in advice.items() if key not in lost}


def _trunks_advice(layers: Mapping[str, Setting], world: str | None) -> dict[str, Setting]:
    """What is advised with the trunk that the layers name, and for it in a world that is the only one."""
    named = layers.get("policy.trunk.kind") or layers.get("policy.trunk")
    if named is None or not registry.trunks.knows(str(named.value)):
        return {}
    trunk = str(named.value)
    advice = dict(getattr(registry.trunks.settings(trunk), "advice", {}))
    if world is not None:
        advice |= registry.worlds.get(world).advice_with.get(registry.trunks.family(trunk), {})
    settings = {}
    for key, value in advice.items():
        group = key.rpartition(".")[0]
        if not {group, f"{group}.preset"} & layers.keys():  # another row of rules is meant as it is
            settings[key] = Setting(value, f"the advice for the trunk {trunk}")
    return settings


def _members(layers: Mapping[str, Setting]) -> dict[str, str]:
    """The world that each name of a joint run stands for; nothing for a run of one world."""
    if ENV_NAME not in layers or layers[ENV_NAME].value != JOINT:
        if ENV_NAME in layers:
            _check_world(layers[ENV_NAME])
        return {}
    names = sections.members(JointSettings, f"{ENV}.", layers)
    worlds = {name: layers[f"{ENV}.{name}.name"] for name in names}
    for setting in worlds.values():
        _check_world(setting)
    return {name: str(setting.value) for name, setting in worlds.items()}


def _spread(
    keys: Mapping[str, Setting], members: Mapping[str, str], layers: Mapping[str, Setting]
) -> dict[str, Setting]:
    """In a joint run `env.size` is meant for every world that has it; `env.avd.size` is for one, and wins."""
    if not members:
        return dict(keys)
    schema = Schema(RunConfig, {**layers, **keys})
    shared: dict[str, Setting] = {}
    own: dict[str, Setting] = {}
    for key, setting in keys.items():
        inside = [f"{ENV}.{name}.{key.removeprefix(f'{ENV}.')}" for name in members]
        those = [one for one in inside if key.startswith(f"{ENV}.") and schema.find(one) and key != ENV_NAME]
        shared |= dict.fromkeys(those, setting)
        if not those:
            own[key] = setting
    return shared | own


def _build(layers: Mapping[str, Setting]) -> RunConfig:
    """Put the layers' values upon the schema's defaults, each converted by its field's type."""
    if ENV_NAME not in layers:
        # A misspelled `env` is the likelier mistake where there is a word that means nothing.
        one = next(iter(registry.worlds.names()))
        for key, setting in layers.items():
            top = key.partition(".")[0]
            if top not in RunConfig.model_fields:
                hint = did_you_mean(top, RunConfig.model_fields, f"add env={one}.")
                raise ConfigError(f"{key} is not a setting{setting.place}; {hint}")
        raise ConfigError(
            f"No world is named; add env={one} (there are {', '.join(registry.worlds.names())})."
        )
    members = _members(layers)
    schema = Schema(RunConfig, layers)
    try:
        config: RunConfig = schema.build()
    except KeyError as unknown:
        key = str(unknown.args[0])
        raise ConfigError(_unknown_key(key, layers[key].place, schema, layers, members)) from None
    return config


def _unknown_key(
    key: str, place: str, schema: Schema, layers: Mapping[str, Setting], members: Mapping[str, str]
) -> str:
    """What to say of a key that a run's settings do not have."""
    if key in RENAMED:
        return f"{key} is called {RENAMED[key]} now{place}."
    world = layers[ENV_NAME].value
    # Keys that hold for all members, and those of this package's other worlds, are worth a hint too.
    kinds = (*members.values(), *registry.worlds.own())
    alone = {kind: Schema(RunConfig, {ENV_NAME: Setting(kind)}) for kind in kinds}
    for other, its in alone.items() if key.startswith(f"{ENV}.") else ():
        if its.find(key) and other != world and other not in members.values():
            return f"{key} is a setting of the world {other}, and this run's world is {world}{place}."
    known = [name for one in (schema, *map(alone.get, members.values())) if one for name in one.names()]
    inside = [name for name in known if name.startswith(f"{key}.")]
    if inside:
        return f"{key} is a group of settings{place}; set one of {', '.join(inside)}."
    tops = {name.partition(".")[0] for name in known}
    # The right name in the wrong place, as in gamma=0.9 or env.gamma=0.9, is nearer than any other.
    meant = [name for name in known if name.rpartition(".")[2] == key.rpartition(".")[2]]
    hint = f"did you mean {meant[0]}?" if len(meant) == 1 else ""
    hint = hint or did_you_mean(key, [*known, *sorted(tops), EXPERIMENT], "--dry-run lists all there are.")
    return f"{key} is not a setting{place}; {hint}"
