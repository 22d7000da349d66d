"""Checks what AI2-THOR needs on this machine: its client, a simulator build, and a display or GPU."""

from __future__ import annotations

import ctypes.util
import importlib.util
import os
import platform as machine
import shlex
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any

from activelsd.errors import ConfigError, DataError, did_you_mean

INSTALL = "pip install 'activelsd[thor]' && pip install --no-deps ai2thor==5.0.0"
"""Installs it without dependencies: its `opencv-python` would overwrite `opencv-python-headless`."""

HOME = Path("~/.ai2thor")
"""Where the client keeps builds and logs; only the variable HOME can move it."""

INSTEAD = "env.backend=standin works without AI2-THOR"
"""The end of every sentence about something missing."""


def load_controller() -> Any:
    """AI2-THOR's class `Controller`.

    Raises:
        ConfigError: the client is not installed or is incomplete.
    """
    if importlib.util.find_spec("ai2thor") is None:
        raise ConfigError(f"AI2-THOR's client is not installed; run: {INSTALL}; {INSTEAD}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # newer Python versions warn about escapes in its source
            from ai2thor.controller import Controller
    except ImportError as error:
        raise ConfigError(f"AI2-THOR's client is incomplete ({error}); run: {INSTALL}; {INSTEAD}.") from None
    return Controller


def download_command(platform: str) -> str:
    """A shell command that downloads a platform's build, about 800 MB."""
    call = f"Controller(download_only=True, platform='{platform}')"
    return f'python -c "from ai2thor.controller import Controller; {call}"'


def find_build(platform: str) -> Path | None:
    """The folder of the downloaded build for the installed client; None if there is none."""
    load_controller()
    from ai2thor.build import COMMIT_ID, build_name

    folder = HOME.expanduser() / "releases" / build_name(platform, COMMIT_ID)
    return folder if folder.is_dir() else None


def has_vulkan() -> bool:
    """Whether the Vulkan loader is installed, which the platform CloudRendering needs."""
    return ctypes.util.find_library("vulkan") is not None


def choose_platform(x_display: str | None = None) -> str:
    """The default platform; on Linux it depends on whether there is a display."""
    if machine.system() == "Darwin":
        return "OSXIntel64"
    return "Linux64" if x_display or os.environ.get("DISPLAY") else "CloudRendering"


def launch_options(
    executable: str | None, platform: str | None, x_display: str | None, gpu_device: int | None
) -> dict[str, Any]:
    """Keyword arguments for `Controller` on what to start and where to render, after checking that it exists.

    Args:
        executable: path or command line of another simulator; None for the downloaded build.
        platform: the build's platform, `Linux64`, `CloudRendering` or `OSXIntel64`; None for the default.
        x_display: X display such as `:0`; None for the environment's DISPLAY.
        gpu_device: CUDA index of the GPU that CloudRendering renders on; None for the first.

    Raises:
        ConfigError: something is missing that the user can set or install.
        DataError: the build is not downloaded.
    """
    load_controller()
    _check_home()
    _check_card(gpu_device)
    options: dict[str, Any] = {"x_display": x_display, "gpu_device": gpu_device}
    if executable is not None:
        if choose_platform(x_display) == "CloudRendering":  # the client needs a display name
            raise ConfigError(
                "AI2-THOR's client needs a display to start an executable, but DISPLAY is not set; set it, to"
                f" any name such as :0 if the executable needs no display; {INSTEAD}."
            )
        return options | {"local_executable_path": _command(executable)}
    platform = platform or choose_platform(x_display)
    _check_platform(platform, x_display)
    if find_build(platform) is None:
        command = download_command(platform)
        raise DataError(f"AI2-THOR's build for {platform} is not downloaded; run: {command}; {INSTEAD}.")
    return options | {"platform": platform}


def _check_home() -> None:
    folder = HOME.expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(
            f"AI2-THOR's client cannot write to {folder} ({error.strerror}); make it writable or set HOME to"
            f" a writable folder; {INSTEAD}."
        ) from None


def _check_card(gpu_device: int | None) -> None:
    """Raises ConfigError if a GPU is chosen in any way and the client could not look it up."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    # The client treats any number in this variable as a choice, whatever it starts.
    chosen = gpu_device is not None or any(part.strip().isdigit() for part in visible.split(","))
    missing = [tool for tool in ("vulkaninfo", "nvidia-smi") if shutil.which(tool) is None]
    if chosen and missing and not (HOME.expanduser() / "cuda-vulkan-mapping.json").is_file():
        what = f"CUDA_VISIBLE_DEVICES={visible}" if gpu_device is None else f"gpu_device={gpu_device}"
        raise ConfigError(
            f"AI2-THOR's client needs {' and '.join(missing)} to look up {what}, not found here; install"
            f" vulkan-tools and NVIDIA's driver, or unset it; {INSTEAD}."
        )


def _command(executable: str) -> str:
    """The executable as a command line, which the client splits as a shell does."""
    line = shlex.quote(executable) if Path(executable).is_file() else executable
    try:
        words = shlex.split(line)
    except ValueError:  # an unclosed quotation mark
        words = []
    if not words or shutil.which(words[0]) is None:
        raise ConfigError(
            f"AI2-THOR's executable {executable} is missing or not executable; correct its path; {INSTEAD}."
        )
    return line


def _check_platform(platform: str, x_display: str | None) -> None:
    from ai2thor.platform import STR_PLATFORM_MAP

    if platform not in STR_PLATFORM_MAP:
        raise ConfigError(f"AI2-THOR has no platform {platform}; {did_you_mean(platform, STR_PLATFORM_MAP)}")
    if platform == "Linux64" and choose_platform(x_display) == "CloudRendering":
        raise ConfigError(
            "AI2-THOR's platform Linux64 needs an X display, but DISPLAY is not set; set it, or use the"
            f" platform CloudRendering; {INSTEAD}."
        )
    if platform == "CloudRendering" and not has_vulkan():
        raise ConfigError(
            "Without a display AI2-THOR renders with Vulkan, but libvulkan is not installed; run: apt install"
            f" libvulkan1, or set DISPLAY to an X display; {INSTEAD}."
        )
