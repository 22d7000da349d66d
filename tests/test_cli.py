"""The command line: what it answers, to whom, and with which exit code."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from activelsd import cli
from activelsd.errors import TrainingError

HEAVY = {"torch", "cv2", "trimesh", "gymnasium", "matplotlib", "numpy", "pydantic", "h5py"}


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    code = (
        "import sys; from activelsd.cli import main\n"
        "try: main(['--help'])\n"
        f"finally: print('HEAVY', sorted({HEAVY!r} & set(sys.modules)))"
    )
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    took = time.monotonic() - began
    assert "compare" in done.stdout
    assert "HEAVY []" in done.stdout
    assert took < 2.0  # 0.1 s on an idle machine


@pytest.mark.parametrize(
    "words",
    [
        "train env=modlnet",
        "train env=thor env.strts.per_target=1",
        "train env=modelnet env.navigate=orbit_cww",
        "train env=modelnet policy.trunk=compct",
        "compare --baselines randm_walk",
        "compare splt=val",
    ],
)
def test_a_mistyped_word_is_answered_before_anything_heavy_is_imported(words: str) -> None:
    code = (
        f"import sys; from activelsd.cli import main; code = main({words.split()!r})\n"
        "print(code, sorted({'torch', 'numpy', 'gymnasium', 'h5py'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "2 []\n"


@pytest.mark.parametrize(
    ("given", "spins"),
    [({}, "1000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "active"}, None)],
)
def test_pytorchs_threads_do_not_spin_long_unless_told_to(given: dict[str, str], spins: str | None) -> None:
    code = (
        "import os, sys; from activelsd.cli import main; assert 'torch' not in sys.modules;"
        "main(['train', '--dry-run', 'env=modelnet']); print(os.environ.get('GOMP_SPINCOUNT'))"
    )
    others = {k: v for k, v in os.environ.items() if k not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=others | given, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == str(spins)


def test_exit_codes_of_the_process() -> None:
    command = [sys.executable, "-m", "activelsd"]
    wrong = subprocess.run([*command, "train", "env=modlnet"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert wrong.stderr == "activelsd: There is no world 'modlnet'; did you mean modelnet?\n"
    assert wrong.stdout == ""
    # A reader that has gone is no reason for a traceback.
    piped = subprocess.Popen(
        [*command, "train", "env=modelnet", "--dry-run"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert piped.stdout is not None
    assert piped.stderr is not None
    piped.stdout.close()
    assert piped.stderr.read() == b""
    assert piped.wait() == cli.BROKEN_PIPE
    piped.stderr.close()


@pytest.mark.parametrize(
    ("argv", "sentence"),
    [
        ("trian env=modelnet", "There is no verb 'trian'; did you mean train?"),
        ("xyz", "There is no verb 'xyz'; there are train, "),
        (
            "train env=modelnet --resum x",
            "--resum is not an option of activelsd train; did you mean --resume?",
        ),
        ("train env=modelnet --dry", "--dry is not an option of activelsd train; did you mean --dry-run?"),
        ("train env=modelnet train.gama=1", "train.gama is not a setting; did you mean train.gamma?"),
        ("train --resume", "argument --resume: expected one argument; see activelsd --help."),
        ("train --resume nowhere", "nowhere is not a run: "),
        ("train --resume a --sweep seed=1,2", "--resume goes on with one run and --sweep begins several"),
        ("prepare", "No world is named; add env=modelnet"),
        (
            "prepare env=modelnet env.navigate=orbit_cww",
            "The ModelNet world has no move 'orbit_cww'; did you",
        ),
        ("prepare env=modelnet env.navigate=orbit_up", "'orbit_up' needs more than one elevation"),
        ("train env=modelnet env.dataset.path=/nowhere/at/all", ""),
        (
            "compare --baselines random_walk",
            "There is no run in ./runs; train one with: activelsd train env=modelnet",
        ),
        ("compare --baselines randm_walk", ""),
        ("evaluate", "There is no run in ./runs; train one with: activelsd train env=modelnet"),
        ("evaluate nowhere", "nowhere is not a run: "),
        ("envs all", "activelsd envs takes no words, and was given 'all'."),
    ],
)
def test_users_mistakes_are_one_sentence_and_exit_code_2(
    argv: str,
    sentence: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(argv.split()) == 2
    out, err = capsys.readouterr()
    assert err.startswith(f"activelsd: {sentence}")
    assert err.count("\n") == 1
    assert out == ""
    assert not list(tmp_path.iterdir())


def test_dry_run_prints_the_resolved_config_and_does_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        cli.main(["train", "experiment=demo", "--sweep", "seed=0,1,2", "train.gamma=0.9", "--dry-run"]) == 0
    )
    configs = list(yaml.safe_load_all(capsys.readouterr().out))
    assert [config["seed"] for config in configs] == [0, 1, 2]
    assert {config["train"]["gamma"] for config in configs} == {0.9}
    assert not list(tmp_path.iterdir())


def test_prepare_fills_the_cache_it_is_told_and_says_what_there_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    few = ["env.dataset.classes=cup,vase", "env.dataset.train_per_class=2", "env.dataset.test_per_class=1"]
    assert cli.main(["prepare", "env=modelnet", "env.cache=here", *few]) == 0
    said = capsys.readouterr().out.splitlines()
    views = 6 * 12
    assert said == [
        "6 objects of 2 classes",
        f"{views} views of 64 pixels",
        "Starts of episodes: 24 train, 24 val, 24 test",
    ]
    (file,) = (tmp_path / "here").iterdir()
    assert file.suffix == ".h5"


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (TrainingError("The loss is gone."), 1, "activelsd: The loss is gone.\n"),
        (KeyboardInterrupt(), 130, "Stopped"),
    ],
)
def test_failures_and_interrupts(
    error: BaseException,
    code: int,
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: object) -> int:
        raise error

    monkeypatch.setitem(cli.VERBS, "doctor", cli.VERBS["doctor"]._replace(run=fail))
    assert cli.main(["doctor"]) == code
    assert said in capsys.readouterr().err


def test_own_bugs_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> int:
        raise ZeroDivisionError

    monkeypatch.setitem(cli.VERBS, "doctor", cli.VERBS["doctor"]._replace(run=fail))
    with pytest.raises(ZeroDivisionError):
        cli.main(["doctor"])


def test_envs_and_doctor_report(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["envs"]) == 0
    listed = capsys.readouterr().out
    assert 'activelsd/World-v0 world="modelnet"' in listed
    assert "orbit_cw" in listed
    assert cli.main(["doctor"]) in (0, 1)
    report = capsys.readouterr().out
    for what in ("python", "cores", "device", "cache", "newest run"):
        assert what in report
    assert "none in ./runs" in report
    assert not list(tmp_path.iterdir())
