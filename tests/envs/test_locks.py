"""Locks between processes, also where the disk or the system has none."""

from __future__ import annotations

import errno
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from activelsd.envs import locks
from activelsd.envs.locks import locked

WITHOUT = {
    "NFS without lockd": errno.ENOLCK,
    "Lustre": errno.ENOSYS,
    "another": errno.EOPNOTSUPP,
    "no fcntl": None,
}


@pytest.fixture(params=["flock", *WITHOUT])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Makes the lock of the operating system fail in one of several ways, or leaves it as it is."""
    kind: str = request.param
    if kind == "no fcntl":
        monkeypatch.setitem(sys.modules, "fcntl", None)
    elif kind != "flock":

        def flock(*_: object) -> None:
            raise OSError(WITHOUT[kind], "there are no locks")

        monkeypatch.setattr("fcntl.flock", flock)
    return kind


def silent(holder: str) -> None:
    """Waits without a word."""


def waits(path: Path, waiting: Callable[[str], None]) -> threading.Thread:
    """A thread that has waited for the lock when it ends."""

    def wait() -> None:
        with locked(path, "the second", waiting):
            pass

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


def test_one_holds_it_and_another_waits(tmp_path: Path, kind: str) -> None:
    path, asked = tmp_path / "cache" / "a.lock", threading.Event()
    heard: list[str] = []

    def waiting(holder: str) -> None:
        heard.append(holder)
        asked.set()

    with locked(path, "the first", silent):
        other = waits(path, waiting)
        assert asked.wait(30)
        other.join(0.5)
        assert other.is_alive()
    other.join(30)
    assert not other.is_alive()
    assert heard == ["the first"]
    assert list(path.parent.iterdir()) == []


@pytest.mark.parametrize("kind", ["no fcntl"], indirect=True)
def test_a_marker_that_nobody_touches_is_taken_over(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a killed process leaves it; one that is touched is respected, however long it takes."""
    monkeypatch.setattr(locks, "_ABANDONED", 0.6)
    monkeypatch.setattr(locks, "_TOUCH", 0.05)
    path, left = tmp_path / "a.lock", tmp_path / "a.lock.held"
    left.write_text("0123 process 7 (killed)")
    heard: list[str] = []
    with locked(path, "the first", heard.append):
        assert heard == ["process 7 (killed)"]
        other = waits(path, silent)
        other.join(1.5)
        assert other.is_alive()
    other.join(30)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path, kind: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"), locked(tmp_path / "file" / "a.lock", "", silent):
        pass
