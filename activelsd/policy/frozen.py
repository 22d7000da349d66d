"""Runs a net that is never trained: on a CPU by onnxruntime, twice as fast as PyTorch, else by PyTorch."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from activelsd.errors import ConfigError


class FrozenNet:
    """A net that stays as it is; it is built, and then exported for onnxruntime, when it is first used.

    It is no module: `train()`, `state_dict()` and optimisers do not reach it, and a process that finds all
    features recorded never builds it.
    """

    def __init__(self, build: Callable[[], nn.Module]) -> None:
        self._build = build
        self._runs: dict[torch.device, Callable[[Tensor], Tensor]] = {}

    @torch.no_grad()
    @torch.compiler.disable  # type: ignore[untyped-decorator, unused-ignore]
    def __call__(self, pictures: Tensor) -> Tensor:
        """Float (N, 3, I, I), normalised, to float (N, F) on the same device."""
        if pictures.device not in self._runs:
            self._runs[pictures.device] = self._runner(pictures)
        # Under autocast features would depend on who asks for them.
        with torch.autocast(pictures.device.type, enabled=False):
            return self._runs[pictures.device](pictures)

    def _runner(self, pictures: Tensor) -> Callable[[Tensor], Tensor]:
        net = self._build().eval().requires_grad_(False)
        if pictures.is_cpu:
            return _exported(net, pictures[:1])
        net.to(pictures.device)
        return net.to(memory_format=torch.channels_last)  # type: ignore[no-any-return, call-overload]


def _exported(net: nn.Module, example: Tensor) -> Callable[[Tensor], Tensor]:
    """The net as onnxruntime runs it, on as many threads as PyTorch has."""
    try:
        import onnxruntime  # type: ignore[import-untyped, unused-ignore]
        import onnxscript  # noqa: F401  torch.onnx needs it
    except ImportError as error:
        raise ConfigError(
            f"Pretrained trunks need {error.name} on a CPU, which is not installed; install it with:"
            " pip install 'activelsd[timm]'"
        ) from None
    model = io.BytesIO()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own parts
        batch = {0: torch.export.Dim.DYNAMIC}
        torch.onnx.export(
            net,
            (example.repeat(2, 1, 1, 1),),
            cast("Any", model),  # its types do not know that it takes streams
            dynamo=True,
            dynamic_shapes=(batch,),
            verbose=False,
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    session: Any = onnxruntime.InferenceSession(model.getvalue(), options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name

    def run(pictures: Tensor) -> Tensor:
        return torch.from_numpy(session.run(None, {name: np.ascontiguousarray(pictures.numpy())})[0])

    return run
