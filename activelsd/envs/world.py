"""Worlds as Gymnasium makes them: by name, with their settings as keywords."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from activelsd import registry
from activelsd.envs.base import ActiveVisionEnv
from activelsd.envs.settings import WorldSettings, plain
from activelsd.errors import ConfigError, did_you_mean
from activelsd.sections import Schema, Setting, flatten

if TYPE_CHECKING:
    from activelsd.envs.vector import ViewGraphVectorEnv


def make(
    world: str = "",
    *,
    subset: str = "train",
    frames: int = 1,
    render_mode: str | None = None,
    **settings: Any,
) -> ActiveVisionEnv:
    """A single environment of a world.

    Args:
        world: its name.
        subset: `train`, `val` or `test`.
        frames: K, how many views are stacked.
        render_mode: `rgb_array` or None.
        **settings: see `world_settings`.
    """
    return world_settings(world, settings).env(split=subset, frames=frames, render_mode=render_mode)


def make_vector(
    world: str = "", *, num_envs: int, subset: str = "train", frames: int = 1, **settings: Any
) -> ViewGraphVectorEnv:
    """B environments on a world's recorded views, advanced together. See `make` for the arguments."""
    # A process that plays a single environment need not wait for PyTorch.
    from activelsd.envs.vector import ViewGraphVectorEnv

    own = world_settings(world, settings)
    return ViewGraphVectorEnv(
        own.open(),
        own.rules.rules(),
        num_envs=num_envs,
        split=subset,
        frames=frames,
        backend=own.made_by(),
    )


def world_settings(world: str, keywords: Mapping[str, Any]) -> WorldSettings:
    """A world's settings from keywords, upon the same defaults as the command line's.

    Args:
        world: its name.
        keywords: settings by name, those of a group as a dict, as in `dataset={"path": …}`. A setting of a
            group may also stand by itself if no other setting has its name, as in `path=…`.

    Raises:
        ConfigError: the world, a setting or a value is not one there is.
    """
    model: type[WorldSettings] = registry.worlds.get(world)
    given = {key: plain(value) for key, value in keywords.items()}
    whole = Schema(model, {})
    layers = {_whole_key(key, whole): Setting(value) for key, value in flatten({**given, "name": world})}
    settings: WorldSettings = Schema(model, layers).build()
    return settings


def _whole_key(key: str, schema: Schema) -> str:
    """The dotted key of a setting that may be named without its group."""
    if schema.find(key) is not None:
        return key
    inside = [name for name in schema.fields if name.endswith(f".{key}")]
    if len(inside) == 1:
        return inside[0]
    if key in schema.groups:
        raise ConfigError(f"{key} is a group of settings; give it as a dict, as in {key}={{…}}.")
    leaves = [name.rpartition(".")[2] for name in schema.fields]
    hint = did_you_mean(key, inside or [*schema.fields, *leaves])
    raise ConfigError(f"{key} is not a setting of this world; {hint}")
