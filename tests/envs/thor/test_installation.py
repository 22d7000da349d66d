"""What is missing for AI2-THOR is said in a sentence that mends it, before anything is started."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import pytest
from clients import controller, player

from activelsd import doctor
from activelsd.envs.thor import installation
from activelsd.envs.thor.client import GuardedController
from activelsd.errors import ConfigError, DataError, UserError

INSTEAD = "env.backend=standin works without AI2-THOR."


def refusal(thor: GuardedController, kind: type[UserError] = ConfigError) -> str:
    """The sentence with which a simulator is not started."""
    with pytest.raises(kind) as caught:
        thor.reset("FloorPlan1")
    said = str(caught.value)
    assert type(caught.value) is kind
    assert "\n" not in said
    assert said.endswith(INSTEAD)
    return said


def report() -> dict[str, str]:
    return {finding.what: finding.state for finding in doctor.examine(Path("runs"))}


def test_without_the_client(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "ai2thor" else find(name))
    said = refusal(controller())
    assert "pip install 'activelsd[thor]' && pip install --no-deps ai2thor" in said
    assert "pip install 'activelsd[thor]'" in report()["AI2-THOR"]


@pytest.mark.thor
def test_without_a_build(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation, "has_vulkan", lambda: True)
    said = refusal(GuardedController(), DataError)
    command = installation.download_command("CloudRendering")
    assert command in said
    assert "download_only=True" in command
    assert command in report()["AI2-THOR build"]


@pytest.mark.thor
def test_with_a_build(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from ai2thor.build import COMMIT_ID

    monkeypatch.setattr(installation, "has_vulkan", lambda: True)
    build = tmp_path / "home" / ".ai2thor" / "releases" / f"thor-CloudRendering-{COMMIT_ID}"
    build.mkdir(parents=True)
    assert installation.launch_options(None, None, None, None)["platform"] == "CloudRendering"
    assert report()["AI2-THOR build"] == str(build)
    # That the build's metadata and executable are gone is found by the client; it must not look elsewhere.
    refusal(GuardedController())


@pytest.mark.thor
def test_without_anything_to_draw_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation, "has_vulkan", lambda: False)
    assert "apt install libvulkan1" in refusal(GuardedController())
    assert "DISPLAY is not set" in refusal(GuardedController(platform="Linux64"))
    assert "DISPLAY is not set" in refusal(GuardedController(executable=player()))
    assert report()["AI2-THOR display"].startswith("no DISPLAY")


@pytest.mark.thor
def test_a_platform_there_is_not() -> None:
    assert "did you mean Linux64?" in refusal_of_platform("Linux46")


def refusal_of_platform(name: str) -> str:
    with pytest.raises(ConfigError) as caught:
        GuardedController(platform=name).reset("FloorPlan1")
    return str(caught.value)


@pytest.mark.thor
def test_with_a_card_that_cannot_be_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    assert "needs vulkaninfo and nvidia-smi to look up gpu_device=1" in refusal(
        GuardedController(gpu_device=1)
    )
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    assert "CUDA_VISIBLE_DEVICES=0,1" in refusal(GuardedController())


@pytest.mark.thor
def test_with_a_home_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    assert "set HOME" in refusal(controller())


@pytest.mark.thor
@pytest.mark.parametrize("executable", ["/nowhere/thor", "thor --no 'end", ""])
def test_with_an_executable_that_is_not_there(executable: str) -> None:
    assert "is missing or not executable" in refusal(GuardedController(executable=executable, x_display=":0"))


@pytest.mark.thor
def test_with_an_executable_that_is_no_program(tmp_path: Path) -> None:
    program = tmp_path / "a thor"  # with a blank, which is no end of a word
    program.write_bytes(b"\x00\x01")
    program.chmod(0o755)
    said = refusal(GuardedController(executable=str(program), x_display=":0"))
    assert said.startswith("AI2-THOR cannot be started: OSError")
    assert "a thor" in said
