"""Ray's cluster: joins a running one, or starts one on this machine for the time of the run."""

from __future__ import annotations

import logging
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from activelsd.errors import ConfigError, TrainingError

_PATIENCE = 10.0
"""Seconds that the head of a cluster may take to answer."""


def import_ray() -> Any:
    """The package. Raises ConfigError if it is not installed."""
    try:
        import ray
    except ModuleNotFoundError:
        raise ConfigError(
            "train.actors=ray needs Ray, which is not installed; get it with: pip install 'activelsd[ray]'"
        ) from None
    return ray


def join(address: str) -> None:
    """Connect to a running cluster.

    Args:
        address: `host:port` of its head, or `auto` for the one on this machine.

    Raises:
        ConfigError: none answers there, or it has another version of Ray or Python.
    """
    ray = import_ray()
    try:
        _reach(address)
        with _own_signals():
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise ConfigError(
            f"train.ray.address={address} cannot be joined ({_first_line(error)}); start a cluster there with"
            " `ray start --head`, or leave the address out to have one started here."
        ) from None


def start(*, cpus: int, store: int) -> None:
    """Start a cluster on this machine alone.

    Args:
        cpus: number of workers, which may be more than there are cores.
        store: bytes of shared memory for arrays.

    Raises:
        TrainingError: it does not start.
    """
    ray = import_ray()
    try:
        with _own_signals():
            # Without `local`, Ray would join any cluster it finds.
            ray.init(
                address="local",
                num_cpus=cpus,
                object_store_memory=store,
                include_dashboard=False,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise TrainingError(f"Ray does not start on this machine: {_first_line(error)}") from None


def leave() -> None:
    """End the cluster that was started here with all its processes, or leave the one that was joined."""
    import_ray().shutdown()


def room() -> str:
    """Says how many CPUs the cluster has and how many of them are free, for messages."""
    ray = import_ray()
    found, free = (int(some.get("CPU", 0)) for some in (ray.cluster_resources(), ray.available_resources()))
    return f"the cluster has {found} CPUs of which {free} are free, and each worker needs one"


def _reach(address: str) -> None:
    """Check within seconds that a host answers; Ray tries for minutes."""
    host, _, port = address.rpartition(":")
    if port.isdigit() and "://" not in address:
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE).close()


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep this process's handler of SIGTERM; Ray installs its own, which writes no checkpoint."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__).rstrip(".")
