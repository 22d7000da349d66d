"""Draws the next episode with a counter-based generator that single, vector and GPU environments share.

The k-th draw of an environment with key `x` is `splitmix64(x + k)`. The counter is the only state, so B
environments draw together by array arithmetic on the device, with the same results as B single ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

    Words = TypeVar("Words", NDArray[np.int64], torch.Tensor)

_GOLDEN, _MIX1, _MIX2 = (
    int(np.uint64(x).astype(np.int64)) for x in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)


def draw_key(generator: np.random.Generator) -> int:
    """An environment's key, drawn from its own generator."""
    return int(generator.integers(2**62))


def draw(key: Words, count: Words, n: int) -> Words:
    """Draw number `count` of the stream `key`, in 0..n-1; int64 arrays or tensors of the same shape.

    splitmix64 (Steele, Lea and Flood 2014) on int64, which overflows the same way in NumPy and PyTorch.
    """
    with np.errstate(over="ignore"):
        z = (key + count) * _GOLDEN
        z = (z ^ _shift(z, 30)) * _MIX1
        z = (z ^ _shift(z, 27)) * _MIX2
        return _shift(z ^ _shift(z, 31), 2) % n


def _shift(z: Words, bits: int) -> Words:
    """Logical right shift of signed words."""
    return (z >> bits) & ((1 << (64 - bits)) - 1)
