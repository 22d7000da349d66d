"""Supervised accuracy on the embedded shapes by number of views: the possible gain from looking around.

One classifier is trained for each number of views: 1, 4 (90 degrees apart), and all 12, with max-pooled
features as in MVCNN (Su et al. 2015, https://arxiv.org/abs/1505.00880). The best epoch is chosen on a tenth
of the training objects; the test objects are used only for the final accuracy. An agent that chooses its
views should be between the first and the last row.

    python benchmarks/views.py --per-class-train 150 --per-class-test 20 --epochs 14
"""

from __future__ import annotations

import argparse
import os
import time
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from activelsd.policy.trunks import Compact
from activelsd.scenery.orbit_renderer import render_views
from activelsd.scenery.shapes import CATEGORIES, make_shape

AZIMUTHS = 12
ELEVATION = 30.0
TRAIN, TEST = 0, 1  # indices of the splits in the seeds
BATCH = 192  # frames per batch, for any number of views
VAL_EVERY = 10  # every tenth object is for validation


class Rings(NamedTuple):
    """Rings of 12 views around N objects."""

    frames: Tensor  # uint8 (N, 12, S, S)
    labels: Tensor  # int64 (N,)


def ring(seed: tuple[int, int, int, int], size: int) -> NDArray[np.uint8]:
    """Views (12, S, S) of the object given by (seed, split, category, number)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    mesh = make_shape(CATEGORIES[seed[2]], rng)
    cameras = [(i * 360 / AZIMUTHS, ELEVATION) for i in range(AZIMUTHS)]
    return render_views(mesh, size=size, cameras=cameras)


def draw(seed: int, split: int, per_class: int, size: int) -> Rings:
    """Makes and renders a split on all cores."""
    jobs = [
        ((seed, split, category, i), size) for category in range(len(CATEGORIES)) for i in range(per_class)
    ]
    with get_context("spawn").Pool(os.cpu_count()) as pool:
        frames = np.stack(pool.starmap(ring, jobs, chunksize=16))
    return Rings(torch.from_numpy(frames), torch.tensor([job[0][2] for job in jobs]))


class ViewPool(nn.Module):
    """The compact trunk for each view, the maximum over the views, and a linear layer to the classes."""

    def __init__(self, size: int, classes: int) -> None:
        """Builds the network for square frames of `size` pixels."""
        super().__init__()
        self.trunk = Compact(1, size)
        self.classes = nn.Linear(self.trunk.features, classes)

    def forward(self, frames: Tensor) -> Tensor:
        """Logits (B, classes) for uint8 frames (B, K, S, S)."""
        b, k, s, _ = frames.shape
        x = self.trunk(frames.reshape(b * k, 1, s, s))
        logits: Tensor = self.classes(x.reshape(b, k, -1).amax(dim=1))
        return logits


def select(rings: Rings, objects: Tensor, starts: Tensor, views: int) -> Tensor:
    """Frames (B, views, S, S) of objects (B,), evenly spaced around the ring from starts (B,)."""
    steps = torch.arange(views) * (AZIMUTHS // views)
    return rings.frames[objects[:, None], (starts[:, None] + steps) % AZIMUTHS]


@torch.no_grad()
def predict(model: ViewPool, rings: Rings, views: int) -> Tensor:
    """Predicted classes (N, starts), for every start that gives a different set of views."""
    n, starts = len(rings.labels), AZIMUTHS // views
    model.eval()
    columns = []
    for start in range(starts):
        chunks = torch.split(torch.arange(n), 256)
        logits = [model(select(rings, c, torch.full((len(c),), start), views)) for c in chunks]
        columns.append(torch.cat(logits).argmax(dim=1))
    return torch.stack(columns, dim=1)


def accuracy(classes: Tensor, labels: Tensor) -> float:
    """Fraction of (N, starts) predictions that are right."""
    return float((classes == labels[:, None]).double().mean())


def fit(train: Rings, val: Rings, views: int, args: argparse.Namespace) -> tuple[ViewPool, float]:
    """Trains with Adam for the given epochs or seconds; returns the best epoch on val and its accuracy."""
    torch.manual_seed(args.seed)
    model = ViewPool(args.size, len(CATEGORIES))
    optimiser = torch.optim.Adam(model.parameters(), lr=args.rate)
    best, kept, began, share = -1.0, model.state_dict(), time.monotonic(), 0.0
    objects, per_batch = len(train.labels), BATCH // views
    per_epoch = objects * AZIMUTHS // BATCH
    for epoch in range(args.epochs):
        model.train()
        for i in range(per_epoch):
            spent = time.monotonic() - began
            share = max((epoch + i / per_epoch) / args.epochs, spent / args.seconds)
            if share >= 1.0:
                break
            optimiser.param_groups[0]["lr"] = args.rate * (1 - 0.95 * share)
            chosen = torch.randint(objects, (per_batch,))
            logits = model(select(train, chosen, torch.randint(AZIMUTHS, (per_batch,)), views))
            loss = functional.cross_entropy(logits, train.labels[chosen])
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        right = accuracy(predict(model, val, views), val.labels)
        if right > best:
            best, kept = right, {name: value.clone() for name, value in model.state_dict().items()}
        print(
            f"  {views:2} views, epoch {epoch + 1}, {spent:.0f} s: loss {loss.item():.3f}, val {right:.3f}",
            flush=True,
        )
        if share >= 1.0:
            break
    model.load_state_dict(kept)
    return model, best


def confusion(classes: Tensor, labels: Tensor) -> str:
    """One line per category: its accuracy and the categories it is confused with most often."""
    lines = []
    for i, name in enumerate(CATEGORIES):
        rates = torch.bincount(classes[labels == i].flatten(), minlength=len(CATEGORIES)).double()
        rates /= rates.sum()
        others = [j for j in rates.argsort(descending=True).tolist() if j != i and rates[j] >= 0.03]
        confused = ", ".join(f"{CATEGORIES[j]} {rates[j]:.2f}" for j in others[:5])
        lines.append(f"  {name:12} {rates[i]:.2f}   {confused}")
    return "\n".join(lines)


def main() -> None:
    """Makes the objects, trains the classifiers and prints the table."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--per-class-train", type=int, default=150)
    parser.add_argument("--per-class-test", type=int, default=20)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--views", type=int, nargs="+", default=[1, 4, 12], help="divisors of 12")
    parser.add_argument("--epochs", type=int, default=14, help="passes over all training frames")
    parser.add_argument("--seconds", type=float, default=600.0, help="longest training time of a row")
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.set_flush_denormal(True)

    began = time.monotonic()
    drawn = draw(args.seed, TRAIN, args.per_class_train, args.size)
    test = draw(args.seed, TEST, args.per_class_test, args.size)
    count = len(drawn.labels) + len(test.labels)
    print(f"{count} objects of {len(CATEGORIES)} categories rendered in {time.monotonic() - began:.1f} s")
    held = torch.arange(len(drawn.labels)) % VAL_EVERY == VAL_EVERY - 1
    train, val = Rings(*(x[~held] for x in drawn)), Rings(*(x[held] for x in drawn))

    rows = []
    for views in args.views:
        model, best = fit(train, val, views, args)
        classes = predict(model, test, views)
        rows.append(f"{views:5}  {best:6.1%}  {accuracy(classes, test.labels):6.1%}")
        print(f"{views} views, test, by category:\n{confusion(classes, test.labels)}")
    print("views     val    test\n" + "\n".join(rows))


if __name__ == "__main__":
    main()
