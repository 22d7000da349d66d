"""Scenes walked and recorded, against the made-up simulator asked by hand."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from activelsd.envs.crops import cut_out, squashed
from activelsd.envs.oracle import shows_well
from activelsd.envs.thor import recordings as module
from activelsd.envs.thor.lattice import HEADINGS, MOVES, Pose
from activelsd.envs.thor.record import EASY, HARD, MODERATE, ViewMaker, difficulties, record
from activelsd.envs.thor.recordings import recordings
from activelsd.envs.thor.room import Target, WalkableRoom, sight, unhindered
from activelsd.envs.thor.settings import THORSettings
from activelsd.envs.viewgraph import ViewGraph, join, load_graph
from activelsd.errors import DataError
from tests.envs.thor.simulator import CELLS, OBJECTS, SIZE, FakeSimulator

HORIZONS = (-30.0, 0.0, 30.0)
CLASSES = ("Apple", "Bowl", "Box")
CAMERA = ViewMaker(16, 90.0)


def walk(simulator: FakeSimulator) -> WalkableRoom:
    return WalkableRoom(simulator, step=0.25, horizons=HORIZONS, classes=CLASSES)


@pytest.fixture(scope="module")
def recorded() -> ViewGraph:
    return record(walk(FakeSimulator()), "FloorPlan1", camera=CAMERA, classes=CLASSES)


def test_every_view_is_what_the_simulator_shows_there(recorded: ViewGraph) -> None:
    assert recorded.poses is not None
    assert recorded.pair_of is not None
    assert recorded.boxes is not None
    assert recorded.crops is not None
    assert recorded.pixels is not None
    assert len(recorded.frames) == len(CELLS) * HEADINGS * len(HORIZONS)
    assert recorded.targets == tuple(f"FloorPlan1/{name}" for name in OBJECTS)
    room = walk(FakeSimulator())
    room.enter("FloorPlan1")
    for view in range(0, len(recorded.frames), 7):
        event = room.stand(Pose.recorded(recorded.poses[view]))
        assert event is not None
        gray = cv2.cvtColor(np.ascontiguousarray(event.frame), cv2.COLOR_RGB2GRAY)
        np.testing.assert_array_equal(recorded.frames[view], squashed(np.asarray(gray, np.uint8), 16))
        for target, name in enumerate(OBJECTS):
            pair, mask = recorded.pair_of[view, target], event.instance_masks.get(name)
            assert (pair >= 0) == (mask is not None)
            if mask is None:
                continue
            rows, columns = np.nonzero(mask)
            edges = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
            cx, cy, width, height = recorded.boxes[pair] * SIZE
            np.testing.assert_allclose(
                [cx - width / 2, cy - height / 2, cx + width / 2, cy + height / 2], edges, atol=1e-4
            )
            np.testing.assert_array_equal(
                recorded.crops[pair], cut_out(np.asarray(gray, np.uint8), edges.astype(np.int32), 16)
            )
            assert recorded.pixels[pair] == pytest.approx(mask.mean())


def test_a_recording_in_colour_shows_what_the_simulator_does(recorded: ViewGraph) -> None:
    camera = ViewMaker(16, 90.0, "rgb")
    colour = record(walk(FakeSimulator()), "FloorPlan1", camera=camera, classes=CLASSES)
    assert colour.crops is not None
    assert recorded.crops is not None
    assert colour.poses is not None
    assert colour.crops.shape == (len(recorded.crops), 3, 16, 16)
    room = walk(FakeSimulator())
    room.enter("FloorPlan1")
    event = room.stand(Pose.recorded(colour.poses[5]))
    assert event is not None
    for c in range(3):
        channel = np.ascontiguousarray(event.frame[..., c])
        np.testing.assert_array_equal(colour.frames[5, c], squashed(channel, 16))
    boxes = (colour.boxes, recorded.boxes)
    np.testing.assert_array_equal(*boxes)


def test_a_cell_where_the_agent_lands_elsewhere_is_left_out() -> None:
    simulator = FakeSimulator(sealed=((1, 0),))
    graph = record(walk(simulator), "FloorPlan1", camera=CAMERA, classes=CLASSES)
    assert len(graph.frames) == (len(CELLS) - 1) * HEADINGS * len(HORIZONS)
    assert graph.poses is not None
    assert not np.isclose(graph.poses[:, :2], [0.25, 0.0], atol=0.01).all(1).any()
    # From the corner at its left there is no way to the right any more.
    corner = graph.view_names.index("0_0_90_0")
    assert graph.moves[corner, MOVES.index("forward")] == -1
    assert graph.moves[corner, MOVES.index("left")] >= 0
    whole = record(walk(FakeSimulator()), "FloorPlan1", camera=CAMERA, classes=CLASSES)
    assert graph.view_names == tuple(name for name in whole.view_names if not name.startswith("1_0_"))


def test_no_object_and_no_landing_are_said() -> None:
    room = WalkableRoom(FakeSimulator(), step=0.25, horizons=HORIZONS, classes=("Toaster",))
    with pytest.raises(DataError, match="FloorPlan1 has none of the objects"):
        record(room, "FloorPlan1", camera=CAMERA, classes=("Toaster",))
    with pytest.raises(DataError, match="lands nowhere in FloorPlan1"):
        record(walk(FakeSimulator(sealed=CELLS)), "FloorPlan1", camera=CAMERA, classes=CLASSES)


def test_a_room_that_changes_by_itself_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, calls = FakeSimulator(), len(CELLS) * HEADINGS * len(HORIZONS)
    room = walk(simulator)
    plain = room.stand

    def stand(pose: Pose) -> object:
        event = plain(pose)
        if event is not None and simulator.calls.count("TeleportFull") > calls:
            event.frame[:] //= 2
        return event

    monkeypatch.setattr(room, "stand", stand)
    with pytest.raises(DataError, match="is not what it was when it was recorded"):
        record(room, "FloorPlan1", camera=CAMERA, classes=CLASSES)


def test_difficulty_is_by_the_share_of_the_best_view_and_of_what_is_hidden() -> None:
    pixels = np.array([100.0, 25.0, 24.0, 5.0, 4.0, 50.0, 7.0])
    shown = np.array([1.0, 0.25, 1.0, 1.0, 1.0, 0.24, 1.0])
    targets = np.array([0, 0, 0, 0, 0, 0, 1], np.int32)
    wanted = [EASY, EASY, MODERATE, MODERATE, HARD, HARD, EASY]
    assert difficulties(pixels, shown, targets).tolist() == wanted


def test_the_extent_of_a_target_is_that_of_its_mask_where_nothing_hides_it() -> None:
    room = walk(FakeSimulator())
    scene = room.enter("FloorPlan1")
    checked = 0
    for view in range(scene.lattice.views):
        pose = scene.lattice.pose(view)
        event = room.stand(pose)
        assert event is not None
        for target in scene.targets:
            seen = sight(event, target.id)
            if seen is not None and min(seen.box) > 0 and max(seen.box) < SIZE:
                assert seen.pixels == pytest.approx(unhindered(event, target, pose, 90.0), rel=0.35)
                checked += 1
    assert checked > 20


def test_a_target_behind_is_as_large_as_it_can_be() -> None:
    room = walk(FakeSimulator())
    scene = room.enter("FloorPlan1")
    pose = scene.lattice.pose(1)
    event = room.stand(pose)
    assert event is not None
    behind = Target("x", "Apple", np.array([[0.1, 1.5, -1.0], [-0.1, 1.7, -1.1]]))
    assert unhindered(event, behind, pose, 90.0) > SIZE**2 / 100


def world(cache: Path) -> THORSettings:
    return THORSettings(
        backend="standin", step=0.25, horizons=HORIZONS, classes=CLASSES, size=32, simulators=1, cache=cache
    )


def test_recordings_are_made_once_and_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulators: list[FakeSimulator] = []

    def start(settings: THORSettings) -> FakeSimulator:
        simulators.append(FakeSimulator(lost=frozenset({4, 150})))
        return simulators[-1]

    monkeypatch.setattr(module, "start", start)
    seen: list[tuple[int, int]] = []
    own, report = world(tmp_path), lambda *a: seen.append(a)
    one = recordings(own, ["FloorPlan1"], report)
    both = recordings(own, ["FloorPlan1", "FloorPlan2"], report)
    again = recordings(own.model_copy(update={"simulators": None}), ["FloorPlan1", "FloorPlan2"], report)
    assert both == again
    assert both[0] == one[0]
    # A simulator that is lost begins anew; one that is not needed is not started.
    assert [simulator.calls.count("reset") for simulator in simulators] == [3, 3]
    assert all(simulator.stopped for simulator in simulators)
    assert seen == [(0, 1), (1, 1), (1, 2), (2, 2)]

    graph = join([load_graph(file) for file in both])
    assert graph.scenes == ("FloorPlan1", "FloorPlan2")
    assert len(graph.targets) == 4
    for scene, file in enumerate(both):
        own = load_graph(file)
        views = np.flatnonzero(graph.scene_of == scene)
        offset = views[0]
        np.testing.assert_array_equal(graph.frames[views], own.frames)
        moved = graph.moves[views]
        np.testing.assert_array_equal(np.where(moved >= 0, moved - offset, -1), own.moves)
        for view in range(0, len(own.frames), 31):
            for target in range(2):
                np.testing.assert_array_equal(
                    graph.target_box(offset + view, 2 * scene + target), own.target_box(view, target)
                )
                np.testing.assert_array_equal(
                    graph.crop(offset + view, 2 * scene + target), own.crop(view, target)
                )
                assert not graph.target_box(offset + view, 2 * (1 - scene) + target)[4]


def test_a_target_is_shown_well_by_its_pixels(recorded: ViewGraph) -> None:
    assert recorded.pixels is not None
    assert recorded.boxes is not None
    assert recorded.pair_of is not None
    well = shows_well(recorded)
    for target in range(2):
        pairs = recorded.pair_of[:, target]
        pairs = pairs[pairs >= 0]
        low = recorded.boxes[pairs, :2] - recorded.boxes[pairs, 2:] / 2
        high = recorded.boxes[pairs, :2] + recorded.boxes[pairs, 2:] / 2
        inside = ((low > 1e-6) & (high < 1 - 1e-6)).all(1)
        best = recorded.pixels[pairs][inside].max()
        np.testing.assert_array_equal(well[pairs], inside & (recorded.pixels[pairs] >= best / 2))
