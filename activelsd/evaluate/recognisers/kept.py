"""Keeps what recognisers have learned in the cache, so that the same training is done once.

A folder `recogniser-<digest>` holds `weights.safetensors` and `recogniser.json`; the digest is of all that
the weights depend on.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from activelsd.envs.cache import alone, writing
from activelsd.envs.settings import Progress
from activelsd.errors import DataError, RunError
from activelsd.evaluate.recognisers.interface import Recogniser, Training
from activelsd.policy.checkpoint import load_tensors, save_tensors

WEIGHTS, ABOUT = "weights.safetensors", "recogniser.json"


def trained(
    name: str, recogniser: Recogniser, cache: Path, *, seed: int, progress: Progress | None = None
) -> Training:
    """Give a recogniser the weights that are kept of this training; train it if there are none.

    Args:
        name: by which it is registered; noted beside the weights.
        recogniser: with fresh weights.
        cache: folder to keep them in.
        seed: of the training.
        progress: of the training.

    Returns:
        How the training went, whenever it was.

    Raises:
        CacheError: the cache cannot be written.
        DataError: what is kept cannot be read.
    """
    folder = cache / f"recogniser-{recogniser.digest(seed)}"
    if not folder.is_dir():
        with alone(folder):
            if not folder.is_dir():
                training = recogniser.fit(seed=seed, progress=progress)
                with writing(cache):
                    _save(name, recogniser, training, seed, folder)
    return _load(recogniser, folder)


def _save(name: str, recogniser: Recogniser, training: Training, seed: int, folder: Path) -> None:
    unfinished = folder.with_name(folder.name + ".partial")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    save_tensors(recogniser.state_dict(), unfinished / WEIGHTS)
    about = {
        "name": name,
        "seed": seed,
        "settings": recogniser.settings.model_dump(mode="json"),
        "classes": list(recogniser.objects.graph.classes),
        "training": training._asdict(),
    }
    (unfinished / ABOUT).write_text(json.dumps(about, indent=1) + "\n", "utf-8")
    unfinished.rename(folder)


def _load(recogniser: Recogniser, folder: Path) -> Training:
    try:
        training = Training(**json.loads((folder / ABOUT).read_text("utf-8"))["training"])
        recogniser.load_state_dict(load_tensors(folder / WEIGHTS))
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, RunError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{folder} cannot be used ({reason}); delete it, and it is trained again.") from None
    return training
