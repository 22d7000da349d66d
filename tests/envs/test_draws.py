"""Draws of episodes: the published generator, alike in NumPy and PyTorch, even and independent."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from activelsd.envs.draws import draw, draw_key

WORD = (1 << 64) - 1


def slow(key: int, count: int, n: int) -> int:
    """splitmix64's finaliser in Python's unbounded integers."""
    z = (key + count) * 0x9E3779B97F4A7C15 & WORD
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & WORD
    z = (z ^ (z >> 27)) * 0x94D049BB133111EB & WORD
    return ((z ^ (z >> 31)) >> 2) % n


@settings(max_examples=200)
@given(st.integers(0, 2**62 - 1), st.integers(0, 2**40), st.integers(1, 10**7))
def test_numpy_and_torch_draw_what_the_formula_says(key: int, count: int, n: int) -> None:
    expected = slow(key, count, n)
    assert draw(np.array([key]), np.array([count]), n).tolist() == [expected]
    assert draw(torch.tensor([key]), torch.tensor([count]), n).tolist() == [expected]


def test_draws_are_even_over_counts_and_over_keys() -> None:
    n, many = 12, 24_000
    counts = np.arange(many)
    keys = np.random.default_rng(0).integers(0, 2**62, many)
    for drawn in (draw(np.full(many, 123), counts, n), draw(keys, np.zeros(many, np.int64), n)):
        observed = np.bincount(drawn, minlength=n)
        # 11 degrees of freedom: 31.3 is the 99.9th percentile of chi squared.
        assert ((observed - many / n) ** 2 / (many / n)).sum() < 31.3


def test_streams_of_different_keys_and_successive_draws_are_independent() -> None:
    n, many = 1000, 20_000
    counts = np.arange(many)
    generators = [np.random.default_rng(seed) for seed in (0, 1)]
    one, other = (draw(np.full(many, draw_key(g)), counts, n).astype(float) for g in generators)
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.03
    assert abs(np.corrcoef(one[:-1], one[1:])[0, 1]) < 0.03
    assert (one == other).mean() < 0.005


def test_keys_come_from_the_generator_and_stay_positive() -> None:
    keys = [draw_key(np.random.default_rng(seed)) for seed in range(50)]
    assert keys == [draw_key(np.random.default_rng(seed)) for seed in range(50)]
    assert len(set(keys)) == 50
    assert all(0 <= key < 2**62 for key in keys)
