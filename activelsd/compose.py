"""From words to a config: schema defaults < presets < `experiment=` < `key=value`, the last one wins.

The weakest preset is what a world's own says of other groups: what learns best there.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, get_args, get_origin

import yaml
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from activelsd.config import JOINT, RunConfig, defaults, dump, settings, worlds
from activelsd.errors import ConfigError, did_you_mean
from activelsd.presets import Setting, TextLoader, flatten, groups, preset_file, read_settings
from activelsd.wording import refused_value, unknown_key

EXPERIMENT, ENV, ENV_NAME = "experiment", "env", "env.name"


def resolve(words: Sequence[str], schema: type[RunConfig] = RunConfig) -> RunConfig:
    """Compose a config from `group=preset`, `experiment=NAME or FILE` and `key=value` words.

    An experiment's file says what the command line would: presets of groups by name, and keys. A preset on
    the command line takes the place of the one that the experiment names for that group. `env` may list
    presets of several worlds, for one network that plays them all.

    Raises:
        ConfigError: a group, preset, key or value is not one there is.
    """
    known = groups()
    presets: dict[str, Setting] = {}
    keys: dict[str, Setting] = {}
    for key, setting in map(_split_word, words):
        (presets if key in known else keys)[key] = setting

    written: dict[str, Setting] = {}
    if EXPERIMENT in presets:
        file = preset_file(EXPERIMENT, presets.pop(EXPERIMENT))
        for key, setting in read_settings(file).items():
            if key in known:
                presets.setdefault(key, setting)
            else:
                written[key] = setting
        written.setdefault("name", Setting(file.stem, file))

    layers: dict[str, Setting] = {}
    for group, setting in presets.items():
        several = _listed(setting) if group == ENV else []
        if len(several) > 1:
            layers |= _joint_layers(several)
        else:
            layers |= read_settings(preset_file(group, *several or [setting]), prefix=f"{group}.")
    layers = _advice(layers, known) | layers
    members = _members(layers | written | keys, schema)
    return _validate(layers | _spread(written, members, schema) | _spread(keys, members, schema), schema)


def sweep(
    words: Sequence[str], sweeps: Sequence[str], schema: type[RunConfig] = RunConfig
) -> list[RunConfig]:
    """A config per combination of `key=a,b,c` sweeps, named after its values; without any, just one."""
    axes = []
    for key, setting in map(_split_word, sweeps):
        values = re.split(r",(?![^\[]*\])", setting.value)  # commas inside brackets stay
        axes.append([f"{key}={value}" for value in values])
    configs = []
    for combination in product(*axes):
        config = resolve([*words, *combination], schema)
        if combination:
            tails = (re.sub(r"[^\w.+-]+", "-", word.rpartition(".")[2]).strip("-") for word in combination)
            name = "-".join([config.title, *tails])
            config = config.model_copy(update={"name": name})
        configs.append(config)
    return configs


def load(file: Path, schema: type[RunConfig] = RunConfig) -> RunConfig:
    """Read a resolved config, as `dump` writes it.

    Raises:
        ConfigError: the file is missing or does not fit the schema.
    """
    return _validate(read_settings(file), schema)


def change(config: RunConfig, words: Sequence[str], allowed: Collection[str], why: str) -> RunConfig:
    """A copy of a run's config with `key=value` words applied.

    Args:
        config: the config of a run there is.
        words: what to change.
        allowed: keys, or sections, that may be changed.
        why: the reason that others may not, for the sentence of the error.

    Raises:
        ConfigError: a key or value is not one there is, or the key may not be changed.
    """
    now = flatten(yaml.load(dump(config), TextLoader))
    keys = dict(map(_split_word, words))
    layers, schema = {key: Setting(value, None) for key, value in now}, type(config)
    changed = _validate(layers | _spread(keys, _members(layers, schema), schema), schema)
    for key in keys:
        if not any(key == name or key.startswith(f"{name}.") for name in allowed):
            raise ConfigError(f"{key} cannot be changed here, {why}; what can: {', '.join(allowed)}.")
    return changed


def _split_word(word: str) -> tuple[str, Setting]:
    key, equals, text = word.partition("=")
    if not equals or not key:
        raise ConfigError(f"'{word}' is not a setting; write key=value, as in env=modelnet or seed=1.")
    return key, Setting(text, None)


def _listed(setting: Setting) -> list[Setting]:
    """The presets of `env=modelnet,avd`, which a file may write as a list."""
    listed = setting.value
    if not isinstance(listed, list):
        text = str(listed)
        listed = text.removeprefix("[").removesuffix("]").split(",") if "," in text else [text]
    return [Setting(str(name).strip(), setting.file) for name in listed]


def _joint_layers(presets: Sequence[Setting]) -> dict[str, Setting]:
    """The settings of several worlds, each below the name of its preset."""
    layers = {f"{ENV}.name": Setting(JOINT, presets[0].file)}
    for setting in presets:
        file = preset_file(ENV, setting)
        world = read_settings(file, prefix=f"{ENV}.{file.stem}.")
        if f"{ENV}.{file.stem}.name" in layers:
            raise ConfigError(
                f"{ENV} names '{file.stem}' twice{setting.place}; give each world its own preset."
            )
        if not file.stem.isidentifier() or file.stem in ("name", "size"):
            raise ConfigError(f"{file} cannot name a world of a joint run; name the file as in kitchen.yaml.")
        if f"{ENV}.{file.stem}.name" not in world:
            raise ConfigError(f"{file} does not say which world it is for; add a line as in name: modelnet.")
        layers |= world
    return layers


def _advice(layers: dict[str, Setting], known: Collection[str]) -> dict[str, Setting]:
    """What worlds' presets say of other groups, taken out of the layers; of several the first counts."""
    advice: dict[str, Setting] = {}
    for key in list(layers):
        found = re.fullmatch(rf"{ENV}\.(?:\w+\.)?(({'|'.join(known)})\.[\w.]+)", key)
        if found and found[2] != ENV:
            advice.setdefault(found[1], layers.pop(key))
    return advice


def _members(layers: Mapping[str, Setting], schema: type[RunConfig]) -> dict[str, str]:
    """Which world each name of a joint run stands for; nothing for a run of one world."""
    if ENV_NAME not in layers or layers[ENV_NAME].value != JOINT:
        return {}
    found = ((re.fullmatch(rf"{ENV}\.(\w+)\.name", key), setting) for key, setting in layers.items())
    return {match[1]: _world(setting, schema) for match, setting in found if match}


def _world(setting: Setting, schema: type[RunConfig]) -> str:
    name, by_world = str(setting.value), worlds(schema)
    if name not in by_world:
        raise ConfigError(f"There is no world '{name}'{setting.place}; {did_you_mean(name, by_world)}")
    return name


def _spread(
    keys: Mapping[str, Setting], members: Mapping[str, str], schema: type[RunConfig]
) -> dict[str, Setting]:
    """In a joint run `env.size` is meant for every world that has it; `env.avd.size` is for one, and wins."""
    known = {name: settings(worlds(schema)[world], world, f"{ENV}.") for name, world in members.items()}
    shared: dict[str, Setting] = {}
    own: dict[str, Setting] = {}
    for key, setting in keys.items():
        those = [name for name in known if key in known[name] and key != ENV_NAME]
        shared |= {f"{ENV}.{name}.{key.removeprefix(f'{ENV}.')}": setting for name in those}
        if not those:
            own[key] = setting
    return shared | own


def _validate(layers: Mapping[str, Setting], schema: type[RunConfig]) -> RunConfig:
    """Put the layers' values upon the schema's defaults, each converted by its field's type."""
    by_world = worlds(schema)
    if ENV_NAME not in layers:
        # A misspelled `env` is the likelier mistake where there is a word that means nothing.
        for key, setting in layers.items():
            top = key.partition(".")[0]
            if top not in schema.model_fields:
                hint = did_you_mean(top, schema.model_fields, f"add env={next(iter(by_world))}.")
                raise ConfigError(f"{key} is not a setting{setting.place}; {hint}")
        one = next(iter(by_world))
        raise ConfigError(f"No world is named; add env={one} (there are {', '.join(by_world)}).")
    members = _members(layers, schema)
    world = JOINT if members else _world(layers[ENV_NAME], schema)

    known, tree = settings(schema, world), defaults(schema, world)
    for name, kind in members.items():
        known |= settings(by_world[kind], kind, f"{ENV}.{name}.")
        tree[ENV][name] = defaults(by_world[kind], kind)
    for written, setting in layers.items():
        # A group that has kinds may be set to one by its own name: env.dataset=sample.
        key = written if f"{written}.kind" not in known else f"{written}.kind"
        if key not in known:
            for kind in members.values():  # what may be said to all worlds at once is worth a hint too
                known |= settings(by_world[kind], kind, f"{ENV}.")
            elsewhere = {other: settings(schema, other) for other in by_world if other != world}
            raise ConfigError(unknown_key(key, setting.place, world, known, elsewhere))
        *sections, leaf = key.split(".")
        node = tree
        for name in sections:
            node = node[name]
        node[leaf] = _typed(setting, known[key])
    try:
        return schema.model_validate(tree)
    except ValidationError as refused:
        error = refused.errors()[0]
    parts = [part for part in error["loc"] if isinstance(part, str)]
    # Where there is a union of worlds, pydantic names the one it tried.
    if parts[:2] == [ENV, world]:
        del parts[1]
    if len(parts) > 2 and members.get(parts[1]) == parts[2]:
        del parts[2]
    key = ".".join(parts)
    if key not in known:  # a rule between settings, worded by the schema
        raise ConfigError(f"{error['msg'].removeprefix('Value error, ')}.")
    setting = layers.get(key, Setting(error["input"], None))
    raise ConfigError(refused_value(key, setting.value, setting.place, known[key], error))


def _typed(setting: Setting, field: FieldInfo) -> Any:
    """What a text means to a field, beyond what the schema converts by itself."""
    text, kinds = setting.value, get_args(field.annotation) or (field.annotation,)
    if not isinstance(text, str):
        return text
    if setting.file is None and text in ("null", "~"):
        return None
    if setting.file is None and any(
        (get_origin(kind) or kind) in (list, tuple) for kind in (field.annotation, *kinds)
    ):
        # On the command line a list may leave out its brackets: env.navigate=orbit_cw,orbit_ccw.
        try:
            return yaml.load(text if text.startswith("[") else f"[{text}]", TextLoader)
        except yaml.YAMLError:
            return text
    if int in kinds and re.fullmatch(r"\d+(\.\d+)?[eE]\+?\d+", text) and float(text).is_integer():
        return int(float(text))  # 2e6 is a whole number to everyone but int()
    return text
