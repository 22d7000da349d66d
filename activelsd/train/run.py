"""A run's folder: resolved config, versions, metrics, checkpoints and reports."""

from __future__ import annotations

import json
import logging
import os
import shutil
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from torch import Tensor

from activelsd.errors import RunError
from activelsd.policy.checkpoint import MEANING, find_damage, load_tensors, save_network, save_tensors
from activelsd.policy.lsdnet import LSDNet
from activelsd.registry import Registry
from activelsd.versions import write_versions

CONFIG = "config.yaml"
_LOG = logging.getLogger("activelsd")
KEPT = 2
"""How many of the newest checkpoints are kept."""


class Run:
    """A folder `runs/<time>-<name>` that holds everything about a training.

    Attributes:
        folder: its path.
    """

    def __init__(self, folder: Path) -> None:
        """Open an existing run. Raises RunError if the folder is not one."""
        if not (folder / CONFIG).is_file():
            raise RunError(f"{folder} is not a run: it has no {CONFIG}; name a folder that training made.")
        self.folder = folder
        self._reported: set[Path] = set()  # damaged checkpoints

    @classmethod
    def create(cls, root: Path, name: str, config: str, parts: Iterable[tuple[Registry, str]] = ()) -> Run:
        """Make a new run's folder with the resolved config (YAML) and the versions of the packages.

        Args:
            root: folder of runs.
            name: of the run.
            config: as YAML.
            parts: every part of the config with its registry; the packages that bring some are noted.
        """
        stamp = time.strftime("%Y%m%d-%H%M%S")
        for number in range(1, 1000):
            folder = root / (f"{stamp}-{name}" if number == 1 else f"{stamp}-{name}-{number}")
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            except OSError as error:
                raise RunError(
                    f"{root} cannot hold runs ({error.strerror}); name another folder as runs=…"
                ) from None
            break
        write_versions(folder, parts)
        (folder / CONFIG).write_text(config, "utf-8")
        return cls(folder)

    @classmethod
    def newest(cls, root: Path) -> Run:
        """The newest run in a folder that has a checkpoint.

        Raises:
            RunError: there is none.
        """
        folders = sorted(root.glob(f"*/{CONFIG}"), key=lambda path: path.stat().st_mtime_ns)
        for path in reversed(folders):
            if cls(path.parent)._finished():
                return cls(path.parent)
        raise RunError(f"There is no run in ./{root}; train one with: activelsd train env=modelnet")

    @property
    def config(self) -> str:
        """The resolved config as YAML."""
        return (self.folder / CONFIG).read_text("utf-8")

    @config.setter
    def config(self, config: str) -> None:
        temporary = self.folder / f"{CONFIG}.tmp"
        temporary.write_text(config, "utf-8")
        temporary.replace(self.folder / CONFIG)

    @property
    def checkpoint(self) -> Path:
        """The folder of the newest checkpoint that can be read, or of the newest, if none can.

        Raises:
            RunError: there is no checkpoint yet.
        """
        finished = self._finished()
        if not finished:
            raise RunError(
                f"{self.folder} has no checkpoint; train it with: activelsd train --resume {self.folder}"
            )
        for folder in reversed(finished):
            damage = find_damage(folder)
            if damage is None:
                return folder
            if folder not in self._reported:
                self._reported.add(folder)
                _LOG.warning("%s; the checkpoint before it is used, if there is one.", damage)
        return finished[-1]

    def save(
        self, step: int, network: LSDNet, tensors: dict[str, Tensor], progress: Mapping[str, Any]
    ) -> None:
        """Write a checkpoint atomically: a folder under a temporary name, flushed, then renamed.

        Args:
            step: environment steps so far; the checkpoint's name.
            network: the policy.
            tensors: all other state from which training resumes.
            progress: plain numbers of that state, for JSON.
        """
        root = self.folder / "checkpoints"
        final, temporary = root / f"{step:012d}", root / f"{step:012d}.tmp"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        save_network(network, temporary)
        save_tensors(tensors, temporary / "training.safetensors")
        (temporary / "training.json").write_text(
            json.dumps({"step": step, **progress}, indent=1) + "\n", "utf-8"
        )
        for path in temporary.iterdir():
            with path.open("r+b") as file:
                os.fsync(file.fileno())
        shutil.rmtree(final, ignore_errors=True)
        temporary.rename(final)
        for old in self._finished()[:-KEPT]:
            half = old.with_suffix(".tmp")  # never half a checkpoint under its own name
            shutil.rmtree(half, ignore_errors=True)
            old.rename(half)
            shutil.rmtree(half, ignore_errors=True)

    def load_training(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """The tensors and progress that `save` was given, from the newest checkpoint."""
        path = self.checkpoint / "training.json"
        try:
            progress: dict[str, Any] = json.loads(path.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise RunError(
                f"{path} cannot be read ({error}), nor is there a good checkpoint before it; train a new run."
            ) from None
        return load_tensors(self.checkpoint / "training.safetensors"), progress

    def _finished(self) -> list[Path]:
        folders = (self.folder / "checkpoints").glob("[0-9]*")
        return sorted(path for path in folders if path.suffix != ".tmp")


def check_writable(folder: Path, instead: str) -> None:
    """Check that files can be written into a folder, or, if it is missing, that it can be made.

    Args:
        folder: which.
        instead: the way out, for the sentence of the error.

    Raises:
        RunError: they cannot.
    """
    there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    try:
        with TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise RunError(f"{folder} cannot be written ({error.strerror}); {instead}.") from None


def find_checkpoint(path: Path) -> Path:
    """The checkpoint at a path: a checkpoint's own folder, or the newest one of a run.

    Raises:
        RunError: the path is neither, or the run has no checkpoint yet.
    """
    return path if (path / MEANING).is_file() else Run(path).checkpoint
