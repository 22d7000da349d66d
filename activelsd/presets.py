"""Presets and other YAML files of settings: where they are, and what they set."""

from __future__ import annotations

from pathlib import Path

import yaml

from activelsd.errors import ConfigError, did_you_mean
from activelsd.sections import Setting, TextLoader, flatten


def presets_folder() -> Path:
    """Where presets are: inside an installed package, or at the top of a checkout."""
    package = Path(__file__).parent
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def groups() -> dict[str, list[str]]:
    """The presets of every group of settings that has some, `experiment` among them."""
    folders = sorted(path for path in presets_folder().iterdir() if path.is_dir())
    return {folder.name: sorted(file.stem for file in folder.glob("*.yaml")) for folder in folders}


def preset_file(group: str, setting: Setting) -> Path:
    """The file that `group=NAME` or `group=FILE.yaml` means.

    Raises:
        ConfigError: there is no preset of that name.
    """
    name, known = str(setting.value), groups()[group]
    if name in known:
        return presets_folder() / group / f"{name}.yaml"
    if is_file(name):
        return Path(name).expanduser()
    hint = did_you_mean(name, known)
    raise ConfigError(f"There is no {group} preset '{name}'{setting.place}; {hint}")


def is_file(name: str) -> bool:
    """Whether a word means a file of settings, by its ending."""
    return Path(name).suffix in (".yaml", ".yml")


def read_settings(file: Path, prefix: str = "") -> dict[str, Setting]:
    """A YAML file's settings by dotted key; its keys may be nested, dotted, or both.

    Raises:
        ConfigError: the file is missing, or is not YAML, or holds no settings.
    """
    try:
        content = yaml.load(file.read_text("utf-8"), TextLoader)
    except OSError as error:
        raise ConfigError(f"{file} cannot be read ({error.strerror}); name another file.") from None
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{file} is not YAML: {' '.join(str(error).split())}.") from None
    if content is not None and not isinstance(content, dict):
        raise ConfigError(f"{file} holds no settings; write one `key: value` a line.")
    return {prefix + key: Setting(value, file) for key, value in flatten(content or {})}
