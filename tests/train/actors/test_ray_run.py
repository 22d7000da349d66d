"""A run with Ray from the command line, in a cluster that is started for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from activelsd import launch
from activelsd.compose import resolve
from activelsd.errors import ConfigError
from activelsd.train.run import Run
from tests.train.actors.ray_pool import REASON
from tests.train.actors.test_failures import alive

WORDS = [
    *(
        "env=modelnet",
        "env.colour=rgb",
        "env.size=32",
        "env.dataset.classes=cup,sofa",
        "env.dataset.train_per_class=2",
    ),
    *("env.dataset.test_per_class=1", "device=cpu", "policy.trunk.features=8", "train.loggers=[]"),
    *(
        "train.actors=ray",
        "train.ray.workers=2",
        "train.ray.envs_per_worker=2",
        "train.evaluate_every=10000000",
    ),
    *("train.checkpoint_every=100", "train.log_every=100"),
]


def children(parent: int) -> list[int]:
    """All processes that descend from one."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(FileNotFoundError, ProcessLookupError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
    found, grown = {parent}, True
    while grown:
        more = {pid for pid, of in parents.items() if of in found} - found
        found, grown = found | more, bool(more)
    return sorted(found - {parent})


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_the_cluster_started_for_a_run_ends_at_ctrl_c_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray", reason=REASON)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(Path(launch.__file__).parents[1])
    process = subprocess.Popen(
        [sys.executable, "-m", "activelsd", "train", *WORDS, "train.steps=100000000"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    while not (checkpoints := list(tmp_path.glob("runs/*/checkpoints/[0-9]*"))):
        assert process.poll() is None
        time.sleep(0.05)
    folder, started = checkpoints[0].parents[1], children(process.pid)
    assert len(started) > 3
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    said = process.communicate(timeout=60)[1].decode()
    assert process.returncode == 130
    assert said.splitlines()[-1].endswith(f"activelsd train --resume runs/{folder.name}")
    assert "Traceback" not in said
    assert not any(alive(pid) for pid in started)

    before = set(children(os.getpid()))
    reached = int(Run(folder).checkpoint.name)
    launch.resume(folder, [f"train.steps={reached + 200}"])
    assert int(Run(folder).checkpoint.name) >= reached + 200
    assert not any(alive(pid) for pid in set(children(os.getpid())) - before)


def test_v_trace_comes_with_ray_and_is_not_turned_off() -> None:
    assert resolve(WORDS).train.corrects_lag
    assert not resolve([*WORDS, "train.actors=ga3c"]).train.corrects_lag
    with pytest.raises(ConfigError, match=r"^train\.vtrace=false would leave the lag of train\.actors=ray"):
        resolve([*WORDS, "train.vtrace=false"])
    with pytest.raises(ConfigError, match=r"^train\.ray\.envs_per_worker=1 leaves a world of 2 without any"):
        resolve(["env=modelnet,avd", "train.actors=ray", "env.size=64", "train.ray.envs_per_worker=1"])
