"""Trains a recogniser by gradients, on sets of one to all views, and keeps the best epoch."""

from __future__ import annotations

import math
import time

import torch
from torch import Tensor
from torch.nn import functional

from activelsd.envs.settings import Progress
from activelsd.errors import TrainingError
from activelsd.evaluate.recognisers.interface import Recogniser, Training
from activelsd.evaluate.recognisers.objects import draw_sets


def fit(recogniser: Recogniser, *, seed: int, progress: Progress | None = None) -> Training:
    """Train on cross-entropy by AdamW, each object once in every epoch with a set drawn anew.

    Args:
        recogniser: on its device.
        seed: of all draws.
        progress: called with the batches done and all of them.

    Raises:
        TrainingError: the loss is no longer finite.
    """
    objects, own = recogniser.objects, recogniser.settings
    train, val = objects.of("train"), objects.of("val")
    generator = torch.Generator().manual_seed(seed)
    sets = val_sets(recogniser, seed)
    optimiser = torch.optim.AdamW(recogniser.rates(), weight_decay=own.decay)
    per_epoch = math.ceil(len(train) / own.batch)
    epochs = max(own.epochs, math.ceil(own.updates / per_epoch))
    total = epochs * per_epoch
    falling = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda step: 0.5 * (1 + math.cos(math.pi * min(1.0, step / total)))
    )
    began, losses, right = time.monotonic(), [], []
    best, epoch, kept = -1.0, epochs, recogniser.state_dict()
    for number in range(1, epochs + 1):
        recogniser.train()
        sums = 0.0
        order = train[torch.randperm(len(train), generator=generator)]
        for targets in torch.split(order, own.batch):
            views = draw_sets(objects.views[targets], generator)
            loss = _loss(recogniser, targets, views)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            falling.step()
            sums += loss.item() * len(targets)
            if progress is not None:
                progress(falling.last_epoch, total)
        losses.append(sums / len(train))
        if not math.isfinite(losses[-1]):
            raise TrainingError(f"The loss of {type(recogniser).__name__} is no longer finite.")
        if len(val):
            named = recogniser.probabilities(*sets).argmax(-1)
            right.append(float((named == objects.labels[sets[0]]).float().mean()))
            if right[-1] >= best:
                best, epoch = right[-1], number
                kept = {name: value.clone() for name, value in recogniser.state_dict().items()}
    if right:
        recogniser.load_state_dict(kept)
    return Training(time.monotonic() - began, epoch, losses, right)


def val_sets(recogniser: Recogniser, seed: int) -> tuple[Tensor, Tensor]:
    """The validation objects, and a set of views of each, for every number of views that is measured."""
    val, generator = recogniser.objects.of("val"), torch.Generator().manual_seed(seed)
    views = recogniser.objects.views[val]
    drawn = [draw_sets(views, generator, count) for count in recogniser.counts]
    return val.repeat(len(drawn)), torch.cat(drawn)


def _loss(recogniser: Recogniser, targets: Tensor, views: Tensor) -> Tensor:
    logits = recogniser(targets, views)
    labels = recogniser.objects.labels[targets].to(logits.device)
    return functional.cross_entropy(logits, labels, label_smoothing=recogniser.settings.smoothing)
