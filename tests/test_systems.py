"""Systems other than Linux, as far as they can be tried here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from activelsd.compose import resolve
from activelsd.errors import ConfigError

TESTS = Path(__file__).parent

PROGRAM = """
from activelsd.cli import main

world = ["env=modelnet", "env.size=32", "env.dataset.train_per_class=5", "env.dataset.test_per_class=2"]
small = ["policy.trunk.features=8", "train.envs=8", "train.steps=160", "train.checkpoint_every=80"]
assert main(["doctor"]) == 0
assert main(["prepare", *world]) == 0
assert main(["train", *world, *small, "device=cpu", "threads=1"]) == 0
assert main(["compare", "--baselines", "no_move"]) == 0
print("all done")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_system_without_what_windows_lacks_prepares_trains_and_compares(tmp_path: Path) -> None:
    """No fcntl, fork or killpg; open files cannot be removed; processes that render are as strict."""
    (tmp_path / "sitecustomize.py").write_text("import windows\n\nwindows.install()\n", "utf-8")
    paths = [str(tmp_path), str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "PYTHONWARNDEFAULTENCODING": "1",
        "PYTHONIOENCODING": "cp1252",
        "ACTIVELSD_CACHE": str(tmp_path / "cache"),
    }
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, env=environment, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    assert done.stdout.endswith(b"all done\n")
    assert not list((tmp_path / "cache").glob("*.lock*"))


def test_agents_in_processes_are_refused_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(ConfigError, match=r"needs Linux or macOS; set train\.ga3c\.kind=threads"):
        resolve(["env=modelnet", "train.actors=ga3c"])
    assert (
        resolve(["env=modelnet", "train.actors=ga3c", "train.ga3c.kind=threads"]).train.ga3c.kind == "threads"
    )
