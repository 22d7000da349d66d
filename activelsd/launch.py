"""From a run's config to a trained run: worlds prepared, parts built, the trainer called."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from activelsd.build import (
    build_actors,
    build_device,
    build_graph,
    build_rules,
    build_shape,
    build_threads,
)
from activelsd.compose import change, load
from activelsd.config import RunConfig, dump
from activelsd.console import notice, progress
from activelsd.envs.graphenv import tree_of
from activelsd.envs.viewgraph import SPLITS, ViewGraph
from activelsd.errors import RunError, UserError
from activelsd.evaluate.compare import measure
from activelsd.policy.lsdnet import LSDNet
from activelsd.train.run import CONFIG, Run
from activelsd.train.trainer import Trainer

ON_RESUME = ("train.steps", "device", "threads")
"""What may be changed of a run that goes on."""


def open_graph(config: RunConfig) -> ViewGraph:
    """The world's views of a config, prepared with progress on the screen where they have to be."""
    with progress("Rendering objects") as show:
        return build_graph(config.env, show)


def begin(config: RunConfig) -> Path:
    """Train a new run; its folder.

    Raises:
        UserError: something of the config does not fit; no folder is left behind.
        KeyboardInterrupt: stopped; its text says how to go on.
    """
    device, graph = build_device(config.device, build_threads(config)), open_graph(config)
    run = Run.create(config.runs, config.name or config.env.name, dump(config))
    try:
        return _train(config, run, graph, device)
    except UserError:
        if not _has_checkpoint(run):
            shutil.rmtree(run.folder)
        raise


def resume(folder: Path, words: Sequence[str]) -> Path:
    """Go on with a run from its last checkpoint, or from its beginning where it has none yet; its folder."""
    run, config = Run(folder), resumed_config(folder, words)
    device, graph = build_device(config.device, build_threads(config)), open_graph(config)
    if words:
        temporary = folder / f"{CONFIG}.tmp"
        temporary.write_text(dump(config))
        temporary.replace(folder / CONFIG)
    return _train(config, run, graph, device)


def resumed_config(folder: Path, words: Sequence[str]) -> RunConfig:
    """A run's own config with the few things changed that may be."""
    return change(load(Run(folder).folder / CONFIG), words, ON_RESUME, "a run goes on as it began")


def _train(config: RunConfig, run: Run, graph: ViewGraph, device: str) -> Path:
    notice(f"Training {run.folder}")
    rules = build_rules(config.env.rules)

    def evaluate(network: LSDNet) -> dict[str, float]:
        world = config.env.name
        return measure(network, graph, rules, split="val", world=world, backend=world, device=device)

    has_val = bool((graph.start_split == SPLITS.index("val")).any())
    try:
        trainer = Trainer(
            run,
            tree_of(graph),
            build_shape(config.policy, graph),
            config.train,
            build_actors(config, graph, device),
            seed=config.seed,
            device=device,
            evaluate=evaluate if has_val else None,
            resume=_has_checkpoint(run),
        )
        trainer.train()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"Stopped; go on with: activelsd train --resume {run.folder}") from None
    return run.folder


def _has_checkpoint(run: Run) -> bool:
    try:
        return run.checkpoint.is_dir()
    except RunError:
        return False
