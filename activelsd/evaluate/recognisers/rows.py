"""Trains recognisers on a world's objects and measures them: a row for every number of views."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from activelsd import registry
from activelsd.envs.settings import Progress
from activelsd.errors import ConfigError
from activelsd.evaluate.metrics import Interval, intervals
from activelsd.evaluate.recognisers.interface import Recogniser, Training
from activelsd.evaluate.recognisers.kept import trained
from activelsd.evaluate.recognisers.objects import Objects, draw_sets

SETS = 12
"""Random sets of each object, as many as starts on a ring, for numbers of views that leave a choice."""

PUBLISHED = "the paper's Table 2, ModelNet40 meshes"
NO_MOVEMENT = 64.3
"""Accuracy in per cent that the paper's Table 2 has for its network without moves."""


@dataclass(frozen=True, kw_only=True)
class Recognition:
    """The results of a recogniser with one number of views.

    Attributes:
        name: of the recogniser.
        given: what it is given of an object.
        views: how many views of an object; 0 for the whole shape.
        sets: how many sets of views of each object.
        objects: how many objects.
        parameters: how many are trained.
        seconds: of its training.
        epoch: whose weights are used.
        accuracy: fraction of the sets that are named right.
        published: its accuracy in per cent in the paper; None in rows that are not in it.
    """

    name: str
    given: str
    views: int
    sets: int
    objects: int
    parameters: int
    seconds: float
    epoch: int
    accuracy: Interval
    published: float | None


def recognise(
    names: Sequence[str],
    objects: Objects,
    *,
    split: str,
    seed: int,
    cache: Path,
    device: str = "cpu",
    epochs: int | None = None,
    progress: Callable[[str], AbstractContextManager[Progress]],
) -> tuple[list[Recognition], dict[str, Recogniser]]:
    """Train registered recognisers, unless what they learned is kept, and name the objects of a split.

    Args:
        names: in `registry.recognisers`.
        objects: of the world.
        split: whose objects are named.
        seed: of weights, trainings, sets of views and resampling.
        cache: folder that keeps what they learn.
        device: to compute on.
        epochs: of every training; None: as many as each takes by itself.
        progress: makes the callback of a progress line, given what is done.

    Returns:
        Their results, and the trained recognisers by name.

    Raises:
        ConfigError: a recogniser is unknown or named twice, or the world lacks what it needs. Nothing has
            been trained then.
    """
    made = {}
    for name in names:
        if name in made:
            raise ConfigError(f"The recogniser '{name}' is named twice; name it once.")
        made[name] = make_recogniser(name, objects, seed, device=device, epochs=epochs, progress=progress)
    rows = []
    for name, recogniser in made.items():
        with registry.recognisers.blaming(name, "fails"), _seeded(seed), progress(f"Training {name}") as show:
            training = trained(name, recogniser, cache, seed=seed, progress=show)
            rows += _measured(name, recogniser, training, split, seed)
    return rows, made


def make_recogniser(
    name: str,
    objects: Objects,
    seed: int,
    *,
    device: str = "cpu",
    epochs: int | None = None,
    progress: Callable[[str], AbstractContextManager[Progress]],
) -> Recogniser:
    """A registered recogniser with fresh weights; arguments as `recognise`."""
    kind = registry.recognisers.get(name)
    with registry.recognisers.blaming(name, "cannot be made"), _seeded(seed):
        settings = kind.Settings(**({} if epochs is None else {"epochs": epochs, "updates": 0}))
        with progress(f"Preparing {name}") as show:
            recogniser: Recogniser = kind(objects, settings, show)
        return recogniser.to(device)


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Draws of torch's global generator follow from the seed inside, and go on as before afterwards."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


def _measured(
    name: str, recogniser: Recogniser, training: Training, split: str, seed: int
) -> list[Recognition]:
    objects = recogniser.objects
    targets = objects.of(split)
    views, generator = objects.views[targets], torch.Generator().manual_seed(seed)
    rows = []
    for count in recogniser.counts:
        sets = SETS if 0 < count < views.shape[1] else 1
        again = targets.repeat(sets)
        drawn = draw_sets(views.repeat(sets, 1), generator, count)
        right = recogniser.probabilities(again, drawn).argmax(-1) == objects.labels[again]
        number = np.tile(np.arange(len(targets)), sets)
        (accuracy,) = intervals(right.numpy()[:, None].astype(np.float64), number, seed=seed)
        rows.append(
            Recognition(
                name=name,
                given=recogniser.given,
                views=count,
                sets=sets,
                objects=len(targets),
                parameters=recogniser.size(),
                seconds=training.seconds,
                epoch=training.epoch,
                accuracy=accuracy,
                published=recogniser.published if count == recogniser.counts[0] else None,
            )
        )
    return rows
