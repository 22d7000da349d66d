"""Progress: a bar on a terminal, plain lines elsewhere, nothing where there is nothing to wait for."""

from __future__ import annotations

import io

import pytest

from activelsd import console


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_plain_lines_every_few_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    stream = io.StringIO()
    with console.progress("Rendering", stream) as show:
        for done in range(11):
            show(done, 10)
            now += 1.0
    assert stream.getvalue().splitlines() == [
        "Rendering: 0 of 10",
        "Rendering: 5 of 10, about 5 s left",
        "Rendering: 10 of 10",
    ]


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_silent_where_nothing_is_done(stream: io.StringIO) -> None:
    with console.progress("Rendering", stream):
        pass
    assert "Rendering" not in stream.getvalue()


def test_bar_on_a_terminal() -> None:
    stream = Terminal()
    with console.progress("Rendering", stream) as show:
        show(3, 10)
        show(10, 10)
    assert "10/10" in stream.getvalue()
