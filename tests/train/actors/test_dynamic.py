"""The walk finds what is fastest, and agents, predictors and trainers come and go while training runs."""

from __future__ import annotations

import threading
import time

import numpy as np

from activelsd.policy.heads import Epsilon
from activelsd.train.actors.ga3c.dynamic import ThreadCounts, Walk, neighbour
from tests.train.actors.worlds import actors


def test_neighbours_stay_within_bounds_and_reach_every_direction() -> None:
    generator, most = np.random.default_rng(0), ThreadCounts(3, 2, 1)
    seen = {neighbour(ThreadCounts(1, 1, 1), most, generator) for _ in range(200)}
    assert seen == {ThreadCounts(a, p, 1) for a in (1, 2) for p in (1, 2)}


def test_walk_climbs_to_the_fastest_and_stays_near() -> None:
    fastest = ThreadCounts(9, 3, 2)

    def rate(counts: ThreadCounts) -> float:
        return 100.0 - sum((n - m) ** 2 for n, m in zip(counts, fastest, strict=True))

    walk = Walk(ThreadCounts(2, 1, 1), ThreadCounts(16, 4, 4), seed=0)
    counts = walk.best
    for _ in range(300):
        counts = walk.turn(rate(counts))
    assert walk.best == fastest
    assert rate(counts) >= 97


def test_walk_leaves_a_best_that_has_become_slow() -> None:
    walk = Walk(ThreadCounts(4, 1, 1), ThreadCounts(8, 1, 1), seed=0)
    counts = walk.best
    for turn in range(400):
        counts = walk.turn(10.0 - abs(counts.agents - (7 if turn < 200 else 2)))
        if turn == 199:
            assert walk.best.agents == 7
    assert walk.best.agents == 2


def test_counts_change_while_training_runs_and_all_end() -> None:
    threads = threading.active_count()
    crew = actors(agents=3, predictors=2, dynamic=True, dynamic_every_s=0.02)
    seen, deadline = set(), time.monotonic() + 60
    try:
        while len(seen) < 3:
            assert time.monotonic() < deadline
            rollout = crew.collect(Epsilon(0.3, 0.3))
            ended = rollout.terminated | rollout.truncated
            assert bool((rollout.first[1:] == ended[:-1]).all())
            seen.add(len(crew._predictor_state.agents))
    finally:
        crew.close()
    assert threading.active_count() == threads
