"""However the player fails, the guarded client ends soon in one error, and nothing of the player is left."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from clients import Belongings, children, controller, player

from activelsd.envs.thor import client
from activelsd.envs.thor.client import GuardedController
from activelsd.errors import ConfigError, SimulatorError, SimulatorLost

pytestmark = pytest.mark.thor

SOON_S = 5.0
SCENE = "FloorPlan5"


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    """Every test ends with what it began with."""
    before = Belongings.now()
    yield
    assert Belongings.now() == before


@pytest.mark.parametrize(
    ("fail", "reason"),
    [
        ("segv@open", "it died of SIGSEGV"),
        ("exit@open", "it exited with code 3"),
        ("hang@open", "it did not answer within 1 s"),
        ("kill@hello", "it died of SIGKILL"),
        ("hang@hello", "it did not answer within 1 s"),
        ("segv@1", "it died of SIGSEGV"),
        ("segv@Reset", "it died of SIGSEGV"),
        ("abort@Initialize", "it died of SIGABRT"),
        ("hang@Reset", "it did not answer within 1 s"),
        ("midmessage@hello", "it died of SIGKILL"),
        ("midmessage@Reset", "it died of SIGKILL"),
        ("garbage@hello", "KeyError: 200"),
        ("garbage@Reset", "KeyError: 200"),
        ("endless@Reset", "it did not answer within 1 s"),
        ("sequence@Reset", "Sequence id mismatch"),
    ],
)
def test_failures_on_the_way_to_the_first_view(fail: str, reason: str) -> None:
    deadline = 1.0 if "hang" in fail or "endless" in fail else 20.0
    before, begun = Belongings.now(), time.monotonic()
    thor = controller("--fail", fail, start_timeout_s=deadline)
    with pytest.raises(SimulatorLost, match=reason):
        thor.reset(SCENE)
    assert time.monotonic() - begun < SOON_S
    assert Belongings.now() == before  # without a stop


@pytest.mark.parametrize(
    ("fail", "reason"),
    [
        ("segv@Pass", "it died of SIGSEGV"),
        ("abort@Pass", "it died of SIGABRT"),
        ("kill@Pass", "it died of SIGKILL"),
        ("exit@Pass", "it exited with code 3"),
        ("hang@Pass", "it did not answer within 0.5 s"),
        ("endless@Pass", "it did not answer within 0.5 s"),
        ("garbage@Pass", "KeyError: 200"),
        ("sequence@Pass", "Sequence id mismatch"),
        ("midmessage@Pass", "it died of SIGKILL"),
        ("nopicture@Pass", "it died of SIGKILL"),
    ],
)
def test_failures_of_a_step(fail: str, reason: str) -> None:
    deadline = 0.5 if "hang" in fail or "endless" in fail else 20.0
    before = Belongings.now()
    thor = controller("--fail", fail, step_timeout_s=deadline)
    thor.reset(SCENE)
    begun = time.monotonic()
    with pytest.raises(SimulatorLost, match=reason):
        thor.step("Pass")
    assert time.monotonic() - begun < SOON_S
    assert Belongings.now() == before
    with pytest.raises(SimulatorLost, match="a reset starts one"):
        thor.step("Pass")


@pytest.mark.parametrize("wait_s", [0.0, 0.2])  # before and after the watchdog can have seen it
@pytest.mark.parametrize("call", ["step", "reset"])
def test_a_player_killed_between_calls(call: str, wait_s: float) -> None:
    before = Belongings.now()
    thor = controller()
    thor.reset(SCENE)
    (pid,) = children() - before.children
    os.kill(pid, signal.SIGKILL)
    time.sleep(wait_s)
    with pytest.raises(SimulatorLost):
        thor.step("Pass") if call == "step" else thor.reset(SCENE)
    assert Belongings.now() == before
    thor.stop()


def test_a_reset_after_a_loss_starts_another(tmp_path: Path) -> None:
    with controller("--fail", "segv@RotateRight", "--once", tmp_path / "once") as thor:
        first = thor.reset(SCENE)
        with pytest.raises(SimulatorLost):
            thor.step("RotateRight")
        again = thor.reset(SCENE)
        np.testing.assert_array_equal(again.frame, first.frame)
        assert thor.step("RotateRight").metadata["agent"]["rotation"]["y"] == 90


def play_for_ever(thor: GuardedController) -> None:
    thor.reset(SCENE)
    while True:
        thor.step("RotateRight")


def test_whenever_it_crashes_it_is_lost_until_that_was_too_often() -> None:
    before = Belongings.now()
    thor = controller("--crash-probability", 0.03)
    for _ in range(client.RESTARTS + 1):
        with pytest.raises(SimulatorLost, match=r"SIGSEGV|BrokenPipe"):
            play_for_ever(thor)
        assert Belongings.now() == before
    with pytest.raises(SimulatorError) as caught:
        thor.reset(SCENE)
    assert "lost 4 times within 10 minutes" in str(caught.value)
    assert "env.backend=standin" in str(caught.value)


def test_losses_of_long_ago_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "WINDOW_S", 0.0)
    thor = controller("--fail", "exit@open")
    for _ in range(client.RESTARTS + 2):
        with pytest.raises(SimulatorLost):
            thor.reset(SCENE)


def test_stop_can_be_said_twice_and_a_reset_starts_again() -> None:
    before = Belongings.now()
    thor = controller()
    thor.stop()
    for _ in range(client.RESTARTS + 2):  # which are no restarts after a loss
        thor.reset(SCENE)
        assert Belongings.now() != before
        thor.stop()
        thor.stop()
        assert Belongings.now() == before


def test_a_controller_that_is_forgotten_leaves_nothing() -> None:
    before = Belongings.now()
    thor = controller()
    thor.reset(SCENE)
    del thor
    assert Belongings.now() == before


@pytest.mark.parametrize("player_dies", [False, True])
def test_the_interpreters_exit_leaves_nothing(player_dies: bool, tmp_path: Path) -> None:
    log = tmp_path / "log"
    script = f"""
import os, signal, sys, time
from activelsd.envs.thor.client import GuardedController
thor = GuardedController(executable={player("--log", log)!r}, x_display=":0")
thor.reset("FloorPlan5")
if {player_dies}:
    os.kill({{"pid": int(open({str(log)!r}).readline().split()[1][:-1])}}["pid"], signal.SIGKILL)
"""
    temporary = tmp_path / "of_the_script"
    temporary.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(temporary)},
    )
    assert (done.returncode, done.stderr) == (0, "")
    pid = json.loads(log.read_text().splitlines()[0])["pid"]
    assert not Path(f"/proc/{pid}").exists()
    assert not list(temporary.iterdir())


def test_an_interrupted_call_leaves_nothing() -> None:
    before = Belongings.now()
    thor = controller("--fail", "hang@Pass")
    thor.reset(SCENE)
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        thor.step("Pass")
    timer.join()
    assert Belongings.now() == before


def test_frames_and_masks_are_the_same_with_and_without_an_alpha_channel() -> None:
    seen = []
    for channels in (3, 4):
        with controller("--channels", channels, renderDepthImage=True) as thor:
            event = thor.reset(SCENE)
            assert event.frame.shape == (64, 96, 3)
            assert event.frame.dtype == np.uint8
            assert event.frame.flags.c_contiguous
            assert event.depth_frame is not None
            assert event.depth_frame.flags.c_contiguous
            assert thor.last_event is event
            masks = {name: mask.copy() for name, mask in event.instance_masks.items()}
            seen.append((event.frame, masks, dict(event.instance_detections2D or {})))
    (frame, masks, boxes), (other_frame, other_masks, other_boxes) = seen
    np.testing.assert_array_equal(frame, other_frame)
    assert boxes == other_boxes
    assert any(not name.startswith(("Wall", "Floor")) for name in masks)
    assert masks.keys() == other_masks.keys()
    for name, mask in masks.items():
        np.testing.assert_array_equal(mask, other_masks[name])
        rows, columns = np.nonzero(mask)
        assert boxes[name] == (columns.min(), rows.min(), columns.max(), rows.max())


def test_what_is_asked_reaches_the_player(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with controller("--log", log, gridSize=0.25) as thor:
        thor.reset(SCENE)
        thor.reset("FloorPlan301")
        thor.step(action="RotateRight", degrees=45)
    _, *actions = [json.loads(line) for line in log.read_text().splitlines()]
    names = [action["action"] for action in actions]
    assert names == [
        *("ChangeResolution", "GetScenesInBuild", "Reset", "Initialize"),
        *("Reset", "Initialize", "RotateRight"),
    ]
    assert [action["sceneName"] for action in actions if action["action"] == "Reset"] == [
        "FloorPlan5_physics",
        "FloorPlan301_physics",
    ]
    for action in actions:
        if action["action"] == "Initialize":
            assert action["fieldOfView"] == 90
            assert action["gridSize"] == 0.25
    assert actions[-1]["degrees"] == 45


def test_an_action_that_fails_is_an_event_and_a_wrong_one_is_a_bug() -> None:
    with controller() as thor:
        thor.reset(SCENE)
        event = thor.step("TeleportFull", x=99, y=0.9, z=0, rotation=0, horizon=0, standing=True)
        assert not event.metadata["lastActionSuccess"]
        assert "cannot stand" in event.metadata["errorMessage"]
        with pytest.raises(ValueError, match="no action Fly"):
            thor.step("Fly")
        with pytest.raises(ValueError, match="lacks"):
            thor.step("TeleportFull", x=0)
        assert thor.step("Pass").metadata["lastActionSuccess"]  # it goes on


def test_wrong_settings_of_the_scene_are_a_bug_and_leave_nothing() -> None:
    before = Belongings.now()
    thor = controller(gridsize=0.25)
    with pytest.raises(ValueError, match="gridsize"):
        thor.reset(SCENE)
    assert Belongings.now() == before


def test_a_scene_that_is_not_in_the_build() -> None:
    before = Belongings.now()
    with controller() as thor:
        with pytest.raises(ConfigError, match=r"no scene FloorPlan31; did you mean FloorPlan3"):
            thor.reset("FloorPlan31")
        assert Belongings.now() == before
        thor.reset(SCENE)
        with pytest.raises(ConfigError, match="no scene Kitchen; an example is"):
            thor.reset("Kitchen")
        thor.step("Pass")  # it goes on


def test_poses_come_back_noisy_where_asked_for() -> None:
    with controller("--noise") as thor:
        thor.reset(SCENE)
        thor.step("RotateLeft")
        event = thor.step("LookDown")
        agent = event.metadata["agent"]
        assert agent["rotation"]["y"] == 269.9995
        assert agent["position"]["y"] == 0.90099
        assert agent["cameraHorizon"] == 30.00002


def test_visible_is_not_having_pixels() -> None:
    pixels_unseen, seen_without = set(), set()
    with controller() as thor:
        event = thor.reset(SCENE)
        cells = thor.step("GetReachablePositions").metadata["actionReturn"]
        for cell in cells[::5]:
            for rotation in (0, 90, 180, 270):
                event = thor.step("TeleportFull", **cell, rotation=rotation, horizon=0, standing=True)
                assert event.metadata["lastActionSuccess"]
                for thing in event.metadata["objects"]:
                    has_pixels = thing["objectId"] in event.instance_masks
                    if has_pixels and not thing["visible"]:
                        pixels_unseen.add(thing["objectType"])
                    if thing["visible"] and not has_pixels:
                        seen_without.add(thing["objectType"])
    assert "Book" in pixels_unseen
    assert "Candle" in seen_without


def test_the_object_filter() -> None:
    with controller() as thor:
        everything = thor.reset(SCENE).metadata["objects"]
        one = everything[2]["objectId"]
        assert [
            thing["objectId"] for thing in thor.step("SetObjectFilter", objectIds=[one]).metadata["objects"]
        ] == [one]
        assert len(thor.step("ResetObjectFilter").metadata["objects"]) == len(everything)
