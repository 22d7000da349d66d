"""Local response normalisation against PyTorch's own: values, gradients, dtypes, layouts, checkpoints."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest
import torch
from torch import nn

from activelsd.policy.response_norm import LocalResponseNorm
from activelsd.policy.trunks import AlexNet

# With an alpha of 1 the neighbours matter; AlexNet's 1e-4 leaves little but a division by k ** beta.
STRONG = {"size": 5, "alpha": 1.0, "beta": 0.75, "k": 2.0}
FORMATS = [torch.contiguous_format, torch.channels_last]


def drawn(*shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0)).to(dtype)


@pytest.mark.parametrize("layout", FORMATS, ids=str)
@pytest.mark.parametrize(("channels", "size"), [(64, 5), (7, 3), (2, 5), (1, 1)])
def test_values_and_gradients_are_those_of_pytorch(
    channels: int, size: int, layout: torch.memory_format
) -> None:
    """Also with fewer channels than neighbours, where PyTorch still divides by their full number."""
    settings = STRONG | {"size": size}
    results = []
    for norm in (nn.LocalResponseNorm(**settings), LocalResponseNorm(channels, **settings)):  # type: ignore[arg-type]
        x = (3 * drawn(2, channels, 5, 4)).contiguous(memory_format=layout).requires_grad_()
        y = norm(x)
        y.backward(drawn(*y.shape))
        results.append((y.detach(), x.grad))
    torch.testing.assert_close(*results)


def test_the_gradient_is_that_of_finite_differences() -> None:
    norm = LocalResponseNorm(8, **STRONG).double()  # type: ignore[arg-type]
    assert torch.autograd.gradcheck(norm, drawn(2, 8, 3, 2, dtype=torch.float64).requires_grad_())


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("amp", [False, True])
def test_alexnet_stays_in_one_layout_and_one_dtype(channels: int, amp: bool) -> None:
    """Nothing is converted between its layers, in training either."""
    trunk = AlexNet(channels, 63)
    seen: list[torch.Tensor] = []

    def keep(layer: nn.Module, inputs: object, output: torch.Tensor) -> None:
        seen.append(output)
        output.register_hook(seen.append)

    for layer in trunk.convolutions:
        layer.register_forward_hook(keep)
    frames = torch.randint(0, 256, (2, channels, 63, 63), dtype=torch.uint8)
    with torch.autocast("cpu", torch.bfloat16, enabled=amp):
        features = trunk(frames)
    features.sum().backward()
    assert len(seen) == 2 * len(trunk.convolutions)
    assert {x.dtype for x in seen} == {torch.bfloat16 if amp else torch.float32}
    assert all(x.is_contiguous(memory_format=torch.channels_last) for x in seen)


def test_bfloat16_is_as_near_as_it_can_be() -> None:
    x = 3 * drawn(2, 64, 5, 4)
    exact = nn.LocalResponseNorm(**STRONG)(x.bfloat16().float())  # type: ignore[arg-type]
    found = LocalResponseNorm(64, **STRONG)(x.bfloat16())  # type: ignore[arg-type]
    assert found.dtype == torch.bfloat16
    torch.testing.assert_close(found.float(), exact, rtol=0.015, atol=1e-6)  # four roundings of 2 ** -8 / 2


def test_checkpoints_hold_nothing_of_it() -> None:
    """Those that were written with PyTorch's module still fit."""
    own = AlexNet(3, 63)
    before = AlexNet(3, 63)
    for i, layer in enumerate(before.convolutions):
        if isinstance(layer, LocalResponseNorm):
            before.convolutions[i] = nn.LocalResponseNorm(5, 1e-4, 0.75, 2.0)
    own.load_state_dict(before.state_dict())
    frames = torch.randint(0, 256, (2, 3, 63, 63), dtype=torch.uint8)
    torch.testing.assert_close(own(frames), before(frames))


COMPILED = """
import torch
from activelsd.policy.response_norm import LocalResponseNorm

norm, results = LocalResponseNorm(16, size=5, alpha=1.0, beta=0.75, k=2.0), []
for run in (norm, torch.compile(norm, fullgraph=True)):
    x = torch.randn(2, 16, 5, 4, generator=torch.Generator().manual_seed(0))
    x = x.contiguous(memory_format=torch.channels_last).requires_grad_()
    y = run(x)
    y.square().sum().backward()
    results.append((y.detach(), x.grad))
torch.testing.assert_close(*results)
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("c++") is None, reason="torch.compile needs a C++ compiler")
def test_a_compiled_one_does_the_same() -> None:
    # In a process of its own: the compiler fails where a test has imported Python's old distutils.
    subprocess.run([sys.executable, "-c", COMPILED], check=True)
