"""Transfer between worlds: compares training from scratch with training from another world's weights.

For each seed, one run is trained in the first world and two in the second: one from scratch and one from the
first run's weights. Both are evaluated on the validation split at the same steps. The table shows the
learning curves: mean over seeds ± 95 % interval (Student's t), and the mean paired difference in the last
column.

    python benchmarks/transfer.py "env=modelnet env.dataset.classes=[bed,sofa]" "env=modelnet" --seeds 3
"""

from __future__ import annotations

import argparse
import json
import shlex
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from activelsd.compose import resolve
from activelsd.launch import begin

STUDENT = {2: 12.706, 3: 4.303, 4: 3.182, 5: 2.776, 6: 2.571, 7: 2.447, 8: 2.365, 9: 2.306, 10: 2.262}
"""Student's t for a 95 % interval, by number of seeds."""


def train(words: Sequence[str], folder: Path) -> Path:
    """Trains a run and returns its folder."""
    return begin(resolve([*words, f"runs={folder}", "train.loggers=[]"]))


def curve(run: Path, figure: str) -> dict[int, float]:
    """A validation metric by training step."""
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return {row["step"]: row[f"val/{figure}"] for row in rows if f"val/{figure}" in row}


def interval(values: Sequence[float]) -> str:
    """Mean ± half width of its 95 % interval."""
    half = STUDENT[len(values)] * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values):7.3f} ± {half:.3f}"


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", help="settings of the first world, as one quoted argument")
    parser.add_argument("second", help="settings of the second world, as one quoted argument")
    parser.add_argument("--seeds", type=int, default=3, choices=sorted(STUDENT))
    parser.add_argument("--runs", type=Path, help="folder to keep the runs in; by default they are deleted")
    options = parser.parse_args()
    figures = ("accuracy", "accuracy_at_first_view", "views")
    curves: dict[str, list[tuple[dict[int, float], dict[int, float]]]] = {name: [] for name in figures}
    with tempfile.TemporaryDirectory() as folder:
        runs = options.runs or Path(folder)
        for seed in range(options.seeds):
            learned = train([*shlex.split(options.first), f"seed={seed}", f"name=first-{seed}"], runs)
            words = [*shlex.split(options.second), f"seed={seed}"]
            fresh = train([*words, f"name=fresh-{seed}"], runs)
            started = train([*words, f"name=started-{seed}", f"policy.init={learned}"], runs)
            for figure, pairs in curves.items():
                pairs.append((curve(fresh, figure), curve(started, figure)))
    print(f"{options.seeds} seeds: first {options.first}; then {options.second}")
    for figure, pairs in curves.items():
        print(f"\n{'val/' + figure:>32}{'fresh':>19}{'started':>19}{'difference':>19}")
        for step in pairs[0][0]:
            fresh_values, started_values = [a[step] for a, _ in pairs], [b[step] for _, b in pairs]
            differences = [b - a for a, b in zip(fresh_values, started_values, strict=True)]
            columns = [interval(values) for values in (fresh_values, started_values, differences)]
            print(f"{step:>25} steps " + "  ".join(f"{column:>17}" for column in columns))


if __name__ == "__main__":
    main()
