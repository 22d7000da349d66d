"""Local response normalisation across channels, in few passes over memory and with a gradient of its own."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx


class LocalResponseNorm(nn.Module):
    """`nn.LocalResponseNorm` for channels-last input: x / d ** beta, d = k + alpha * mean of n channels' x².

    The mean over the n channels around each one, with zeros beyond the first and the last, is a product with
    a band matrix, which is one fast kernel on every device. PyTorch's own module pools in three dimensions,
    and leaves bfloat16 under autocast; this one stays in its input's dtype and sums in float32. It has no
    parameters, and nothing of it is stored.
    """

    band: Tensor  # (C, C), alpha / n where two channels are neighbours, else 0

    def __init__(
        self, channels: int, size: int, alpha: float = 1e-4, beta: float = 0.75, k: float = 1.0
    ) -> None:
        """Make it for C channels, of which n = `size`, an odd number, are neighbours."""
        super().__init__()
        self.beta, self.k = beta, k
        reach = size // 2
        band = torch.full((channels, channels), alpha / size).triu(-reach).tril(reach)
        self.register_buffer("band", band, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) to the same shape, dtype and, where it is channels last, layout."""
        with torch.autocast(x.device.type, enabled=False):
            rows = x.permute(0, 2, 3, 1)
            found: Tensor = _Normalise.apply(rows, self.band.to(x.dtype), self.beta, self.k)  # type: ignore[no-untyped-call]
            return found.permute(0, 3, 1, 2)


class _Normalise(torch.autograd.Function):
    """x d^-beta with d = k + x² band, over the last axis."""

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, band: Tensor, beta: float, k: float) -> Tensor:
        d = x.square().matmul(band).add_(k)
        ctx.save_for_backward(x, d, band)
        ctx.beta = beta  # type: ignore[attr-defined]
        return x * d.pow(-beta)

    @staticmethod
    def backward(ctx: FunctionCtx, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        """The gradient g to g d^-beta - 2 beta x ((g x d^(-beta - 1)) band); the band is symmetric."""
        x, d, band = ctx.saved_tensors  # type: ignore[attr-defined]
        beta = ctx.beta  # type: ignore[attr-defined]
        direct = gradient * d.pow(-beta)
        through = (direct * x).div_(d).matmul(band)
        return direct.addcmul_(x, through, value=-2 * beta), None, None, None
