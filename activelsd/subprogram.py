"""Starts functions of this package as programs beside the one that runs.

`multiprocessing` would import the user's main module into each, with PyTorch, and run a script without a main
guard once more. A session of its own keeps Ctrl-C from a program, and makes it and whatever it starts one
process group, which can be killed at once.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

NUMBER = "ACTIVELSD_PROCESS"
"""Environment variable with a process's index among those that are started side by side."""


def start(module: str, pass_fds: Sequence[int] = (), number: int | None = None) -> subprocess.Popen[bytes]:
    """Run a module's `main` in a new interpreter, with unbuffered pipes to its input and from its output.

    Args:
        module: which has the function `main`.
        pass_fds: file descriptors that it inherits.
        number: its value of the environment variable `NUMBER`; None leaves that as it is.
    """
    # Set in this interpreter only: programs that it starts in turn find their modules in their own way.
    paths = [path or str(Path.cwd()) for path in sys.path]
    program = f"import sys; sys.path[:] = {paths!r}; from {module} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,  # a selector does not see what Python has read ahead
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # Windows' own way
        pass_fds=pass_fds,
        env=os.environ | {"OMP_NUM_THREADS": "1"} | ({} if number is None else {NUMBER: str(number)}),
    )


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a program, unless it has ended, and whatever it started; on Windows the program only."""
    if process.poll() is not None:
        return
    if sys.platform == "win32":
        process.kill()
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
