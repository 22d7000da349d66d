"""The stand-in answers as `ai2thor.controller.Controller` does, in its axes and under its names."""

from __future__ import annotations

import math

import numpy as np
import pytest

from activelsd.envs.thor.settings import THORSettings
from activelsd.envs.thor.standin import StandIn
from activelsd.errors import ConfigError
from activelsd.scenery.rooms.room_renderer import RoomRenderer

SCENE = "FloorPlan207"


@pytest.fixture(scope="module")
def opened():
    return StandIn(
        scene=SCENE,
        width=96,
        height=72,
        renderInstanceSegmentation=True,
        renderDepthImage=True,
        quality="Low",
    )


@pytest.fixture
def client(opened):
    opened.reset(SCENE)
    return opened


def positions(client):
    return client.step("GetReachablePositions").metadata["actionReturn"]


def go(client, place, rotation, horizon=0.0):
    return client.step(
        "TeleportFull", **place, rotation={"x": 0.0, "y": rotation, "z": 0.0}, horizon=horizon, standing=True
    )


def towards(place, thing):
    """The heading in THOR's degrees from a place to a thing, and the metres between them on the floor."""
    dx, dz = thing["position"]["x"] - place["x"], thing["position"]["z"] - place["z"]
    return math.degrees(math.atan2(dx, dz)), math.hypot(dx, dz)


def in_sight(client):
    """A thing, a place and the event there with all of the thing in the middle of the picture."""
    for thing in client.last_event.metadata["objects"]:
        for place in positions(client):
            heading, distance = towards(place, thing)
            down = math.degrees(math.atan2(1.576 - thing["position"]["y"], distance))
            if thing["objectType"] in THORSettings().classes and 1.0 < distance < 3.0 and down < 60:
                event = go(client, place, heading, down)
                x1, _, x2, _ = event.instance_detections2D.get(thing["objectId"], (0, 0, 0, 0))
                if event.instance_masks.get(thing["objectId"], np.zeros(1)).sum() > 12 and 40 < x1 < x2 < 56:
                    yield thing, place, heading, down, event


def same(a, b):
    return (
        a.frame.tobytes() == b.frame.tobytes()
        and a.depth_frame.tobytes() == b.depth_frame.tobytes()
        and a.instance_detections2D == b.instance_detections2D
        and a.metadata == b.metadata
    )


def test_an_event_has_the_fields_of_the_real_one(client):
    event = client.last_event
    assert event
    assert event.frame.shape == (72, 96, 3)
    assert event.frame.dtype == np.uint8
    assert event.depth_frame.shape == (72, 96)
    assert event.depth_frame.dtype == np.float32
    meta = event.metadata
    assert meta["sceneName"] == f"{SCENE}_physics"
    assert (meta["lastActionSuccess"], meta["errorMessage"], meta["errorCode"]) == (True, "", "")
    assert meta["agent"].keys() >= {"position", "rotation", "cameraHorizon"}
    assert meta["cameraPosition"]["y"] == pytest.approx(1.576)
    assert {thing["objectType"] for thing in meta["objects"]} >= {"Television", "GarbageCan", "Sofa"}
    assert len({thing["objectId"] for thing in meta["objects"]}) == len(meta["objects"])
    for thing in meta["objects"]:
        name, *place = thing["objectId"].split("|")
        assert name == thing["objectType"]
        np.testing.assert_allclose([float(x) for x in place], list(thing["position"].values()), atol=0.006)
        box = thing["axisAlignedBoundingBox"]
        corners = np.array(box["cornerPoints"])
        np.testing.assert_allclose(np.ptp(corners, axis=0), list(box["size"].values()))
        np.testing.assert_allclose(corners.mean(axis=0), list(box["center"].values()))


def test_boxes_are_the_extents_of_masks(client):
    seen = 0
    for i, place in enumerate(positions(client)[::7]):
        event = go(client, place, 45.0 * (i % 8), 30.0)
        assert event.instance_masks.keys() == event.instance_detections2D.keys()
        for name, mask in event.instance_masks.items():
            rows, columns = np.nonzero(mask)
            box = (columns.min(), rows.min(), columns.max(), rows.max())
            assert event.instance_detections2D[name] == box
            seen += 1
        total = sum(mask.astype(int) for mask in event.instance_masks.values())
        assert np.max(total) <= 1
    assert seen > 20


def test_without_segmentation_and_depth_there_is_none():
    event = StandIn(scene=SCENE, width=24, height=24).last_event
    assert event.instance_detections2D is None
    assert event.instance_masks == {}
    assert event.depth_frame is None
    assert event.frame.shape == (24, 24, 3)


def test_what_is_looked_at_is_in_the_middle_at_its_distance(client):
    found = 0
    for thing, place, _, _, event in in_sight(client):
        x1, y1, x2, y2 = event.instance_detections2D[thing["objectId"]]
        assert abs((x1 + x2 + 1) / 2 - 48) < 8
        assert abs((y1 + y2 + 1) / 2 - 36) < 10
        eye = np.array([place["x"], 1.576, place["z"]])
        away = np.linalg.norm(eye - list(thing["position"].values()))
        depth = np.median(event.depth_frame[event.instance_masks[thing["objectId"]]])
        assert abs(depth - away) < max(thing["axisAlignedBoundingBox"]["size"].values())
        found += 1
    assert found > 20


def test_axes(client):
    """Turning right moves a thing left, looking down moves it up, coming nearer makes it larger."""
    thing, place, heading, down, event = next(in_sight(client))
    name = thing["objectId"]
    middle = event.instance_detections2D[name]
    right = go(client, place, heading + 15.0, down)
    assert right.instance_detections2D[name][2] < middle[2] - 4
    lower = go(client, place, heading, down + 10.0)
    assert lower.instance_detections2D[name][1] > 0
    assert lower.instance_detections2D[name][1] < middle[1] - 4
    sizes = {}
    for there in positions(client):
        again, distance = towards(there, thing)
        pitch = math.degrees(math.atan2(1.576 - thing["position"]["y"], distance))
        if abs((again - heading + 180) % 360 - 180) < 25 and pitch < 60:
            mask = go(client, there, again, pitch).instance_masks.get(name)
            sizes[distance] = 0 if mask is None else mask.sum()
    assert len(sizes) > 3
    assert sizes[min(sizes)] > sizes[max(sizes)]


def test_steps_go_where_the_agent_faces(client):
    """At heading 0 ahead is +z and right +x; at heading 90 ahead is +x; back leads to the same place."""
    places = {(place["x"], place["z"]) for place in positions(client)}
    x, z = next((x, z) for x, z in sorted(places) if {(x, z + 0.25), (x + 0.25, z)} <= places)
    for rotation, action, back, there in (
        (0, "MoveAhead", "MoveBack", (x, z + 0.25)),
        (0, "MoveRight", "MoveLeft", (x + 0.25, z)),
        (90, "MoveAhead", "MoveBack", (x + 0.25, z)),
        (180, "MoveBack", "MoveAhead", (x, z + 0.25)),
        (270, "MoveBack", "MoveAhead", (x + 0.25, z)),
    ):
        start = go(client, {"x": x, "y": 0.901, "z": z}, rotation)
        moved = client.step(action=action).metadata["agent"]["position"]
        assert (moved["x"], moved["z"]) == there
        assert same_agent(client.step(back), start)


def same_agent(a, b):
    return a.metadata["agent"] == b.metadata["agent"]


def test_turns_and_looks_wrap_and_end(client):
    assert client.step("RotateLeft", degrees=45.0).metadata["agent"]["rotation"]["y"] == 315.0
    assert client.step("RotateRight", degrees=90).metadata["agent"]["rotation"]["y"] == 45.0
    assert client.step("RotateRight").metadata["agent"]["rotation"]["y"] == 135.0
    assert [bool(client.step("LookDown")) for _ in range(3)] == [True, True, False]
    assert client.last_event.metadata["agent"]["cameraHorizon"] == 60.0
    assert [bool(client.step("LookUp")) for _ in range(4)] == [True, True, True, False]
    assert client.last_event.metadata["agent"]["cameraHorizon"] == -30.0


def test_all_reachable_positions_can_be_gone_to_and_lie_on_the_grid(client):
    places = positions(client)
    assert 40 <= len(places) <= 120
    for place in places:
        assert (place["x"] * 4).is_integer()
        assert (place["z"] * 4).is_integer()
        landed = go(client, place, 0.0)
        assert landed
        assert landed.metadata["agent"]["position"] == place


@pytest.mark.parametrize(
    "wrong",
    [{"x": 9.0}, {"y": 2.0}, {"horizon": 75.0}, {"x": math.nan}],
)
def test_what_cannot_be_done_fails_and_moves_nothing(client, wrong):
    before = client.step("Pass")
    place = {**positions(client)[0], "rotation": 90.0, "horizon": 0.0, "standing": True}
    event = client.step("TeleportFull", **{**place, **wrong})
    assert not event
    assert event.metadata["errorMessage"]
    assert same_agent(event, before)
    assert event.frame.tobytes() == before.frame.tobytes()
    with pytest.raises(RuntimeError):
        client.step("TeleportFull", raise_for_failure=True, **{**place, **wrong})


def test_nothing_can_be_walked_through(client):
    """No step leads into furniture, whatever way it is tried."""
    sofa = next(thing for thing in client.last_event.metadata["objects"] if thing["objectType"] == "Sofa")
    assert not go(client, {**sofa["position"], "y": 0.901}, 0.0)
    for _ in range(40):
        if not client.step("MoveAhead"):
            break
    assert "blocking" in client.last_event.metadata["errorMessage"]


def test_a_teleport_keeps_what_is_not_said(client):
    place = positions(client)[3]
    go(client, place, 90.0, 30.0)
    event = client.step("Teleport", position=positions(client)[5], standing=False)
    agent = event.metadata["agent"]
    assert (agent["rotation"]["y"], agent["cameraHorizon"], agent["isStanding"]) == (90.0, 30.0, False)
    assert event.metadata["cameraPosition"]["y"] == pytest.approx(0.901)
    assert not client.step("Teleport", position={"x": 50.0, "y": 0.901, "z": 0.0})


def test_unknown_actions_and_arguments_are_refused(client):
    with pytest.raises(ValueError, match="no action Jump"):
        client.step("Jump")
    with pytest.raises(ValueError, match="horizon"):
        client.step("TeleportFull", x=0.0, y=0.9, z=0.0, rotation=0.0, standing=True)
    with pytest.raises(ValueError, match="speed"):
        client.step("MoveAhead", speed=2)


def test_a_filter_keeps_objects_out_of_the_metadata_but_not_out_of_the_picture(client):
    everything = client.last_event
    ids = [thing["objectId"] for thing in everything.metadata["objects"]]
    event = client.step("SetObjectFilter", objectIds=ids[:2])
    assert [thing["objectId"] for thing in event.metadata["objects"]] == ids[:2]
    assert event.instance_detections2D == everything.instance_detections2D
    assert len(client.step("Pass").metadata["objects"]) == 2
    assert len(client.step("ResetObjectFilter").metadata["objects"]) == len(ids)


def test_visible_things_are_near_and_in_the_picture(client):
    visible = 0
    for i, place in enumerate(positions(client)[::3]):
        event = go(client, place, 45.0 * (i % 8), 30.0)
        here = np.array([place["x"], 0.901, place["z"]])
        for thing in event.metadata["objects"]:
            away = np.linalg.norm(here - list(thing["position"].values()))
            assert thing["distance"] == pytest.approx(away)
            mask = event.instance_masks.get(thing["objectId"])
            if thing["visible"]:
                assert away <= 1.5
                assert mask is not None
                visible += 1
            elif away <= 1.5 and mask is not None:
                assert mask.sum() < 150  # of 6,912: a sliver between the points that are looked for
    assert visible > 10


def test_the_same_pose_gives_the_same_bytes():
    clients = [
        StandIn(scene=SCENE, width=64, height=48, renderInstanceSegmentation=True, renderDepthImage=True)
        for _ in range(2)
    ]
    place = positions(clients[0])[7]
    clients[1].step("RotateRight", degrees=33.0)
    one, other = (go(client, place, 45.0, 30.0) for client in clients)
    assert same(one, other)


def test_pictures_are_taken_only_when_asked_for_and_once(client, monkeypatch):
    taken = []
    look = RoomRenderer.look
    monkeypatch.setattr(RoomRenderer, "look", lambda *args: taken.append(args) or look(*args))
    place = positions(client)[9]
    first = go(client, place, 45.0)
    client.step("SetObjectFilter", objectIds=[])
    assert taken == []
    assert first.frame.any()
    assert first.instance_masks
    assert client.step("Pass").frame is first.frame
    assert len(taken) == 1
    assert go(client, place, 90.0).frame is not first.frame
    assert len(taken) == 2


def test_settings_stay_over_resets():
    client = StandIn(scene=SCENE, width=40, height=30, fieldOfView=60.0, renderInstanceSegmentation=True)
    event = client.reset("FloorPlan3_physics", width=20)
    assert event.frame.shape == (30, 20, 3)
    assert event.metadata["fov"] == 60.0
    assert event.instance_detections2D is not None
    assert client.scene == "FloorPlan3_physics"
    assert client.reset().metadata["sceneName"] == "FloorPlan3_physics"
    assert "FloorPlan430_physics" in client.step("GetScenesInBuild").metadata["actionReturn"]
    with pytest.raises(ConfigError, match="FloorPlan31"):
        client.reset("FloorPlan31")


def test_after_stop_nothing_is_answered():
    client = StandIn(scene=SCENE, width=8, height=8)
    client.stop()
    client.stop()
    for call in (client.reset, lambda: client.step("Pass")):
        with pytest.raises(RuntimeError, match="stopped"):
            call()
