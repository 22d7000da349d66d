"""Where metrics go: `metrics.jsonl` always, TensorBoard, a line on the screen, and others by entry point."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import IO, Protocol

from activelsd.errors import ConfigError

LOGGERS = "activelsd.loggers"
"""Entry-point group of further loggers: callables that take the run's folder and give a `Logger`."""


class Logger(Protocol):
    """Takes rows of metrics."""

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Take the metrics of a step."""

    def close(self) -> None:
        """Let go of files."""


class JsonLines:
    """One JSON object a row, flushed at once, so that what was written survives a kill."""

    def __init__(self, path: Path, *, up_to: int) -> None:
        """Open for appending; rows after step `up_to`, which a resumed run writes again, are dropped."""
        kept = []
        if path.exists():
            lines = path.read_text().splitlines()
            kept = [line for line in lines if line.endswith("}") and json.loads(line)["step"] <= up_to]
        temporary = path.with_name(path.name + ".tmp")
        temporary.write_text("".join(line + "\n" for line in kept))
        temporary.replace(path)
        self._file = path.open("a")

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Append a row."""
        self._file.write(json.dumps({"step": step, **metrics}) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class TensorBoard:
    """Scalars for TensorBoard, in the run's folder `tensorboard`."""

    def __init__(self, folder: Path, *, up_to: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=up_to + 1 if up_to else None)

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Add each metric as a scalar."""
        for name, value in metrics.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close."""
        self._writer.close()


class ProgressLine:
    """One dense line: redrawn in place on a terminal, a line every ten seconds elsewhere."""

    def __init__(self, total: int, stream: IO[str] | None = None) -> None:
        self._total, self._stream = total, stream or sys.stderr
        self._live = self._stream.isatty()
        self._shown = -10.0

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Show how far training is and how it goes."""
        soon = not self._live and time.monotonic() - self._shown < 10.0 and step < self._total
        if "reward" not in metrics or soon:
            return
        self._shown = time.monotonic()
        left = int((self._total - step) / max(metrics["steps_per_second"], 1e-9))
        line = (
            f"{step / self._total:4.0%} {step // 1000}k  reward {metrics['reward']:5.2f}  "
            f"acc {metrics['accuracy']:4.0%}  views {metrics['views']:4.1f}  "
            f"nav {metrics['navigate']:.2f}  {metrics['steps_per_second']:.0f}/s  "
            f"left {left // 60}:{left % 60:02d}"
        )
        self._stream.write(f"\r{line[:79]:79}" if self._live else line + "\n")
        self._stream.flush()

    def close(self) -> None:
        """End the line."""
        if self._live and self._shown >= 0:
            self._stream.write("\n")


def open_loggers(names: Sequence[str], folder: Path, *, up_to: int, total: int) -> list[Logger]:
    """The loggers of a run.

    Raises:
        ConfigError: a name is neither `tensorboard` nor an installed entry point.
    """
    loggers: list[Logger] = [JsonLines(folder / "metrics.jsonl", up_to=up_to), ProgressLine(total)]
    for name in names:
        if name == "tensorboard":
            loggers.append(TensorBoard(folder, up_to=up_to))
            continue
        found = entry_points(group=LOGGERS, name=name)
        if not found:
            raise ConfigError(f"There is no logger '{name}'; use tensorboard or install one as '{LOGGERS}'.")
        loggers.append(next(iter(found)).load()(folder))
    return loggers
