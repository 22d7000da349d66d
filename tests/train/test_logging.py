"""Loggers: found by name, made from the run's folder alone, and continued where a run is."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from activelsd import registry
from activelsd.registry import UnknownPartError
from activelsd.train.logging import ProgressLine, open_loggers

ROW = {"reward": 0.5, "accuracy": 0.25, "views": 2.0, "navigate": 0.1, "steps_per_second": 10.0}


class Notes:
    """A logger as another package may bring."""

    def __init__(self, folder: Path) -> None:
        self.file = (folder / "notes").open("a")

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        self.file.write(f"{step} {metrics['reward']}\n")

    def close(self) -> None:
        self.file.close()


def test_loggers_are_found_by_name_and_made_from_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry.loggers, "_added", {"notes": Notes})
    loggers = open_loggers(["notes"], tmp_path, up_to=0, total=10)
    for logger in loggers:
        logger.write(5, ROW)
        logger.close()
    assert (tmp_path / "notes").read_text() == "5 0.5\n"
    assert json.loads((tmp_path / "metrics.jsonl").read_text()) == {"step": 5, **ROW}


def test_an_unknown_logger_is_one_sentence_before_a_file_is_touched(tmp_path: Path) -> None:
    with pytest.raises(UnknownPartError, match=r"no logger 'tensorbord'; did you mean tensorboard\?"):
        open_loggers(["tensorbord"], tmp_path, up_to=0, total=10)
    assert not list(tmp_path.iterdir())


def test_tensorboard_hides_what_a_resumed_run_logs_again(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    for up_to, steps, reward in ((0, (100, 200, 300), 0.0), (200, (300, 400), 1.0)):
        loggers = open_loggers(["tensorboard"], tmp_path, up_to=up_to, total=400)
        for logger in loggers:
            for step in steps:
                logger.write(step, ROW | {"reward": reward})
            logger.close()
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [(e.step, e.value) for e in events.Scalars("reward")] == [(100, 0), (200, 0), (300, 1), (400, 1)]


def test_the_progress_line_stays_within_the_steps_asked_for() -> None:
    """The last update of a short run may end past its last step."""
    stream = io.StringIO()
    line = ProgressLine(100, stream)
    line.write(120, ROW)
    assert stream.getvalue().startswith("100% ")
    assert stream.getvalue().endswith("left 0:00\n")
