"""Finds and reads files of pretrained weights; only tensors are read, never a pickled object."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor

from activelsd.errors import ConfigError

ENDINGS = (".safetensors", ".pth", ".pt", ".bin")
"""What files of weights end in, the best first."""

_PREFERRED = ("model.safetensors", "pytorch_model.bin")
"""Names that a folder of the Hugging Face layout has."""


def find_weights(place: Path) -> Path:
    """The file of weights at a path: the file itself, or the one in a folder.

    Raises:
        ConfigError: there is none, or a folder has several.
    """
    if place.is_file():
        return place
    if not place.is_dir():
        raise ConfigError(f"There are no weights at {place}; check policy.trunk.weights.")
    found = sorted(path for path in place.iterdir() if path.suffix in ENDINGS)
    named = [path for path in found if path.name in _PREFERRED]
    if len(found) != 1 and len(named) != 1:
        what = f"{len(found)} files" if found else "no file"
        raise ConfigError(
            f"{place} holds {what} of weights ({', '.join(ENDINGS)}); name one by policy.trunk.weights."
        )
    return named[0] if len(named) == 1 else found[0]


def read_weights(file: Path) -> dict[str, Tensor]:
    """The tensors of a file by name, on the CPU.

    Raises:
        ConfigError: it cannot be read, or holds something else than tensors.
    """
    try:
        if file.suffix == ".safetensors":
            return load_file(file)
        # With `weights_only` nothing but tensors and plain containers is unpickled.
        content = torch.load(file, map_location="cpu", weights_only=True)  # noqa: TID251
    except Exception as error:  # noqa: BLE001  torch raises what it likes on a file that is no archive
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:100].rstrip(".")
        raise ConfigError(
            f"{file} cannot be read as weights ({reason}); give safetensors, or a .pth file of weights only."
        ) from None
    for key in ("state_dict", "model"):
        if isinstance(content, dict) and isinstance(content.get(key), dict):
            content = content[key]
    if not isinstance(content, dict) or not all(isinstance(one, Tensor) for one in content.values()):
        raise ConfigError(f"{file} holds no tensors by name; give safetensors, or a .pth file of weights.")
    return {name.removeprefix("module."): tensor for name, tensor in content.items()}


def digest(file: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        stat = file.stat()
        return _digest(file, stat.st_size, stat.st_mtime_ns)
    except OSError as error:
        raise ConfigError(f"{file} cannot be read ({error.strerror}); check policy.trunk.weights.") from None


@lru_cache(maxsize=16)
def _digest(file: Path, size: int, changed: int) -> str:
    with file.open("rb") as stream:
        # hashlib.file_digest needs Python 3.11.
        hashed = hashlib.sha256()
        while block := stream.read(1 << 20):
            hashed.update(block)
    return hashed.hexdigest()
