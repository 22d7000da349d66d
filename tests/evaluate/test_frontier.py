"""Traces against games with that stop, thresholds against all there are, and curves by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from activelsd import registry
from activelsd.errors import ConfigError, DataError
from activelsd.evaluate.compare import Entrant, compare
from activelsd.evaluate.equal_views import EqualViews
from activelsd.evaluate.frontier import at_means, frontier, stop_at, thresholds
from activelsd.evaluate.players import Trained, make_player
from activelsd.evaluate.protocol import episodes_of, play
from activelsd.evaluate.traces import Trace, trace
from tests.evaluate.test_schedules import RULES, circle
from tests.evaluate.worlds import network

GRAPH = circle()
NET = network(GRAPH)
ENTRANT = Entrant(name="trained", network=NET, graph=GRAPH, rules=RULES, world="rings", backend="random")
HOW: dict[str, Any] = {"per_object": None, "seed": 0, "device": "cpu"}


def trained(name: str) -> Trained:
    player = make_player(name, NET, GRAPH, 0)
    assert isinstance(player, Trained)
    return player


@pytest.mark.parametrize("moves", ["learned", "random", "spread", "sweep"])
@pytest.mark.parametrize("revisit", [True, False])
def test_a_trace_tells_how_a_game_with_any_threshold_ends(moves: str, revisit: bool) -> None:
    rules, episodes = replace(RULES, revisit=revisit), episodes_of(GRAPH, "test")
    stops = {name: registry.stops.get(name)(NET) for name in ("learned", "confidence")}
    seen = trace(trained(f"{moves}+learned"), stops, GRAPH, rules, episodes, batch=5)
    took = set[int]()
    for stop in stops:
        for chosen in ([0.4], [0.9, 0.6, 0.8, 0.5], [0.0]):
            other = trained(f"{moves}+{stop}")
            other.stop.thresholds = torch.tensor(chosen)
            rows = play(other, GRAPH, rules, episodes, world="rings", backend="random")
            every = [chosen[min(n, len(chosen) - 1)] for n in range(rules.max_views)]
            views = stop_at(seen, stop, np.array(every, np.float32).astype(np.float64))
            assert views.tolist() == [row.views for row in rows]
            assert seen.right[np.arange(len(rows)), views - 1].tolist() == [row.right for row in rows]
            took |= set(views.tolist())
    assert len(took) > 3


def made_up(right: list[list[int]], scores: list[list[float]], length: list[int] | None = None) -> Trace:
    n, most = np.array(right).shape
    return Trace(
        right=np.array(right, bool),
        length=np.array(length or [most] * n),
        objects=np.arange(n),
        scores={"confidence": np.array(scores, np.float32)},
        by_view=frozenset({"confidence"}),
    )


def earned(seen: Trace, chosen: NDArray[np.float64], price: float) -> float:
    views = stop_at(seen, "confidence", chosen)
    right = seen.right[np.arange(len(views)), views - 1]
    return float(right.sum() - price * (views - 1).sum())


def test_with_two_views_no_threshold_earns_more() -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        n = int(rng.integers(1, 12))
        scores = rng.choice([0.1, 0.3, 0.5, 0.7], (n, 2))
        length = rng.integers(1, 3, n)
        seen = made_up(rng.integers(0, 2, (n, 2)).tolist(), scores.tolist(), length.tolist())
        for price in (0.0, 0.1, 0.6):
            best = max(earned(seen, np.array([t, np.inf]), price) for t in (0.0, 0.2, 0.4, 0.6, 0.8))
            assert earned(seen, thresholds(seen, "confidence", price), price) == pytest.approx(best)


def test_later_thresholds_are_known_when_an_earlier_one_is_chosen() -> None:
    """The second view alone helps nobody; the third, which follows it, makes all right."""
    seen = made_up([[0, 0, 1]] * 3, [[0.5, 0.5, 0.5]] * 3)
    assert stop_at(seen, "confidence", thresholds(seen, "confidence", 0.4)).tolist() == [3, 3, 3]
    assert stop_at(seen, "confidence", thresholds(seen, "confidence", 0.6)).tolist() == [1, 1, 1]


def test_accuracy_at_a_mean_between_two_choices_is_between_theirs() -> None:
    """Of four episodes the surer two are right at once; the others need both views."""
    seen = made_up([[1, 1], [1, 1], [0, 1], [0, 1]], [[0.9, 0.9], [0.8, 0.8], [0.3, 0.9], [0.2, 0.9]])
    right = at_means("confidence", seen, seen, (1.0, 1.25, 1.5, 2.0))
    assert right.mean(0).tolist() == pytest.approx([0.5, 0.75, 1.0, 1.0])
    both = dict.fromkeys(("a", "b"), ("confidence", seen, seen))
    curves = frontier(both, seed=0, means=(1.5, 2)).curves
    assert [one.area.mean for one in curves] == [1.0, 1.0]
    assert curves[1].difference is not None
    assert {tuple(one) for one in curves[1].difference} == {(0.0, 0.0, 0.0)}


def test_all_are_measured_at_the_same_means_against_the_first() -> None:
    names = ["no_move", "random_walk", "spread+confidence", "confidence"]
    found = EqualViews([ENTRANT], names, **HOW).frontier("test")
    assert [one.name for one in found.curves] == ["trained", *names[1:]], "no_move takes no stop"
    assert found.means == (1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
    first, *others = found.curves
    assert first.difference is None
    for one in others:
        assert one.difference is not None
        for own, reference, apart in zip(one.accuracy, first.accuracy, one.difference, strict=True):
            assert apart.mean == pytest.approx(own.mean - reference.mean)
            assert apart.low <= apart.mean <= apart.high


def test_stops_are_set_for_a_mean_on_validation_objects() -> None:
    names = ["no_move", "spread+confidence"]
    chosen = EqualViews([ENTRANT], names, **HOW).thresholds(3.0)
    assert chosen.keys() == {"trained", "spread+confidence"}
    for split, apart in (("val", 0.5), ("test", 1.5)):
        found = compare([ENTRANT], names, split=split, thresholds=chosen)
        views = {one.name: one.views.mean for one in found.players}
        assert views.pop("no_move") == 1.0
        assert all(abs(mean - 3.0) < apart for mean in views.values())


class TwoViews(Trained):
    """Decides by itself when to answer, without a stop."""

    def act(self, observation: Mapping[str, Tensor], mask: Tensor, first: Tensor) -> Tensor:
        self.look(observation, mask, first)
        self.count = torch.where(first, 1, getattr(self, "count", 0) + 1)
        return torch.where(self.count >= 2, self.name_class(), self.random_move(mask))


class Surely(Trained):
    """Has a stop of its own."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.stop = registry.stops.get("confidence")(self.network)


def test_players_of_others_keep_their_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.players, "_added", {"two": TwoViews, "surely": Surely})
    found = EqualViews([ENTRANT], ["two", "surely", "confidence"], **HOW).frontier("test")
    curves = {one.name: one.accuracy for one in found.curves}
    assert curves["surely"] == curves["confidence"]
    assert "two" not in curves, "it asks no stop"
    with pytest.raises(
        ConfigError, match=r"^two decides by itself when to answer; write two in place of two\+"
    ):
        make_player("two+confidence", NET, GRAPH, 0)


def test_what_cannot_be_compared_is_one_sentence() -> None:
    still = replace(ENTRANT, rules=replace(RULES, can_move=False))
    with pytest.raises(
        ConfigError, match=r"^trained sees 1\.00 views at most on average, too few for --front"
    ):
        EqualViews([still], [], **HOW).frontier("test")
    with pytest.raises(ConfigError, match=r"^--views 9 is more than the 8 views that an episode may have"):
        EqualViews([ENTRANT], [], **HOW).thresholds(9.0)
    no_val = replace(GRAPH, start_split=np.where(GRAPH.start_split == 1, 0, GRAPH.start_split))
    with pytest.raises(
        DataError, match=r"chosen on val objects, and rings has none; leave out --frontier and"
    ):
        EqualViews([replace(ENTRANT, graph=no_val)], [], **HOW).frontier("test")
