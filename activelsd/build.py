"""Builds what settings describe: open worlds, a network's shape, actors, a device."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch

from activelsd.config import RunConfig
from activelsd.envs.cores import cores
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.joint import OpenWorld
from activelsd.envs.settings import WorldSettings
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError
from activelsd.features import with_features
from activelsd.policy.lsdnet import LSDNet, NetworkShape, make_trunk, sees_by_view
from activelsd.policy.settings import PolicySettings
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.actors.ga3c.stepper import Env
from activelsd.train.actors.interface import MakeActors
from activelsd.train.actors.ray.ray_actors import RayActors
from activelsd.train.actors.resident import on_recordings
from activelsd.train.parallel import started_together
from activelsd.train.settings import TrainSettings


def open_recordings(
    worlds: Mapping[str, WorldSettings], graph: Callable[[WorldSettings], ViewGraph] | None = None
) -> list[OpenWorld]:
    """Open worlds by name; `graph` opens the views of one, by default as the world itself does."""
    return [
        OpenWorld(name, graph(own) if graph else own.open(), own.rules.rules(), own.made_by())
        for name, own in worlds.items()
    ]


def add_features(
    worlds: Sequence[OpenWorld],
    settings: Mapping[str, WorldSettings],
    shape: NetworkShape,
    train: TrainSettings,
    *,
    device: str = "cpu",
    progress: Callable[[str], Any] | None = None,
) -> list[OpenWorld]:
    """The worlds with the features of the trunk, if it is frozen; computed now if they are not kept.

    Args:
        worlds: open.
        settings: of the worlds, by name.
        shape: of the network.
        train: how they are varied in training.
        device: to compute them on.
        progress: makes the callback of a progress line, given what is done.
    """
    if not sees_by_view(shape.trunk):  # it need not be made to know that it has no features
        return list(worlds)
    trunk = make_trunk(shape)
    return [
        world._replace(
            graph=with_features(
                world.graph,
                trunk,
                cache=settings[world.name].cache_folder,
                mirror=train.mirror,
                vary_crops=train.vary_crops and shape.crops,
                device=device,
                progress=progress,
            )
        )
        for world in worlds
    ]


def _reopened(
    settings: Mapping[str, WorldSettings], shape: NetworkShape, train: TrainSettings
) -> list[OpenWorld]:
    """Worlds with features, as a worker on any node opens them."""
    return add_features(open_recordings(settings), settings, shape, train)


def build_shape(settings: PolicySettings, *graphs: ViewGraph) -> NetworkShape:
    """The network's shape for graphs whose frames have one size and colour."""
    return NetworkShape(
        trunk=settings.trunk.kind,
        trunk_settings=settings.trunk.own(),
        memory=settings.memory.kind,
        memory_settings=settings.memory.own(),
        head=settings.head,
        size=graphs[0].size,
        frames=settings.frames,
        channels=graphs[0].channels,
        crops=any(graph.crops is not None for graph in graphs),
        certainty=settings.certainty,
    )


def build_actors(config: RunConfig, worlds: Sequence[OpenWorld], device: str) -> MakeActors:
    """A function that makes the actors for a config's worlds."""
    settings, frames = config.train, config.policy.frames
    if settings.actors == "resident":
        return on_recordings(worlds, settings, frames=frames, device=device)
    if settings.actors == "ray":
        return lambda network, seed: RayActors(
            partial(_reopened, config.worlds, network.shape, settings), worlds, network, settings, seed
        )
    ((name, graph, rules, backend),) = worlds
    own = config.worlds[name]

    def ga3c(network: LSDNet, seed: int) -> GA3CActors:
        world: EnvSpec | Callable[[], Env]
        local = settings.ga3c.kind == "threads"
        if local:
            world = lambda: ViewGraphEnv(graph, rules, frames=frames, backend=backend)  # noqa: E731
        else:
            options = own.model_dump(mode="json", exclude={"name"}) | {"world": own.name, "frames": frames}
            world = EnvSpec(id="activelsd.envs:activelsd/World-v0", kwargs=options, tree=tree_of(graph))
        return GA3CActors(
            world,
            network,
            settings.ga3c,
            settings.length,
            seed,
            vary_crops=settings.vary_crops,
            mirror=settings.mirror,
            dropout=settings.dropout,
            features=graph.features_shape if local else None,
        )

    return ga3c


def build_threads(config: RunConfig) -> int | None:
    """The number of PyTorch's threads; None leaves it to PyTorch.

    Under GA3C, predictors and learner compute at the same time beside the agents, and two of PyTorch's
    threads that want one core are far slower than one, so each of them gets its share of half the cores.
    Workers of a Ray cluster on this machine take a core each, and the learner gets the others.
    """
    own = config.train.ray
    if config.train.actors == "ray" and config.threads is None and own.address is None:
        return max(1, cores() - own.workers)
    if config.threads is not None or config.train.actors != "ga3c":
        return config.threads
    return max(1, cores() // (2 * (1 + config.train.ga3c.predictors)))


def build_device(name: str, threads: int | None) -> str:
    """The device that `auto`, `cpu` or `cuda` means here; also sets PyTorch's number of threads if given.

    Each process that `torchrun` started gets its own GPU.

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
