"""How many cores there are for processes and threads of ours."""

from __future__ import annotations

import os


def cores() -> int:
    """The cores this process may use, which a container or `taskset` may make fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
