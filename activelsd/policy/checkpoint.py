"""Networks on disk: safetensors for the weights, JSON for shape and action names; nothing is unpickled."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from activelsd.envs.actions import ActionTree
from activelsd.errors import RunError
from activelsd.policy.lsdnet import LSDNet, NetworkShape
from activelsd.registry import UnknownPartError

WEIGHTS, MEANING = "network.safetensors", "network.json"
_FROZEN = "frozen_trunk"


def save_network(network: LSDNet, folder: Path) -> None:
    """Write weights, action names and shape into an existing folder, which the caller renames into place.

    Of a frozen trunk only the neck is written, and a digest of the rest.
    """
    save_tensors(network.state_dict(), folder / WEIGHTS)
    meaning: dict[str, Any] = {"actions": network.tree.to_dict(), "shape": asdict(network.shape)}
    if network.frozen_trunk is not None:
        meaning[_FROZEN] = network.frozen_trunk.digest()
    (folder / MEANING).write_text(json.dumps(meaning, indent=1) + "\n", "utf-8")


def load_network(folder: Path, device: str | torch.device = "cpu") -> LSDNet:
    """Read a network back.

    Raises:
        RunError: the files are missing, truncated or foreign, or no installed package has a part they name.
    """
    try:
        meaning = json.loads((folder / MEANING).read_text("utf-8"))
        network = LSDNet(ActionTree(meaning["actions"]), _shape(meaning["shape"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"{folder / MEANING} is not a network's description ({error}); use another run."
        ) from None
    except UnknownPartError as error:
        raise RunError(
            f"{folder / MEANING} names the {error.kind} '{error.name}', which is not installed; "
            "install the package that brings it."
        ) from None
    then, trunk = meaning.get(_FROZEN), network.frozen_trunk
    if then is not None and trunk is not None and trunk.digest() != then:
        raise RunError(
            f"{folder / MEANING} was trained on the trunk '{then}', and '{trunk.digest()}' is here;"
            " put the file of weights that it was trained with in its place."
        )
    tensors = load_tensors(folder / WEIGHTS)
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise RunError(f"{folder / WEIGHTS} does not fit the {MEANING} beside it: {reason}") from None
    return network.to(device)


def find_damage(folder: Path) -> str | None:
    """Why a checkpoint cannot be used: a file is missing, cut short or something else; None if it can be."""
    files = {*folder.glob("*.json"), *folder.glob("*.safetensors"), folder / MEANING, folder / WEIGHTS}
    return next(filter(None, map(_damage, sorted(files))), None)


def _damage(file: Path) -> str | None:
    try:
        if file.suffix == ".json":
            json.loads(file.read_text("utf-8"))
        else:
            with safe_open(file, "pt"):  # the header's sizes tell a file that is cut short
                pass
    except (OSError, ValueError, SafetensorError) as error:
        return f"{file} cannot be read ({error})"
    return None


def _shape(values: dict[str, Any]) -> NetworkShape:
    """A network's shape from JSON; older files hold `features`, a setting of the compact trunk only."""
    features = values.pop("features", None)
    if features is not None and values["trunk"] == "compact":
        values["trunk_settings"] = {"features": features}
    return NetworkShape(**values)


def save_tensors(tensors: dict[str, Tensor], path: Path) -> None:
    """Write named tensors; values and types are kept, memory layouts are not."""
    save_file({name: value.detach().cpu().contiguous() for name, value in tensors.items()}, path)


def load_tensors(path: Path) -> dict[str, Tensor]:
    """Read named tensors. Raises RunError if the file is missing or truncated."""
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise RunError(f"{path} cannot be read ({error}); use another checkpoint or run.") from None
