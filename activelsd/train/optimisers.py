"""The optimisers by name, among them RMSProp as TensorFlow 1 has it, which GA3C and so the paper used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from activelsd.train.settings import TrainSettings

DECAY = 0.99
"""Share of the mean square that RMSProp keeps in an update; A3C's, GA3C's and PyTorch's."""

Groups = list[dict[str, Any]]
"""Parameters and their settings, as PyTorch's optimisers take them."""


class TFRMSprop(torch.optim.Optimizer):
    """RMSProp as TensorFlow 1 computes it (`tf.train.RMSPropOptimizer`, no momentum).

    The running mean square m begins at 1, and epsilon is added to it inside the root:

        m <- decay m + (1 - decay) g^2,    parameter <- parameter - lr g / sqrt(m + epsilon).

    PyTorch's begins at 0 and adds epsilon to the root. With epsilon = 0.1 and small gradients this one is
    nearly gradient descent with the rate lr / sqrt(epsilon).

    GA3C makes an update for every trajectory. If one gradient is the sum over n trajectories, m decays as it
    does in n updates, and the square of the sum over n stands for the mean of their squares, which it is if
    their gradients are independent. Nothing waits for the device.

    Attributes:
        trajectories: n, over how many trajectories the next step's gradient is a sum; a number or a tensor.
    """

    def __init__(self, groups: Groups, lr: float | Tensor, eps: float, decay: float = DECAY) -> None:
        """Build from parameter groups; `lr` may be a scalar tensor in a group, as CUDA graphs need."""
        super().__init__(groups, {"lr": lr, "eps": eps, "decay": decay})
        self.trajectories: float | Tensor = 1.0

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """Update the parameters that have gradients; a closure is not called."""
        n = self.trajectories
        for group in self.param_groups:
            parameters = [one for one in group["params"] if one.grad is not None]
            if not parameters:
                continue
            gradients = [one.grad for one in parameters]
            squares = [self._mean_square(one) for one in parameters]
            kept = group["decay"] ** n
            torch._foreach_mul_(squares, kept)
            fresh = torch._foreach_mul(gradients, gradients)
            torch._foreach_mul_(fresh, (1.0 - kept) / n)
            torch._foreach_add_(squares, fresh)
            steps = torch._foreach_add(squares, group["eps"])
            torch._foreach_rsqrt_(steps)
            torch._foreach_mul_(steps, gradients)
            torch._foreach_mul_(steps, group["lr"])
            torch._foreach_sub_(parameters, steps)

    def _mean_square(self, parameter: Tensor) -> Tensor:
        slot = self.state[parameter]
        if not slot:
            slot["mean_square"] = torch.ones_like(parameter)
        square: Tensor = slot["mean_square"]
        return square


def make_optimiser(groups: Groups, settings: TrainSettings, device: torch.device) -> torch.optim.Optimizer:
    """The optimiser that the settings name, for parameters on a device."""
    capturable = device.type == "cuda"  # a CUDA graph needs steps to be counted on the device
    rate, eps = settings.learning_rate, settings.optimiser_epsilon
    if settings.optimiser == "tf_rmsprop":
        return TFRMSprop(groups, rate, eps)
    if settings.optimiser == "rmsprop":
        return torch.optim.RMSprop(groups, lr=rate, alpha=DECAY, eps=eps, capturable=capturable)
    # Fused, Adam takes a seventh of the time on a CPU. It takes slots to lie in memory as their weights do.
    fused = True if device.type == "cpu" else None
    return torch.optim.Adam(groups, lr=rate, eps=eps, capturable=capturable, fused=fused)
