"""One process at a time prepares a file; the others wait."""

from __future__ import annotations

import logging
import os
import threading
from pathlib import Path

import pytest

from activelsd.envs.cache import make_once
from activelsd.errors import DataError


def test_who_waits_tries_again_after_one_that_failed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The first one's error takes the empty cache away again; the second meets the same error."""
    path, began, failed = tmp_path / "cache" / "views.h5", threading.Event(), threading.Event()
    errors: list[Exception] = []

    def make() -> None:
        began.set()
        failed.wait(30)
        raise DataError("A mesh is broken.")

    def prepare() -> None:
        try:
            make_once(path, {}, make)
        except DataError as error:
            errors.append(error)

    threads = [threading.Thread(target=prepare) for _ in range(2)]
    with caplog.at_level(logging.WARNING, "activelsd"):
        threads[0].start()
        began.wait(30)
        threads[1].start()
        while not caplog.messages:
            threads[1].join(0.01)
    failed.set()
    for thread in threads:
        thread.join()
    assert [str(error) for error in errors] == ["A mesh is broken."] * 2
    (message,) = caplog.messages
    assert message.startswith(f"Waiting for process {os.getpid()} (")
    assert message.endswith(f"), which is preparing {path}.")
    assert not path.parent.exists()
