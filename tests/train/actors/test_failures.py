"""Agents that raise, hang, die or are killed: the loss is said, the rest goes on, nothing stays behind."""

from __future__ import annotations

import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from activelsd.errors import TrainingError, UserError
from activelsd.policy.heads import Epsilon
from activelsd.train.actors.ga3c.batcher import BatcherThread
from activelsd.train.actors.ga3c.ga3c_actors import GA3CActors
from activelsd.train.actors.ga3c.process import EnvSpec
from activelsd.train.actors.ga3c.queues import ClosedError
from tests.train.actors.mischief import ID
from tests.train.actors.worlds import actors, spec

EPSILON = Epsilon(0.3, 0.3)


def play_on(crew: GA3CActors, lost: int) -> dict[str, float]:
    """Collect until so many agents are lost and all play again."""
    deadline, found = time.monotonic() + 60, {"ga3c/agents_lost": 0.0, "ga3c/steps_lost": 0.0}
    while True:
        rollout = crew.collect(EPSILON)
        ended = rollout.terminated | rollout.truncated
        assert bool((rollout.first[1:] == ended[:-1]).all())
        measures = crew.measures()
        for name in found:
            found[name] += measures[name]
        if found["ga3c/agents_lost"] == lost and measures["ga3c/agents"] == len(crew._predictor_state.agents):
            return found
        assert time.monotonic() < deadline


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("raise", "RuntimeError: the lamp fell over"),
        ("hang", "was silent for 3 s:\n"),
        ("die", "SIGSEGV"),
        ("exit", "exit code 3"),
    ],
)
def test_a_lost_agent_is_replaced(
    how: str, said: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    timeout = 3.0 if how == "hang" else 60.0
    crew = actors("processes", how=how, at=7, once=str(tmp_path / "done"), timeout_s=timeout)
    try:
        with caplog.at_level(logging.WARNING, "activelsd.ga3c"):
            found = play_on(crew, lost=1)
    finally:
        crew.close()
    (warning,) = caplog.messages
    assert warning.startswith("Agent ")
    assert ID in warning
    assert said in warning
    if how in ("raise", "hang", "die"):
        assert f"in _{how}" in warning  # its own traceback
    assert "started again (1 of 10 times)" in warning
    assert found["ga3c/steps_lost"] == 2.0  # of 7, 4 were a whole trajectory and the last was not taken


@pytest.mark.parametrize("lanes", [1, 2])
def test_a_killed_agent_is_replaced(lanes: int, caplog: pytest.LogCaptureFixture) -> None:
    crew = actors("processes", agents=3, envs_per_agent=2, lanes=lanes, sleep=0.001)
    try:
        crew.collect(EPSILON)
        for lost in (1, 2, 3):
            players = [agent.player for agent in crew._predictor_state.agents.values()]
            os.kill(next(p.pid for p in players if p is not None), signal.SIGKILL)  # type: ignore[attr-defined]
            play_on(crew, lost=1)
            assert len(caplog.messages) == lost
    finally:
        crew.close()
    assert "ended by itself (SIGKILL)" in caplog.text


def test_too_many_losses_end_the_training_and_name_the_agent() -> None:
    crew = actors("processes", how="raise", at=1, restarts=1, agents=1)
    with pytest.raises(
        TrainingError,
        match=r"Agent 0 \(.*Mischief-v0\) was lost 2 times, more than train.ga3c.restarts=1",
    ) as error:
        crew.collect(EPSILON)
    assert "the lamp fell over" in str(error.value)
    crew.close()


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_an_environment_that_cannot_be_made_ends_it_too(kind: str) -> None:
    crew = actors(kind, how="make", restarts=1, agents=1)
    with pytest.raises(TrainingError, match="no simulator here"):
        crew.collect(EPSILON)
    crew.close()


def test_a_thread_that_raises_is_replaced(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    crew = actors(how="raise", at=7, once=str(tmp_path / "done"))
    play_on(crew, lost=1)
    crew.close()
    assert "the lamp fell over" in caplog.text


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (EnvSpec(id="activelsd.envs:no/Such-v0", kwargs={}, tree=spec().tree), "not found"),
        (EnvSpec(id=ID, kwargs={}, tree=type(spec().tree)({"classify": ("a",)})), "are not the network's"),
    ],
)
def test_the_users_mistake_is_one_sentence_at_once(wrong: EnvSpec, said: str) -> None:
    crew = actors("processes", agents=2)
    crew._world = wrong
    with pytest.raises(UserError, match=said) as error:
        crew.collect(EPSILON)
    assert "Traceback" not in str(error.value)
    crew.close()


def open_files() -> set[str]:
    return set(os.listdir("/proc/self/fd"))  # noqa: PTH208  names are numbers here


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_closing_leaves_nothing(kind: str) -> None:
    files, threads = len(open_files()), threading.active_count()
    crew = actors(kind, agents=3)
    crew.collect(EPSILON)
    pids = [a.player.pid for a in crew._predictor_state.agents.values() if a.player and kind == "processes"]  # type: ignore[attr-defined]
    crew.close()
    crew.close()
    assert threading.active_count() == threads
    assert len(open_files()) == files
    assert not any(alive(pid) for pid in pids)


def test_closing_while_agents_start_does_not_wait_for_them() -> None:
    crew = actors("processes", agents=3, starting=1, how="stall")

    def run() -> None:
        with pytest.raises(ClosedError):
            crew.collect(EPSILON)

    runner = threading.Thread(target=run)
    runner.start()
    deadline = time.monotonic() + 60
    while not any(agent.player for agent in list(crew._predictor_state.agents.values())):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    began = time.monotonic()
    crew.close()
    runner.join(20)
    assert not runner.is_alive()
    assert time.monotonic() - began < 20


def test_closing_in_the_midst_of_starting_ends_what_has_started(monkeypatch: pytest.MonkeyPatch) -> None:
    start, made, crew = BatcherThread.start, threading.Event(), actors("threads", agents=2)

    def slowly(thread: BatcherThread) -> None:
        made.set()
        time.sleep(0.2)
        start(thread)

    def run() -> None:
        with pytest.raises(ClosedError):
            crew.collect(EPSILON)

    monkeypatch.setattr(BatcherThread, "start", slowly)
    runner = threading.Thread(target=run)
    runner.start()
    assert made.wait(20)
    crew.close()
    runner.join(20)
    assert not any(thread.is_alive() for thread in (runner, *crew._trainers, *crew._predictors))


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


SCRIPT = """
import sys
from activelsd.policy.heads import Epsilon
from tests.train.actors.worlds import actors
crew = actors("processes", agents=3, sleep=0.005)
try:
    while True:
        crew.collect(Epsilon(0.3, 0.3))
        agents = crew._predictor_state.agents.values()
        print(*[a.player.pid for a in agents if a.player], flush=True)
finally:
    crew.close()
"""


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("number", "hanging"), [(signal.SIGINT, False), (signal.SIGKILL, False), (signal.SIGKILL, True)]
)
def test_nothing_outlives_the_parent(number: signal.Signals, hanging: bool) -> None:
    script = SCRIPT.replace("sleep=0.005", 'how="hang", at=40') if hanging else SCRIPT
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    pids: list[int] = []
    while len(pids) < 3:
        pids = [int(word) for word in process.stdout.readline().split()]
    assert all(alive(pid) for pid in pids)
    for pid in (process.pid, *pids):  # what has no name there is not left there
        assert "/dev/shm/" not in Path(f"/proc/{pid}/maps").read_text()
    if hanging:
        while select.select([process.stdout], [], [], 1.0)[0]:
            process.stdout.readline()
    process.send_signal(number)
    process.wait(60)
    process.stdout.close()
    deadline = time.monotonic() + 60
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.05)
