"""Recognisers: what they see, that they learn, and that what they learned is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from activelsd import registry
from activelsd.console import progress
from activelsd.envs.modelnet.settings import DatasetSettings, ModelNetSettings
from activelsd.envs.viewgraph import ViewGraph
from activelsd.errors import ConfigError, DataError
from activelsd.evaluate.recognisers import fitting
from activelsd.evaluate.recognisers.deeppano import STRIDE, DeepPano
from activelsd.evaluate.recognisers.interface import Recogniser
from activelsd.evaluate.recognisers.kept import trained
from activelsd.evaluate.recognisers.mvcnn import MVCNN, MVCNNSettings
from activelsd.evaluate.recognisers.objects import Objects, draw_sets
from activelsd.evaluate.recognisers.rows import NO_MOVEMENT, make_recogniser, recognise
from activelsd.evaluate.recognisers.shapenets import ShapeNets
from activelsd.policy.lsdnet import NetworkShape
from activelsd.testing import check_recogniser
from tests.graphs import ring_graph, room_graph

TINY = ModelNetSettings(
    size=32, dataset=DatasetSettings(classes=("cup", "vase"), train_per_class=3, test_per_class=2)
)
SHAPE = NetworkShape(size=16, trunk_settings={"features": 64})


def objects_of(graph: ViewGraph) -> Objects:
    return Objects(graph=graph, world=TINY, shape=SHAPE)


def mvcnn(objects: Objects, **settings: float) -> MVCNN:
    torch.manual_seed(0)
    return MVCNN(objects, MVCNNSettings.model_validate({"updates": 0, **settings}))


@pytest.mark.parametrize("name", registry.recognisers.own())
def test_every_recogniser_conforms(name: str) -> None:
    check_recogniser(name, TINY)


def test_objects_know_their_views_classes_and_splits() -> None:
    """Also if the views of scenes are mixed, and objects have different numbers of them."""
    rng = np.random.default_rng(0)
    scene_of = rng.permutation(np.repeat(np.arange(3), (2, 5, 3))).astype(np.int32)
    whole = ring_graph(objects=3, classes=3)
    own = [np.flatnonzero(scene_of == scene) for scene in (2, 0, 1)]  # of targets 0, 1 and 2
    graph = replace(
        whole,
        frames=whole.frames[:10],
        scene_of=scene_of,
        start_view=np.array([views[0] for views in own], np.int32),
        start_target=np.arange(3, dtype=np.int32),
        start_split=np.array([2, 0, 1], np.uint8),
    )
    objects = objects_of(graph)
    assert [sorted(row[row >= 0].tolist()) for row in objects.views] == [views.tolist() for views in own]
    assert [objects.of(split).tolist() for split in ("train", "val", "test")] == [[1], [2], [0]]


@given(sizes=st.lists(st.integers(1, 6), min_size=1, max_size=8), count=st.none() | st.integers(0, 7))
def test_a_set_has_different_views_of_its_object_and_as_many_as_asked_for(
    sizes: list[int], count: int | None
) -> None:
    views = torch.full((len(sizes), 6), -1)
    for row, size in enumerate(sizes):
        views[row, :size] = 10 * row + torch.arange(size)
    drawn = draw_sets(views, torch.Generator().manual_seed(len(sizes)), count)
    for own, of, size in zip(drawn.tolist(), views.tolist(), sizes, strict=True):
        seen = [view for view in own if view >= 0]
        assert own == seen + [-1] * (6 - len(seen))
        assert len(set(seen)) == len(seen)
        assert set(seen) <= set(of)
        assert 1 <= len(seen) <= size if count is None else len(seen) == min(count, size)


def test_sizes_of_sets_are_uniform() -> None:
    drawn = draw_sets(torch.arange(6).repeat(12000, 1), torch.Generator().manual_seed(0))
    counts = torch.bincount((drawn >= 0).sum(1), minlength=7)[1:]
    assert (counts - 2000).abs().max() < 200, "five standard deviations"


def test_mvcnn_takes_the_maximum_over_the_views_of_a_set() -> None:
    objects = objects_of(ring_graph(objects=6, classes=2))
    net = mvcnn(objects).eval()
    views = torch.tensor([[3, 7, 1, -1], [12, -1, -1, -1]])
    logits = net(torch.tensor([0, 1]), views)
    for row, chosen in zip(logits, ([1, 3, 7], [12]), strict=True):
        pictures = torch.from_numpy(objects.graph.frames[chosen])[:, None]
        expected = net.head(torch.stack([net._trunk(one[None])[0] for one in pictures]).amax(0))
        torch.testing.assert_close(row, expected, rtol=1e-4, atol=1e-5)


def test_mvcnn_learns_from_pictures_and_from_features() -> None:
    """With several views it names what one of them does not show."""
    graph = ring_graph(objects=96, classes=4, telling=range(0, 12, 2))
    objects = objects_of(graph)
    net = mvcnn(objects, epochs=20, batch=8, rate=3e-3, dropout=0.0)
    net.fit(seed=0)
    test = objects.of("test")
    every, one = (draw_sets(objects.views[test], torch.Generator().manual_seed(0), n) for n in (12, 1))
    right = [
        (net.probabilities(test, s).argmax(-1) == objects.labels[test]).float().mean() for s in (every, one)
    ]
    assert right[0] == 1.0
    assert right[1] < 0.8

    features = np.random.default_rng(0).normal(size=(len(graph.frames) + 1, 8)).astype(np.float16)
    features[:-1, :4] = 4 * np.eye(4, dtype=np.float16)[graph.labels[graph.scene_of]]
    told = objects_of(replace(graph, features=(features,)))
    net = mvcnn(told, epochs=10, batch=8, rate=1e-2)
    assert net.fit(seed=0).val[-1] == 1.0
    assert net.size() == 2 * 8 + (8 + 1) * 512 + (512 + 1) * 4, "the trunk is not its own"


def test_few_objects_are_passed_over_more_often() -> None:
    objects = objects_of(ring_graph(objects=24, classes=2))  # 8 of them train
    for updates, epochs in ((0, 2), (4, 2), (5, 3), (6, 3)):
        assert len(mvcnn(objects, epochs=2, batch=4, updates=updates).fit(seed=0).losses) == epochs


def test_the_best_epoch_on_val_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    objects = objects_of(ring_graph(objects=12, classes=2))
    net, weights = mvcnn(objects, epochs=4), []
    answers = iter([0.25, 0.75, 0.75, 0.5])

    def named(targets: torch.Tensor, views: torch.Tensor) -> torch.Tensor:
        """As many right as the next of `answers` says."""
        weights.append(net.head[1].weight.clone())
        labels = objects.labels[targets]
        right = torch.arange(len(targets)) < next(answers) * len(targets)
        return torch.eye(2)[torch.where(right, labels, 1 - labels)]

    monkeypatch.setattr(net, "probabilities", named)
    training = fitting.fit(net, seed=0)
    assert training.val == [0.25, 0.75, 0.75, 0.5]
    assert training.epoch == 3, "the last of the best"
    assert torch.equal(net.head[1].weight, weights[2])


def test_what_is_learned_is_kept_until_something_that_it_depends_on_changes(tmp_path: Path) -> None:
    graph = ring_graph(objects=12, classes=2)
    first = mvcnn(objects_of(graph), epochs=1)
    training = trained("mvcnn", first, tmp_path, seed=0)
    (folder,) = tmp_path.glob("recogniser-*[!k]")
    about = json.loads((folder / "recogniser.json").read_text())
    assert (about["name"], about["seed"], about["settings"]["epochs"]) == ("mvcnn", 0, 1)

    again = mvcnn(objects_of(graph), epochs=1)
    with torch.no_grad():
        again.head[0].weight.zero_()
    assert trained("mvcnn", again, tmp_path, seed=0) == training
    assert torch.equal(again.head[0].weight, first.head[0].weight)

    changed = graph.frames.copy()
    changed[5, 0, 0] ^= 1
    splits = graph.start_split.copy()
    splits[:12] = 2
    same = first.digest(0)
    assert mvcnn(objects_of(graph), epochs=1).digest(0) == same
    for other in (
        mvcnn(objects_of(replace(graph, frames=changed)), epochs=1),
        mvcnn(objects_of(replace(graph, start_split=splits)), epochs=1),
        mvcnn(objects_of(graph), epochs=2),
    ):
        assert other.digest(0) != same
    assert first.digest(1) != same

    (folder / "weights.safetensors").write_bytes(b"half of it")
    with pytest.raises(DataError, match=r"^.*recogniser-\w+ cannot be used .*delete it, and it is trained"):
        trained("mvcnn", again, tmp_path, seed=0)


def test_rows_say_what_was_measured_and_repeat(tmp_path: Path) -> None:
    objects = objects_of(ring_graph(objects=24, classes=2))

    def rows() -> list[object]:
        return recognise(
            ["mvcnn"], objects, split="test", seed=0, cache=tmp_path, epochs=2, progress=progress
        )[0]

    first = rows()
    assert [(row.views, row.sets, row.objects) for row in first] == [(12, 1, 8), (3, 12, 8), (1, 12, 8)]
    assert [row.published for row in first] == [90.1, None, None]
    assert NO_MOVEMENT == 64.3
    for row in first:
        assert row.accuracy.low <= row.accuracy.mean <= row.accuracy.high
    assert rows() == first, "the time of the training too, since it is not done again"


def test_rooms_and_names_given_twice_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"shows rooms; leave them out, or take"):
        objects_of(room_graph())
    objects = objects_of(ring_graph(objects=12, classes=2))
    with pytest.raises(ConfigError, match=r"^The recogniser 'mvcnn' is named twice; name it once\.$"):
        recognise(["mvcnn", "mvcnn"], objects, split="test", seed=0, cache=tmp_path, progress=progress)
    assert not list(tmp_path.iterdir())


def test_a_recogniser_is_made_alike_whatever_was_drawn_before() -> None:
    objects = objects_of(ring_graph(objects=12, classes=2))
    made: list[Recogniser] = []
    for before in (1, 5):
        torch.rand(before)
        made.append(make_recogniser("mvcnn", objects, 3, progress=progress))
    after = torch.initial_seed()
    for one, other in zip(made[0].parameters(), made[1].parameters(), strict=True):
        assert torch.equal(one, other)
    assert torch.initial_seed() == after


def test_turning_an_object_by_a_stride_leaves_deeppanos_logits_as_they_are() -> None:
    objects = Objects(graph=TINY.open(), world=TINY, shape=SHAPE)
    net = make_recogniser("deeppano", objects, 0, progress=progress).eval()
    assert isinstance(net, DeepPano)
    panoramas = torch.from_numpy(TINY.panoramas()[:3].copy())
    plain = net.classify(panoramas)
    for columns in (STRIDE, 5 * STRIDE, -3 * STRIDE):
        torch.testing.assert_close(net.classify(panoramas.roll(columns, -1)), plain, rtol=1e-4, atol=1e-5)
    assert (net.classify(panoramas.flip(1)) - plain).abs().max() > 1e-3, "it sees more than nothing"


def test_shapenets_sees_the_surface_free_space_and_what_is_unseen() -> None:
    objects = Objects(graph=TINY.open(), world=TINY, shape=SHAPE)
    net = make_recogniser("shapenets", objects, 0, progress=progress).eval()
    assert isinstance(net, ShapeNets)
    every = objects.views[:1]
    one, nothing = every.clone(), torch.full_like(every, -1)
    one[:, 1:] = -1
    states = net.states(torch.cat([every, one, nothing]))
    assert (states[0] >= states[1]).all(), "no view takes back what another has seen"
    assert (states[0] > states[1]).any()
    assert not states[2].any()
    assert [set(state.tolist()) for state in states[:2]] == [{0, 1, 2}, {0, 1, 2}]
    grids = []
    net.maps.register_forward_pre_hook(lambda module, given: grids.append(given[0]))
    net.classify(states)
    assert torch.equal(grids[0].flatten(1), states.float() - 1)


@pytest.mark.parametrize("name", ["deeppano", "shapenets"])
def test_what_a_world_lacks_is_said_before_anything_is_trained(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    for split in ("train", "test"):
        for kind in ("cup", "vase"):
            for view in range(1, 13):
                file = folder / kind / split / f"{kind}_0001_{view:03d}.png"
                file.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(file), np.full((32, 32), 40 * (kind == "cup"), np.uint8))
    world = ModelNetSettings(size=32, dataset=DatasetSettings(path=folder), cache=tmp_path / "cache")
    objects = Objects(graph=world.open(), world=world, shape=SHAPE)
    before = sorted((tmp_path / "cache").iterdir())
    with pytest.raises(ConfigError, match=r"holds pictures, which tell no (depth|panorama) of objects"):
        recognise(["mvcnn", name], objects, split="test", seed=0, cache=tmp_path, progress=progress)
    assert sorted((tmp_path / "cache").iterdir()) == before
