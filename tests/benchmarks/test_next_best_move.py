"""Next best move: when it goes on, and the table of the data set's paper."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from activelsd.envs.episode import EpisodeRules
from activelsd.envs.viewgraph import ViewGraph
from activelsd.evaluate.nextbest import NextBestMove
from activelsd.evaluate.players import Trained
from activelsd.policy.lsdnet import LSDNet
from tests.evaluate.test_walkers import ROOM, RULES, SMALL, played
from tests.evaluate.worlds import network


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    monkeypatch.delitem(sys.modules, "next_best_move", raising=False)
    import next_best_move

    return next_best_move


def with_bias(graph: ViewGraph, classes: float) -> LSDNet:
    """A network whose first class scores `classes` logits above the other, whatever it sees."""
    net = network(graph, "stack")
    with torch.no_grad():
        net.policy.weight.zero_()
        net.policy.bias.zero_()
        net.policy.bias[2] = classes
        net.policy.bias[4 + 4] = 1.0  # rotate_cw
    return net


def test_next_best_move_goes_on_until_it_is_sure(benchmark: ModuleType) -> None:
    again = replace(RULES, try_again=True)
    for player in (NextBestMove, benchmark.RandomMoves, benchmark.ForwardOnly):
        assert {row.views for row in played(player(with_bias(SMALL, 2.0)), SMALL, again)} == {24}  # 0.88
        assert {row.views for row in played(player(with_bias(SMALL, 2.5)), SMALL, again)} == {1}  # 0.92
    rows = played(NextBestMove(with_bias(SMALL, 0.0)), SMALL)
    assert rows[0].path[:3] == ("0_0_0", "0_0_30", "0_0_60")
    rows = played(benchmark.ForwardOnly(with_bias(SMALL, 0.0)), SMALL, again)
    assert rows[0].path == (*(f"0_{y}_0" for y in range(4)), *["0_3_0"] * 20)
    ways = [
        pair
        for row in played(benchmark.RandomMoves(with_bias(SMALL, 0.0)), SMALL)
        for pair in pairwise(row.path)
    ]
    assert len({(a.split("_")[2] == b.split("_")[2], a == b) for a, b in ways}) == 3


def test_the_table_counts_what_was_reached_after_so_many_moves(benchmark: ModuleType) -> None:
    rows = played(NextBestMove(network(ROOM, "stack")), rules=EpisodeRules(max_views=21))
    for moves, accuracy in zip((0, 3, 5, 10, 20), benchmark.after_moves(rows), strict=True):
        reached = [row.answers[min(moves, row.views - 1)] == row.label for row in rows]
        assert accuracy == pytest.approx(np.mean(reached))
    printed = benchmark.table({"next_best_move": rows}, "split 1")
    assert printed.splitlines()[1].split() == ["moves", "0", "3", "5", "10", "20"]
    assert printed.splitlines()[2].split()[0] == "next_best_move"


def test_recognising_is_what_an_episode_that_starts_there_answers(benchmark: ModuleType) -> None:
    net = network(ROOM, "stack")
    scores = benchmark.recognise(net, ROOM)
    rows = played(Trained(net))
    assert ROOM.pair_of is not None
    for row, view in zip(rows, ROOM.start_view, strict=True):
        pair = ROOM.pair_of[view, 0]
        if pair >= 0:
            assert scores.right[pair] == (row.answers[0] == row.label)
    assert 0.5 <= scores.score.min() < scores.score.max() <= 1
