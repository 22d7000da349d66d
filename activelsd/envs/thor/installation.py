"""What AI2-THOR needs on this machine: its client, a build of its simulator, and somewhere to draw."""

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
"""Without its dependencies, as `opencv-python` would overwrite the `opencv-python-headless` used here."""

HOME = Path("~/.ai2thor")
"""Where the client keeps builds and logs; it can be put elsewhere by HOME only."""

INSTEAD = "env.backend=standin runs without"
"""What every sentence about something missing ends with."""


def load_controller() -> Any:
    """AI2-THOR's class `Controller`.

    Raises:
        ConfigError: the client is not installed, or only in part.
    """
    if importlib.util.find_spec("ai2thor") is None:
        raise ConfigError(f"AI2-THOR's client is not installed: {INSTALL}; {INSTEAD}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its source has escapes that newer versions of Python warn of
            from ai2thor.controller import Controller
    except ImportError as error:
        raise ConfigError(f"AI2-THOR's client lacks a package ({error}): {INSTALL}; {INSTEAD}.") from None
    return Controller


def download_command(platform: str) -> str:
    """A line for the shell that downloads a platform's build, about 800 MB, ahead of its use."""
    call = f"Controller(download_only=True, platform='{platform}')"
    return f'python -c "from ai2thor.controller import Controller; {call}"'


def find_build(platform: str) -> Path | None:
    """The folder of the downloaded build that belongs to the installed client, if there is one."""
    load_controller()
    from ai2thor.build import COMMIT_ID, build_name

    folder = HOME.expanduser() / "releases" / build_name(platform, COMMIT_ID)
    return folder if folder.is_dir() else None


def has_vulkan() -> bool:
    """Whether the loader of Vulkan is installed, which the platform CloudRendering draws with."""
    return ctypes.util.find_library("vulkan") is not None


def choose_platform(x_display: str | None = None) -> str:
    """The platform to take where none is asked for: on Linux by whether there is a display."""
    if machine.system() == "Darwin":
        return "OSXIntel64"
    return "Linux64" if x_display or os.environ.get("DISPLAY") else "CloudRendering"


def launch_options(
    executable: str | None, platform: str | None, x_display: str | None, gpu_device: int | None
) -> dict[str, Any]:
    """The keywords that tell a `Controller` what to start and where it draws, once that is known to be there.

    Args:
        executable: a simulator of one's own, as a path or a command line; else the downloaded build is taken.
        platform: `Linux64`, `CloudRendering` or `OSXIntel64`, of a downloaded build; else chosen.
        x_display: as `:0`; else that of the environment.
        gpu_device: CUDA's number of the card CloudRendering draws with; else the first it sees.

    Raises:
        ConfigError: something is missing that the user can set or install.
        DataError: the build has not been downloaded.
    """
    load_controller()
    _check_home()
    _check_card(gpu_device)
    options: dict[str, Any] = {"x_display": x_display, "gpu_device": gpu_device}
    if executable is not None:
        if choose_platform(x_display) == "CloudRendering":  # the client starts no executable without a name
            raise ConfigError(
                "AI2-THOR's client wants a display for an executable and DISPLAY is not set: set it, to any"
                f" name as :0 where the executable draws without one; {INSTEAD}."
            )
        return options | {"local_executable_path": _command(executable)}
    platform = platform or choose_platform(x_display)
    _check_platform(platform, x_display)
    if find_build(platform) is None:
        command = download_command(platform)
        raise DataError(f"AI2-THOR's build for {platform} is not downloaded yet: {command}; {INSTEAD}.")
    return options | {"platform": platform}


def _check_home() -> None:
    folder = HOME.expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(
            f"AI2-THOR's client cannot write to {folder} ({error.strerror}): mend that, or set HOME to a"
            f" folder that can be written; {INSTEAD}."
        ) from None


def _check_card(gpu_device: int | None) -> None:
    """Raise ConfigError where a card is chosen, by whichever way, and the client could not look it up."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    # The client takes a number in the environment for a choice, whatever it is to start.
    chosen = gpu_device is not None or any(part.strip().isdigit() for part in visible.split(","))
    missing = [tool for tool in ("vulkaninfo", "nvidia-smi") if shutil.which(tool) is None]
    if chosen and missing and not (HOME.expanduser() / "cuda-vulkan-mapping.json").is_file():
        what = f"CUDA_VISIBLE_DEVICES={visible}" if gpu_device is None else f"gpu_device={gpu_device}"
        raise ConfigError(
            f"AI2-THOR's client looks up {what} by {' and '.join(missing)}, not found here: install"
            f" vulkan-tools and NVIDIA's driver, or leave that unset; {INSTEAD}."
        )


def _command(executable: str) -> str:
    """The executable as the shell-like line that the client splits into words again."""
    line = shlex.quote(executable) if Path(executable).is_file() else executable
    try:
        words = shlex.split(line)
    except ValueError:  # a quotation that does not end
        words = []
    if not words or shutil.which(words[0]) is None:
        raise ConfigError(f"AI2-THOR's executable {executable} is not there or may not be run; {INSTEAD}.")
    return line


def _check_platform(platform: str, x_display: str | None) -> None:
    from ai2thor.platform import STR_PLATFORM_MAP

    if platform not in STR_PLATFORM_MAP:
        raise ConfigError(
            f"{platform} is no platform of AI2-THOR; {did_you_mean(platform, STR_PLATFORM_MAP)}"
        )
    if platform == "Linux64" and choose_platform(x_display) == "CloudRendering":
        raise ConfigError(
            "AI2-THOR's platform Linux64 draws on an X display and DISPLAY is not set: set it, or take the"
            f" platform CloudRendering; {INSTEAD}."
        )
    if platform == "CloudRendering" and not has_vulkan():
        raise ConfigError(
            "AI2-THOR draws without a display by Vulkan, and libvulkan is not installed: apt install"
            f" libvulkan1, or set DISPLAY to an X display; {INSTEAD}."
        )
