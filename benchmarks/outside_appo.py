"""Sample Factory's APPO in one of our worlds, as a contestant of the throughput benchmark.

It is set up like `outside_a2c`, in serial mode: workers and learner take turns in this process, so that steps
per CPU-second are comparable. Its usual processes would distribute the work over more cores.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import torch
from rates import Step
from sample_factory.algo.runners.runner_serial import SerialRunner
from sample_factory.algo.utils.context import global_model_factory
from sample_factory.cfg.arguments import parse_full_cfg, parse_sf_args
from sample_factory.envs.env_utils import register_env
from sample_factory.model.encoder import Encoder
from sample_factory.utils.utils import log
from torch import Tensor

from activelsd.envs.graphenv import ViewGraphEnv
from activelsd.policy.lsdnet import NetworkShape
from activelsd.policy.trunks import Compact
from activelsd.train.settings import TrainSettings


class Features(Encoder):  # type: ignore[misc]
    """Concatenates this project's trunk features and the target boxes."""

    def __init__(self, config: Any, space: Any, *, shape: NetworkShape) -> None:
        super().__init__(config)
        trunk = Compact(shape.frames, shape.size)
        self.trunk = trunk.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.width = trunk.features + 5 * shape.frames

    def get_out_size(self) -> int:
        """Number of features that `forward` returns."""
        return self.width

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """Features from frames (N, K, S, S) in 0 to 255 and boxes (N, K, 5)."""
        frames = observation["frames"].to(torch.uint8)
        return torch.cat([self.trunk(frames), observation["target"].flatten(1)], 1)


def _env(
    make: Callable[[], ViewGraphEnv], name: str, config: Any, place: Any, render_mode: str | None = None
) -> ViewGraphEnv:
    """Makes an environment, with the arguments that Sample Factory passes."""
    return make()


@contextmanager
def appo(
    make: Callable[[], ViewGraphEnv], shape: NetworkShape, settings: TrainSettings, device: str = "cpu"
) -> Iterator[Step]:
    """Gives a function that runs one APPO update; another process also calls `make`, to read the spaces."""
    log.setLevel(logging.ERROR)
    register_env("world", partial(_env, make))
    global_model_factory().register_encoder_factory(partial(Features, shape=shape))
    words = {
        "env": "world",
        "experiment": "throughput",
        "train_dir": tempfile.mkdtemp(),
        "device": "gpu" if device == "cuda" else device,
        "serial_mode": True,
        "async_rl": False,
        "num_workers": 1,
        "num_envs_per_worker": settings.envs,
        "worker_num_splits": 1,
        "rollout": settings.length,
        "batch_size": settings.envs * settings.length,
        "num_batches_per_epoch": 1,
        "num_epochs": 1,
        "use_rnn": False,
        "recurrence": 1,
        "normalize_input": False,
        "policy_initialization": "torch_default",  # orthogonal does not support channels-last weights
        "train_for_env_steps": 10**12,
        "save_every_sec": 10**9,
        "use_env_info_cache": False,
    }
    given = [f"--{name}={value}" for name, value in words.items()] + ["--decoder_mlp_layers"]
    runner = SerialRunner(parse_full_cfg(parse_sf_args(given)[0], given))
    runner.init()
    runner.event_loop.start.emit()

    def step() -> int:
        before = sum(runner.env_steps.values())
        while sum(runner.env_steps.values()) == before:
            runner.event_loop.process_events()
        return int(sum(runner.env_steps.values()) - before)

    yield step
    for writer in runner.writers.values():
        writer.close()
