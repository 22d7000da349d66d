"""Work spread over processes: results, errors, and what becomes of the processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from activelsd.envs.workers import Item, Work, spread
from activelsd.errors import ActiveLSDError, CacheError, ConfigError
from activelsd.registry import UnknownPartError
from activelsd.subprogram import NUMBER


@contextmanager
def maker(job: Mapping[str, Any]) -> Iterator[Work]:
    """Notes its process, does what an item says, and notes its end."""
    folder = Path(job["folder"])
    (folder / f"begin {os.getpid()}").touch()

    def work(item: Item) -> bytes:
        match item.get("do"):
            case "misspell":
                raise UnknownPartError("world", "mars", ["earth"])
            case "full":
                raise CacheError("There is no room.")
            case "crash":
                raise ZeroDivisionError("by nothing")
            case "die":
                os.kill(os.getpid(), signal.SIGKILL)
            case "sleep":
                (folder / f"child {subprocess.Popen(['sleep', '600']).pid}").touch()
                time.sleep(600)
        sys.stdout.write("to be overheard\n")
        return json.dumps([item["name"], os.getpid(), os.environ.get(NUMBER)]).encode()

    yield work
    (folder / f"end {os.getpid()}").touch()


def done(folder: Path, items: list[dict[str, str]], processes: int = 2) -> dict[int, list[Any]]:
    work = spread(f"{__name__}:maker", {"folder": str(folder)}, enumerate(items), processes=processes)
    with closing(work):
        return {number: json.loads(result) for number, result in work}


def named(*does: str) -> list[dict[str, str]]:
    return [{"name": f"item {i}", "do": do} for i, do in enumerate(does)]


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_every_item_is_done_once(tmp_path: Path, processes: int) -> None:
    found = done(tmp_path, named(*["work"] * 20), processes)
    assert {number: name for number, (name, *_) in found.items()} == {i: f"item {i}" for i in range(20)}
    by = {pid: number for _, pid, number in found.values()}
    if processes == 1:
        assert by == {os.getpid(): os.environ.get(NUMBER)}
    else:
        assert sorted(by.values()) == [str(i) for i in range(processes)]
        assert os.getpid() not in by
    assert {path.name for path in tmp_path.glob("*")} == {
        f"{word} {p}" for p in by for word in ("begin", "end")
    }


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize(
    ("do", "error", "sentence"),
    [
        ("misspell", ConfigError, "There is no world 'mars'; there are earth."),
        ("full", CacheError, "There is no room."),
    ],
)
def test_a_users_mistake_is_the_same_sentence(
    tmp_path: Path, do: str, error: type[ActiveLSDError], sentence: str, processes: int
) -> None:
    with pytest.raises(error) as raised:
        done(tmp_path, named("work", do, "work"), processes)
    assert str(raised.value) == sentence
    assert raised.value.exit_code == 2


def test_a_crash_comes_with_its_traceback(tmp_path: Path) -> None:
    with pytest.raises(
        RuntimeError, match=r"(?s)Preparing item 1 failed:\nTraceback.*ZeroDivisionError: by noth"
    ):
        done(tmp_path, named("work", "crash"))


def test_a_death_is_told(tmp_path: Path) -> None:
    with pytest.raises(ActiveLSDError, match=r"process that prepared item 1 ended by itself \(code -9\)"):
        done(tmp_path, named("work", "die"))


def test_closing_kills_processes_and_what_they_started(tmp_path: Path) -> None:
    work = spread(
        f"{__name__}:maker", {"folder": str(tmp_path)}, enumerate(named("work", "sleep")), processes=2
    )
    next(work)
    while not list(tmp_path.glob("child *")):
        time.sleep(0.01)
    work.close()
    for path in tmp_path.glob("child *"):
        assert not alive(int(path.name.split()[1]))


def alive(pid: int) -> bool:
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return state.stdout.strip()[:1] not in ("", "Z")


def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    """Also from a script without a main guard, read from standard input."""
    code = f"""
from activelsd.envs.workers import spread
items = [(i, {{"name": "x"}}) for i in range(4)]
for number, _ in spread("{__name__}:maker", {{"folder": {str(tmp_path)!r}}}, items, processes=2):
    print(number, flush=True)
import os
endless = iter(lambda: (0, {{"name": "x"}}), 0)
work = spread("{__name__}:maker", {{"folder": {str(tmp_path)!r}}}, endless, processes=2)
next(work)
os.kill(os.getpid(), 9)
"""
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    found = subprocess.run(
        [sys.executable, "-"], input=code, text=True, env=env, capture_output=True, check=False
    )
    assert found.returncode == -signal.SIGKILL, found.stderr
    assert sorted(found.stdout.split()) == ["0", "1", "2", "3"]
    pids = {int(path.name.split()[1]) for path in tmp_path.glob("begin *")}
    assert len(pids) >= 3
    deadline = time.monotonic() + 20
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.05)
