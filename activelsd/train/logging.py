"""Writes metrics: always to `metrics.jsonl` and the screen, and to loggers by name, such as TensorBoard."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Protocol

from activelsd import registry

METRICS = "metrics.jsonl"


class Logger(Protocol):
    """Writes rows of metrics; one found by name is called with the run's folder."""

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Write the metrics of a step."""

    def close(self) -> None:
        """Close files."""


class JsonLines:
    """Writes one JSON object per row and flushes it at once, so that it survives a kill."""

    def __init__(self, path: Path, *, up_to: int) -> None:
        """Open for appending; drops rows after step `up_to`, which a resumed run writes again."""
        kept = [json.dumps(row) + "\n" for row in read_metrics(path) if row["step"] <= up_to]
        temporary = path.with_name(path.name + ".tmp")
        temporary.write_text("".join(kept), "utf-8")
        temporary.replace(path)
        self._file = path.open("a", encoding="utf-8")

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Append a row."""
        self._file.write(json.dumps({"step": step, **metrics}) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_metrics(path: Path) -> list[dict[str, float]]:
    """Returns the rows of a `metrics.jsonl`, but not a last one that a kill cut off; none without a file."""
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


class TensorBoard:
    """Writes scalars for TensorBoard into the folder `tensorboard` of the run."""

    def __init__(self, folder: Path) -> None:
        """Open for appending; hides what was logged after the last row of `metrics.jsonl`."""
        from torch.utils.tensorboard import SummaryWriter

        file = folder / METRICS
        rows = file.read_text("utf-8").splitlines() if file.exists() else []
        purge = json.loads(rows[-1])["step"] + 1 if rows else None
        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=purge)

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Add each metric as a scalar."""
        for name, value in metrics.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close."""
        self._writer.close()


class ProgressLine:
    """One dense line: redrawn in place on a terminal, written every ten seconds elsewhere."""

    def __init__(self, total: int, stream: IO[str] | None = None) -> None:
        self._total, self._stream = total, stream or sys.stderr
        self._live = self._stream.isatty()
        self._shown = -10.0

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Show the share of the steps that is done, and the main metrics."""
        soon = not self._live and time.monotonic() - self._shown < 10.0 and step < self._total
        if "reward" not in metrics or soon:
            return
        self._shown = time.monotonic()
        # The last update may end after the last step.
        left = int(max(self._total - step, 0) / max(metrics["steps_per_second"], 1e-9))
        line = (
            f"{min(step / self._total, 1):4.0%} {step // 1000}k  reward {metrics['reward']:5.2f}  "
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
    """The loggers of a run that goes on at step `up_to`, of `total` steps.

    Raises:
        UnknownPartError: there is no logger of a name.
    """
    makers = [registry.loggers.get(name) for name in names]
    # `metrics.jsonl` first: others read there at which step the run goes on.
    own: list[Logger] = [JsonLines(folder / METRICS, up_to=up_to), ProgressLine(total)]
    for name, make in zip(names, makers, strict=True):
        with registry.loggers.blaming(name, "cannot be made"):
            own.append(make(folder))
    return own
