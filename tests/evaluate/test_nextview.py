"""Players that choose their next view by voxels."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from activelsd import cli, launch
from activelsd.compose import resolve
from activelsd.console import progress
from activelsd.envs.graphenv import tree_of
from activelsd.envs.modelnet.settings import DatasetSettings, ModelNetSettings
from activelsd.errors import ConfigError
from activelsd.evaluate.compare import Entrant, compare
from activelsd.evaluate.nextview import (
    Completions,
    ExpectedEntropy,
    MostUnseen,
    NextView,
    entropies,
    expected_entropies,
    probabilities,
)
from activelsd.evaluate.protocol import Insider, Recognising, episodes_of, play
from activelsd.evaluate.recognisers.objects import Objects
from activelsd.evaluate.recognisers.rows import make_recogniser
from activelsd.evaluate.recognisers.shapenets import ShapeNets
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.scenery.voxels import SIDE, SURFACE, UNSEEN, VoxelCameras

WORLD = ModelNetSettings(
    size=32, dataset=DatasetSettings(classes=("bench", "cup", "vase"), train_per_class=4, test_per_class=2)
)
SHAPE = NetworkShape(size=32, trunk_settings={"features": 8})


@pytest.fixture(scope="module")
def net() -> ShapeNets:
    """Never sure, as it is not trained."""
    objects = Objects(graph=WORLD.open(), world=WORLD, shape=SHAPE)
    made = make_recogniser("shapenets", objects, 0, progress=progress)
    assert isinstance(made, ShapeNets)
    return made.eval()


def ready(kind: type[NextView], net: ShapeNets) -> NextView:
    graph = net.objects.graph
    player = kind(LSDNet(tree_of(graph), SHAPE), graph)
    assert isinstance(player, Insider)
    assert isinstance(player, Recognising)
    player.take(net)
    return player


def test_with_the_truth_as_completion_the_expected_entropy_is_met(
    net: ShapeNets, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At every camera from every start, also if the truth is one of several completions that are alike."""
    train = net.objects.of("train")
    known = Completions(net)
    for number in (0, 5):
        views = net.objects.views[train[number]]
        for start in (0, 7):
            grid = net.states(views[start].view(1, 1))
            cameras = net.camera_of[views]
            for copies in (1, 3):
                objects = torch.full((len(views), copies), number)
                weights = torch.full((len(views), copies), 1 / copies)
                grids = grid.expand(len(views), -1)
                expected = expected_entropies(net, grids, known.states(objects, cameras), weights)
                pairs = torch.stack([views[start].expand(len(views)), views], 1)
                met = entropies(probabilities(net, net.states(pairs)))
                torch.testing.assert_close(expected, met, rtol=1e-5, atol=1e-6)


def test_expected_entropy_is_the_weighted_mean_over_the_completions(net: ShapeNets) -> None:
    known, grids = Completions(net), net.states(net.objects.views[:2, :1])
    cameras, objects = torch.tensor([4, 9]), torch.tensor([[0, 3, 7], [8, 2, 1]])
    weights = torch.tensor([[0.5, 0.3, 0.2], [0.1, 0.8, 0.1]])
    found = expected_entropies(net, grids, known.states(objects, cameras), weights)
    for row in range(2):
        total = 0.0
        for completion in range(3):
            target = net.objects.of("train")[objects[row, completion]]
            view = next(v for v in net.objects.views[target] if net.camera_of[v] == cameras[row])
            after = grids[row].maximum(net.states(view.view(1, 1))[0])
            p = net.classify(after[None]).detach().softmax(-1)[0].double()
            total += float(weights[row, completion] * -(p * p.log()).sum())
        assert float(found[row]) == pytest.approx(total, rel=1e-4)


def test_a_training_object_is_its_own_nearest_completion(net: ShapeNets) -> None:
    known, train = Completions(net), net.objects.of("train")
    objects, weights = known.nearest(net.states(net.objects.views[train]))
    assert objects[:, 0].tolist() == list(range(len(train)))
    torch.testing.assert_close(weights.sum(1), torch.ones(len(train)))
    assert (weights.diff(dim=1) <= 0).all(), "the more it disagrees, the less it counts"


def test_disagreement_is_counted_as_written(net: ShapeNets) -> None:
    """Against a slow count over every second voxel."""
    known, train = Completions(net), net.objects.of("train")
    grid = net.states(net.objects.views[train[2]][:1].view(1, 1))
    whole = net.states(net.objects.views[train]).view(-1, SIDE, SIDE, SIDE)[:, ::2, ::2, ::2].flatten(1)
    part = grid.view(SIDE, SIDE, SIDE)[::2, ::2, ::2].flatten()
    seen = part != UNSEEN
    apart = torch.stack([((one == SURFACE) != (part == SURFACE))[seen].float().mean() for one in whole])
    objects, weights = known.nearest(grid)
    assert sorted(apart[objects[0]].tolist()) == pytest.approx(sorted(apart.tolist())[: objects.shape[1]])
    torch.testing.assert_close(weights[0], (-apart[objects[0]] / 0.01).softmax(-1))


def test_unseen_voxels_come_into_sight_unless_the_surface_hides_them() -> None:
    """A wall across the middle, everything else unseen: from either side the half beyond it is hidden."""
    cameras = VoxelCameras(np.array([(0.0, 0.0), (180.0, 0.0), (90.0, 0.0)]), 24)
    states = torch.full((SIDE, SIDE, SIDE), UNSEEN, dtype=torch.uint8)
    states[SIDE // 2] = SURFACE  # x is the first axis
    front, back, side = cameras.unseen_in_sight(states.view(1, -1).expand(3, -1), torch.arange(3)).tolist()
    assert 0.3 < front / back < 3
    assert side > 1.5 * max(front, back)
    states[SIDE // 2 + 1 :] = 1
    front, back = cameras.unseen_in_sight(states.view(1, -1).expand(2, -1), torch.arange(2)).tolist()
    assert front < 0.05 * back


@pytest.mark.parametrize("kind", [ExpectedEntropy, MostUnseen])
def test_they_visit_each_view_once_and_batches_change_nothing(kind: type[NextView], net: ShapeNets) -> None:
    graph = net.objects.graph
    episodes = episodes_of(graph, "test")[::5]
    rules = WORLD.rules.rules()
    played = [
        play(ready(kind, net), graph, rules, episodes, world="modelnet", backend="modelnet", batch=batch)
        for batch in (3, 64)
    ]
    assert played[0] == played[1]
    for row in played[0]:
        assert len(set(row.path)) == len(row.path) == row.views
    assert max(row.views for row in played[0]) == 12, "a net that is never sure sees all there is"


def test_a_sure_net_answers_at_once(net: ShapeNets, monkeypatch: pytest.MonkeyPatch) -> None:
    def sure(grids: Tensor) -> Tensor:
        return torch.tensor([0.0, 30.0, 0.0]).expand(len(grids), -1)

    monkeypatch.setattr(net, "classify", sure)
    graph = net.objects.graph
    rows = play(
        ready(MostUnseen, net),
        graph,
        WORLD.rules.rules(),
        episodes_of(graph, "test"),
        world="modelnet",
        backend="modelnet",
    )
    assert {(row.views, row.answer) for row in rows} == {(1, "cup")}


def test_without_its_recogniser_a_player_is_refused(net: ShapeNets) -> None:
    graph = net.objects.graph
    rules = replace(WORLD.rules.rules(), max_views=3)
    entrant = Entrant(
        name="run", network=LSDNet(tree_of(graph), SHAPE), graph=graph, rules=rules, world="m", backend="m"
    )
    with pytest.raises(ConfigError, match=r"^Player 'most_unseen' needs the recogniser 'shapenets'; train"):
        compare([entrant], ["most_unseen"])


def test_compare_trains_the_recogniser_that_a_player_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "env.dataset.classes=[cup,vase]",
        "env.dataset.train_per_class=3",
        "env.dataset.test_per_class=1",
    ]
    small = ["env.size=32", "policy.trunk.features=8", "train.steps=100", "train.envs=4", "threads=1"]
    run = launch.begin(resolve(["env=modelnet", *words, *small, f"runs={tmp_path}"]))
    asked = ["--baselines", "expected_entropy,most_unseen", "evaluate.epochs=1"]
    assert cli.main(["compare", str(run), *asked, "evaluate.episodes_per_object=2"]) == 0
    assert "shapenets" in capsys.readouterr().out
    read = json.loads((run / "comparison.json").read_text())
    assert {row["name"] for row in read["recognisers"]} == {"shapenets"}
    assert [one["name"] for one in read["players"]] == ["trained", "expected_entropy", "most_unseen"]
