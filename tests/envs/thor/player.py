"""A player in Unity's stead: speaks the pipe protocol of AI2-THOR 5.0.0's client, and misbehaves when told.

The unmodified client starts it, as `local_executable_path="python player.py --fail segv@3"`. It validates: an
action or an argument that it does not know is refused as AI2-THOR refuses it, a ValueError of the client.

`--fail HOW@WHEN` misbehaves once: WHEN is `open` (before a pipe is opened), `hello` (before the first word),
the name of an action, or N for the N-th action, from 1. With `--once FILE` only the first player of all does,
which makes FILE.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import struct
import sys
import time
from pathlib import Path
from typing import Any, BinaryIO

import msgpack
import numpy as np
from numpy.typing import NDArray
from playroom import MOVES, Refused, World

METADATA, ACTION, RGB, DEPTH, IDS, END = 1, 2, 4, 5, 9, 255
SIGNALS = {"segv": signal.SIGSEGV, "abort": signal.SIGABRT, "kill": signal.SIGKILL}
FAILURES = (*SIGNALS, "exit", "hang", "garbage", "endless", "sequence", "midmessage", "nopicture")

ALWAYS = {"action", "sequenceId", "renderImage"}
NEEDED: dict[str, set[str]] = {
    "Reset": {"sceneName"},
    "ChangeResolution": {"x", "y"},
    "ChangeQuality": {"quality"},
    "Teleport": {"x", "y", "z"},
    "TeleportFull": {"x", "y", "z", "rotation", "horizon", "standing"},
    "SetObjectFilter": {"objectIds"},
}
OPTIONAL: dict[str, set[str]] = {
    "GetScenesInBuild": set(),
    "GetReachablePositions": set(),
    "ResetObjectFilter": set(),
    "Pass": set(),
    "Initialize": {
        "gridSize",
        "fieldOfView",
        "visibilityDistance",
        "snapToGrid",
        "rotateStepDegrees",
        "renderDepthImage",
        "renderInstanceSegmentation",
        "agentMode",
    },
    "Teleport": {"rotation", "horizon", "standing"},
    "TeleportFull": {"forceAction"},
    **{move: {"moveMagnitude"} for move in MOVES},
    **{turn: {"degrees"} for turn in ("RotateLeft", "RotateRight", "LookUp", "LookDown")},
}


class Player:
    """Reads actions, answers each with one message, and misbehaves when it is time."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options, self.world, self.count = (
            options,
            World(options.width, options.height, noise=options.noise),
            0,
        )
        self.how, self.when = "", ""
        if options.fail and not (options.once and options.once.exists()):
            self.how, _, self.when = options.fail.partition("@")
        self.rng = np.random.default_rng()
        self.log({"pid": os.getpid()})

    def play(self) -> None:
        self.misbehave("open")
        self.out: BinaryIO = open(os.environ["AI2THOR_FIFO_SERVER_PIPE_PATH"], "wb")  # noqa: PTH123, SIM115
        self.misbehave("hello")
        self.answer({"sequenceId": 0, "action": "Initialize"}, None, None)
        with open(os.environ["AI2THOR_FIFO_CLIENT_PIPE_PATH"], "rb") as source:  # noqa: PTH123
            while (action := receive(source)) is not None:
                self.count += 1
                self.log(action)
                self.misbehave(action["action"], str(self.count))
                if self.rng.random() < self.options.crash_probability:
                    os.kill(os.getpid(), signal.SIGSEGV)
                self.take(action)

    def take(self, action: dict[str, Any]) -> None:
        name = action["action"]
        arguments = {key: value for key, value in action.items() if key not in ALWAYS}
        returned, refused = None, None
        try:
            check(name, arguments)
            returned = self.world.act(name, arguments)
        except Refused as error:
            refused = error
        self.answer(action, returned, refused)

    def answer(self, action: dict[str, Any], returned: object, refused: Refused | None) -> None:
        told = self.world.describe() | {
            "lastAction": action["action"],
            "lastActionSuccess": refused is None,
            "errorMessage": "" if refused is None else str(refused),
            "errorCode": "" if refused is None else refused.code,
            "actionReturn": returned,
        }
        metadata = {
            "agents": [told],
            "thirdPartyCameras": [],
            "activeAgentId": 0,
            "sequenceId": action["sequenceId"] + (self.how == "sequence!"),
        }
        frame, ids, depth = self.world.draw()
        parts = [(METADATA, msgpack.dumps(metadata)), (RGB, self.picture(frame))]
        if self.world.settings.get("renderDepthImage"):
            parts.append((DEPTH, depth[::-1].tobytes()))
        if self.world.settings.get("renderInstanceSegmentation"):
            parts.append((IDS, self.picture(ids)))
        message = b"".join(struct.pack("!BI", kind, len(body)) + body for kind, body in parts)
        if self.how in ("midmessage!", "nopicture!"):
            sent = len(message) * 2 // 3 if self.how == "midmessage!" else 5 + len(parts[0][1])
            self.out.write(message[:sent])
            self.out.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        self.out.write(message + struct.pack("!BI", END, 0))
        self.out.flush()

    def picture(self, image: NDArray[np.uint8]) -> bytes:
        """Raw bytes, bottom row first, with or without an alpha channel."""
        if self.options.channels == 4:
            image = np.dstack((image, np.full(image.shape[:2], 255, np.uint8)))
        return image[::-1].tobytes()

    def misbehave(self, *moments: str) -> None:
        if self.when not in moments or not self.how:
            return
        how, self.how = self.how, ""
        if self.options.once:
            self.options.once.touch()
        if how == "exit":
            sys.exit(3)
        elif how == "hang":
            time.sleep(60)
            sys.exit(4)
        elif how in ("garbage", "endless"):  # a field of no known type, or one of a gigabyte that never comes
            self.out.write(bytes(range(200, 250)) if how == "garbage" else struct.pack("!BI", RGB, 2**30))
            self.out.flush()
        elif how in ("sequence", "midmessage", "nopicture"):
            self.how = f"{how}!"  # in the answer
        else:
            os.kill(
                os.getpid(), {"segv": signal.SIGSEGV, "abort": signal.SIGABRT, "kill": signal.SIGKILL}[how]
            )

    def log(self, entry: dict[str, Any]) -> None:
        if self.options.log:
            with self.options.log.open("a") as file:
                file.write(json.dumps(entry) + "\n")


def check(name: str, arguments: dict[str, Any]) -> None:
    """Refuse what AI2-THOR would refuse."""
    needed, optional = NEEDED.get(name), OPTIONAL.get(name)
    if needed is None and optional is None:
        raise Refused(f"no action {name}", "InvalidAction")
    needed, optional = needed or set(), optional or set()
    if missing := needed - set(arguments):
        raise Refused(f"{name} lacks {sorted(missing)}", "MissingArguments")
    if unknown := set(arguments) - needed - optional:
        raise Refused(f"{name} does not take {sorted(unknown)}", "InvalidArgument")


def receive(source: BinaryIO) -> dict[str, Any] | None:
    """The next action; None at the end."""
    action = None
    while header := source.read(5):
        kind, length = struct.unpack("!BI", header)
        if kind == END:
            return action
        assert kind == ACTION, f"a field of type {kind}"
        action = json.loads(source.read(length))
    return None


def read_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("-screen-fullscreen")
    parser.add_argument("-screen-quality")
    parser.add_argument("-screen-width", dest="width", type=int, default=300)
    parser.add_argument("-screen-height", dest="height", type=int, default=300)
    parser.add_argument("--fail", help="HOW@WHEN")
    parser.add_argument("--once", type=Path)
    crash = float(os.environ.get("PLAYER_CRASH_PROBABILITY", 0))
    parser.add_argument("--crash-probability", type=float, default=crash)
    parser.add_argument("--channels", type=int, choices=(3, 4), default=3)
    parser.add_argument("--noise", action="store_true")
    parser.add_argument("--log", type=Path)
    options = parser.parse_args()
    if options.fail and options.fail.partition("@")[0] not in FAILURES:
        parser.error(f"--fail is one of {', '.join(FAILURES)} @ WHEN")
    return options


if __name__ == "__main__":
    try:
        Player(read_options()).play()
    except (BrokenPipeError, KeyboardInterrupt):
        sys.exit(0)
