"""From sections of settings to what they describe: a world's views, its rules, a network's shape."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any, NamedTuple

import torch

from activelsd.config import (
    AVDSettings,
    ModelNetSettings,
    PolicySettings,
    RulesSettings,
    RunConfig,
    THORSettings,
    World,
)
from activelsd.envs.avd.env import SAMPLE, avd_graph, backend_of
from activelsd.envs.avd.scan import MOVES
from activelsd.envs.cores import cores
from activelsd.envs.episode import PRESETS, EpisodeRules
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.envs.modelnet.env import modelnet_graph
from activelsd.envs.modelnet.orbit import ORBIT_MOVES, ring_table
from activelsd.envs.thor.env import thor_graph
from activelsd.envs.thor.lattice import MOVES as THOR_MOVES
from activelsd.envs.thor.simulators import STANDIN
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.scenery.shapes import CATEGORIES
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.actors.ga3c.stepper import Env
from activelsd.train.actors.interface import MakeActors
from activelsd.train.actors.ray.ray_actors import RayActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.parallel import started_together

Progress = Callable[[int, int], None]
"""Called with what is done and what there is in all."""


class WorldKind(NamedTuple):
    """What the command line knows of a world, beside its settings."""

    environment: str  # Gymnasium's id
    moves: Sequence[str]
    datasets: str
    graph: Callable[[Any, Progress | None], ViewGraph]  # from its settings
    backend: Callable[[Any], str]  # what makes the pictures, from its settings
    options: Callable[[Any], dict[str, Any]]  # the environment's keyword arguments, from its settings
    simulated: bool = False  # its views are recorded from a simulator


def _modelnet_options(settings: ModelNetSettings) -> dict[str, Any]:
    """The world as its environment's keyword arguments, in values that JSON holds."""
    dataset = settings.dataset
    return {
        "path": None if dataset.path is None else str(dataset.path),
        "split": dataset.split,
        "train_per_class": dataset.train_per_class,
        "test_per_class": dataset.test_per_class,
        "dataset_seed": dataset.seed,
        "classes": dataset.classes,
        "size": settings.size,
        "elevations": settings.elevations,
        "navigate": settings.navigate,
        "cache": None if settings.cache is None else str(settings.cache),
    }


def _modelnet_graph(settings: ModelNetSettings, progress: Progress | None) -> ViewGraph:
    # A misspelled move is to be heard of before minutes of rendering.
    ring_table(settings.navigate, len(settings.elevations))
    return modelnet_graph(**_modelnet_options(settings), progress=progress)


def _avd_options(settings: AVDSettings) -> dict[str, Any]:
    """As `_modelnet_options`."""
    dataset, starts = settings.dataset, settings.starts
    return {
        "path": None if dataset.path is None else str(dataset.path),
        "split": dataset.split,
        "train": dataset.train,
        "test": dataset.test,
        "scans": dataset.scans,
        "width": dataset.width,
        "height": dataset.height,
        "seed": dataset.seed,
        "task": settings.task,
        "size": settings.size,
        "navigate": settings.navigate,
        "visible": starts.visible,
        "max_difficulty": starts.max_difficulty,
        "shown_well": starts.shown_well,
        "min_size": starts.min_size,
        "max_size": starts.max_size,
        "per_target": starts.per_target,
        "scores": None if starts.scores is None else str(starts.scores),
        "threshold": starts.threshold,
        "cache": None if settings.cache is None else str(settings.cache),
    }


def _avd_graph(settings: AVDSettings, progress: Progress | None) -> ViewGraph:
    return avd_graph(**_avd_options(settings), progress=progress)


def _thor_options(settings: THORSettings) -> dict[str, Any]:
    """As `_modelnet_options`."""
    other = {"name", "live", "episodes_per_scene", "scenes", "starts", "rules"}
    options = settings.model_dump(mode="json", exclude=other)
    return options | settings.scenes.model_dump() | settings.starts.model_dump()


def _thor_graph(settings: THORSettings, progress: Progress | None) -> ViewGraph:
    return thor_graph(**_thor_options(settings), progress=progress)


WORLDS: dict[str, WorldKind] = {
    "modelnet": WorldKind(
        environment="activelsd/ModelNet-v0",
        moves=tuple(ORBIT_MOVES),
        datasets=f"embedded shapes ({len(CATEGORIES)} classes), or meshes or views at env.dataset.path",
        graph=_modelnet_graph,
        backend=lambda settings: "modelnet",
        options=_modelnet_options,
    ),
    "avd": WorldKind(
        environment="activelsd/AVD-v0",
        moves=MOVES,
        datasets="sample scans (rendered rooms), or scans of the Active Vision Dataset at env.dataset.path",
        graph=_avd_graph,
        backend=lambda settings: backend_of(settings.dataset.path),
        options=_avd_options,
    ),
    "thor": WorldKind(
        environment="activelsd/THOR-v0",
        moves=THOR_MOVES,
        datasets="rooms of AI2-THOR, or of its stand-in by env.backend=standin",
        graph=_thor_graph,
        backend=lambda settings: settings.backend,
        options=lambda settings: (
            _thor_options(settings)
            | {"live": settings.live, "episodes_per_scene": settings.episodes_per_scene}
        ),
        simulated=True,
    ),
}
"""Every world, by the name its settings have."""

STAND_INS = frozenset({SAMPLE, STANDIN})
"""Backends that make pictures in the place of what a world is named after."""


def build_graph(settings: World, progress: Progress | None = None) -> ViewGraph:
    """A world's views, prepared now where the cache does not have them."""
    return WORLDS[settings.name].graph(settings, progress)


def build_backend(settings: World) -> str:
    """What makes a world's pictures; a stand-in has a name of its own."""
    return WORLDS[settings.name].backend(settings)


def open_recordings(
    worlds: Mapping[str, World], graph: Callable[[World], ViewGraph] = build_graph
) -> list[OpenWorld]:
    """Worlds by their names, to play; `graph` opens the views of each, from this machine's cache."""
    return [
        OpenWorld(name, graph(own), build_rules(own.rules), build_backend(own))
        for name, own in worlds.items()
    ]


def build_rules(settings: RulesSettings) -> EpisodeRules:
    """The preset's rules with what the settings change of them."""
    changes = settings.model_dump(exclude={"preset"}, exclude_none=True)
    return replace(PRESETS[settings.preset], **changes)


def build_shape(settings: PolicySettings, *graphs: ViewGraph) -> NetworkShape:
    """The network's shape for the pictures of a graph, or of several of one size."""
    return NetworkShape(
        trunk=settings.trunk,
        memory=settings.memory,
        head=settings.head,
        size=graphs[0].size,
        frames=settings.frames,
        crops=any(graph.crops is not None for graph in graphs),
        features=settings.features,
    )


def build_actors(config: RunConfig, worlds: Sequence[OpenWorld], device: str) -> MakeActors:
    """Who plays the training episodes of a config's worlds."""
    settings, frames = config.train, config.policy.frames
    if settings.actors == "resident":
        return on_recordings(worlds, settings, frames=frames, device=device)
    if settings.actors == "ray":
        reopen = partial(open_recordings, config.worlds)
        return lambda network, seed: RayActors(reopen, worlds, network, settings, seed)
    ((name, graph, rules, backend),) = worlds
    own = config.worlds[name]

    def ga3c(network: LSDNet, seed: int) -> GA3CActors:
        world: EnvSpec | Callable[[], Env]
        if settings.ga3c.kind == "threads":
            world = lambda: ViewGraphEnv(graph, rules, frames=frames, backend=backend)  # noqa: E731
        else:
            kind = WORLDS[own.name]
            options = kind.options(own) | {"rules": asdict(rules), "frames": frames}
            world = EnvSpec(id=f"activelsd.envs:{kind.environment}", kwargs=options, tree=tree_of(graph))
        return GA3CActors(
            world,
            network,
            settings.ga3c,
            settings.length,
            seed,
            vary_crops=settings.vary_crops,
            mirror=settings.mirror,
            dropout=settings.dropout,
        )

    return ga3c


def build_threads(config: RunConfig) -> int | None:
    """PyTorch's threads: the number asked for; None for PyTorch's own choice.

    Under GA3C, predictors and learner compute at the same time beside the agents, and two of PyTorch's
    threads that want one core are far slower than one, so each of them gets its share of half the cores.
    Workers of a Ray cluster that is this machine take a core each, and the learner has what is left.
    """
    own = config.train.ray
    if config.train.actors == "ray" and config.threads is None and own.address is None:
        return max(1, cores() - own.workers)
    if config.threads is not None or config.train.actors != "ga3c":
        return config.threads
    return max(1, cores() // (2 * (1 + config.train.ga3c.predictors)))


def build_device(name: str, threads: int | None) -> str:
    """The device that `auto`, `cpu` or `cuda` means here; sets PyTorch's threads where a number is given.

    Of processes that `torchrun` started each has a GPU of its own.

    Raises:
        ConfigError: CUDA is asked for and there is none.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device=cuda needs a GPU that PyTorch can use, and there is none; set device=cpu.")
    if name == "cpu" or not torch.cuda.is_available():
        return "cpu"
    return f"cuda:{os.environ['LOCAL_RANK']}" if started_together() else "cuda"
