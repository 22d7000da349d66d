"""A wheel installed elsewhere works as the checkout does, presets included."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.skipif(
    not all(importlib.util.find_spec(name) for name in ("hatchling", "pip")), reason="needs hatchling and pip"
)
def test_wheel_in_a_fresh_environment_finds_its_presets(tmp_path: Path) -> None:
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=ROOT)
    (wheel,) = tmp_path.glob("activelsd-*.whl")

    # A new environment that borrows the dependencies here, so that nothing is downloaded; path files inside
    # borrowed folders are not read, so an editable install of this checkout stays out of sight.
    home, elsewhere = tmp_path / "environment", tmp_path / "elsewhere"
    venv.create(home, with_pip=False, symlinks=True)
    paths = {"base": str(home), "platbase": str(home)}
    packages = Path(sysconfig.get_path("purelib", "venv", paths))
    scripts = Path(sysconfig.get_path("scripts", "venv", paths))
    (packages / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install = ("install", "-q", "--no-deps", "--no-index", "--disable-pip-version-check", wheel)
    run(sys.executable, "-m", "pip", "--python", scripts / "python", *install, cwd=tmp_path)

    elsewhere.mkdir()
    where = run(scripts / "python", "-c", "import activelsd; print(activelsd.__file__)", cwd=elsewhere)
    assert Path(where.strip()).is_relative_to(packages)
    printed = run(scripts / "activelsd", "train", "experiment=paper", "--dry-run", cwd=elsewhere)
    assert "kind: alexnet" in printed
    assert not list(elsewhere.iterdir())
