"""Trains the run that a config describes: prepares its worlds, builds its parts and calls the trainer."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from activelsd.build import (
    add_features,
    build_actors,
    build_device,
    build_shape,
    build_threads,
    open_recordings,
)
from activelsd.compose import change, load
from activelsd.config import RunConfig
from activelsd.console import notice, progress
from activelsd.envs.graphenv import tree_of
from activelsd.envs.joint import OpenWorld, union
from activelsd.envs.settings import WorldSettings
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import ConfigError, RunError, UserError, some
from activelsd.evaluate.compare import measure
from activelsd.policy.checkpoint import load_network
from activelsd.policy.lsdnet import LSDNet
from activelsd.policy.transfer import narrow, transfer
from activelsd.sections import dump
from activelsd.train.parallel import ALONE, Group
from activelsd.train.run import CONFIG, Run, check_writable, find_checkpoint
from activelsd.train.trainer import Trainer
from activelsd.versions import check_parts

INIT = "init.json"
"""File in a run's folder that says which weights it took over from another run."""

ON_RESUME = ("train.steps", "device", "threads")
"""Settings that may be changed when a run is resumed, besides the world's paths."""


def open_graph(settings: WorldSettings) -> ViewGraph:
    """Open a world's views, with progress on the screen if they have to be prepared."""
    with progress("Preparing views") as show:
        return settings.open(show)


def open_worlds(config: RunConfig, group: Group = ALONE) -> list[OpenWorld]:
    """Open every world of a config; only the first process of a group prepares missing views."""
    if group.rank > 0:
        group.wait()
    worlds = open_recordings(config.worlds, open_graph)
    if group.rank == 0:
        group.wait()
    return worlds


def begin(config: RunConfig) -> Path:
    """Train a new run and return its folder.

    Raises:
        UserError: something of the config does not fit; no folder is left behind.
        KeyboardInterrupt: stopped; its text says how to go on.
    """
    device = _device(config)
    with Group.joined(device) as group:
        config.policy.trunk.check()  # first, as is the next, because opening worlds takes a while
        if config.policy.init is not None:
            find_checkpoint(config.policy.init)
        worlds = open_worlds(config, group)
        made = (
            Run.create(config.runs, config.title, dump(config), config.parts()).folder
            if group.rank == 0
            else ""
        )
        run = Run(Path(group.agreed(str(made))))
        try:
            return _train(config, run, worlds, device, group)
        except UserError:
            if group.rank == 0 and not _has_checkpoint(run):
                shutil.rmtree(run.folder)
            raise


def resume(folder: Path, words: Sequence[str]) -> Path:
    """Resume a run from its last checkpoint, or from the beginning if it has none, and return its folder."""
    run, config = Run(folder), resumed_config(folder, words)
    check_parts(folder)  # loss terms and loggers are looked up late, after the worlds' work
    check_writable(folder, "copy the run to a folder of your own to go on with it")
    device = _device(config)
    with Group.joined(device) as group:
        worlds = open_worlds(config, group)
        return _train(config, run, worlds, device, group)


def resumed_config(folder: Path, words: Sequence[str]) -> RunConfig:
    """A run's config with changes to the settings of `ON_RESUME`."""
    return change(load(Run(folder).folder / CONFIG), words, ON_RESUME, "a run goes on as it began")


def _device(config: RunConfig) -> str:
    device = build_device(config.device, build_threads(config))
    if config.train.cuda_graphs and device == "cpu":
        raise ConfigError(
            "train.cuda_graphs=true is for a GPU, and this run would be on a CPU; leave it out, or use a GPU."
        )
    return device


def _train(config: RunConfig, run: Run, worlds: Sequence[OpenWorld], device: str, group: Group) -> Path:
    stand_ins = [own.made_by() for own in config.worlds.values() if own.stands_in]
    if group.rank == 0:
        notice(f"Training {run.folder}" + "".join(f" on {backend}, a stand-in" for backend in stand_ins))
    resuming = _has_checkpoint(run)
    shape = build_shape(config.policy, *(world.graph for world in worlds))
    if group.rank > 0:
        group.wait()
    worlds = add_features(worlds, config.worlds, shape, config.train, device=device, progress=progress)
    if group.rank == 0:
        group.wait()
    watched = [world for world in worlds if (world.graph.start_split == SPLITS.index("val")).any()]

    def evaluate(network: LSDNet) -> dict[str, float]:
        return _look(network, watched, device, alone=len(worlds) == 1)

    try:
        trainer = Trainer(
            run,
            union([tree_of(world.graph) for world in worlds]),
            shape,
            config.train,
            build_actors(config, worlds, device),
            seed=config.seed,
            device=device,
            evaluate=evaluate if watched else None,
            resume=resuming,
            group=group,
        )
        if group.rank == 0 and dump(config) != run.config:  # only now it is known to fit
            run.config = dump(config)
        if config.policy.init is not None and not resuming:
            _start_from(find_checkpoint(config.policy.init), run, trainer.network, device, group)
        trainer.train()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"Stopped; go on with: activelsd train --resume {run.folder}") from None
    return run.folder


def _look(network: LSDNet, worlds: Sequence[OpenWorld], device: str, *, alone: bool) -> dict[str, float]:
    """Measure a network in every world; with several worlds, names of figures begin with the world's."""
    figures: dict[str, float] = {}
    for name, graph, rules, backend in worlds:
        own = narrow(network, tree_of(graph))
        found = measure(own, graph, rules, split="val", world=name, backend=backend, device=device)
        figures |= found if alone else {f"{name}/{figure}": value for figure, value in found.items()}
    return figures


def _start_from(checkpoint: Path, run: Run, network: LSDNet, device: str, group: Group) -> None:
    """Copy the weights of a checkpoint that a fresh network can use, and report which they are."""
    state, rows = transfer(load_network(checkpoint, device), network)
    network.load_state_dict(state)
    if group.rank > 0:
        return
    (run.folder / INIT).write_text(
        json.dumps({"from": str(checkpoint), **rows._asdict()}, indent=1) + "\n", "utf-8"
    )
    notice(
        f"Started from {checkpoint}: kept trunk, memory, value and {len(rows.kept)} of "
        f"{len(rows.kept) + len(rows.fresh)} rows of the head ({some(rows.kept) or 'none'}); "
        f"surroundings {rows.around}; see {INIT}."
    )


def _has_checkpoint(run: Run) -> bool:
    try:
        return run.checkpoint.is_dir()
    except RunError:
        return False
