"""Programs of our own, started beside the one that runs.

Not by `multiprocessing`, which would import the user's main module into each (with PyTorch, and once more
whatever a script without a main guard does). A session of their own keeps Ctrl-C from them and makes them,
with whatever they start themselves, one group that can be ended at once.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

NUMBER = "ACTIVELSD_PROCESS"
"""Environment variable with a process's number among those that are started side by side."""


def start(module: str, pass_fds: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Run a module's `main` in a new interpreter, with unbuffered pipes to its input and from its output."""
    # Said to the interpreter alone: programs that it starts in turn look for modules their own way.
    paths = [path or str(Path.cwd()) for path in sys.path]
    program = f"import sys; sys.path[:] = {paths!r}; from {module} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,  # what Python had read ahead, a selector would not see
        start_new_session=True,
        pass_fds=pass_fds,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
