"""A trainer's update as one CUDA graph: some thousand small kernels are launched by a single call.

A graph repeats kernels on the same addresses with the same scalars. So the state of the episodes, which one
update hands to the next, is copied to fixed tensors, and so are the annealed values, which change from update
to update. Weights and the optimiser's state are changed in place anyway, and the registered generator
continues from replay to replay.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch

from activelsd.train.actors.resident import ResidentActors
from activelsd.train.settings import Annealed
from activelsd.train.statistics import Counts

WARM_UPS = 3
"""Updates without a graph at first: libraries choose their kernels, and the optimiser creates its state."""

Done = TypeVar("Done")


def warm_up(work: Callable[[], Done]) -> Done:
    """Do work that is to be captured later, on a side stream, as capturing requires."""
    stream, main = torch.cuda.Stream(), torch.cuda.current_stream()  # type: ignore[no-untyped-call]
    stream.wait_stream(main)
    with torch.cuda.stream(stream):
        done = work()
    main.wait_stream(stream)
    return done


class GraphedUpdate:
    """Makes updates; after a few, by replaying a captured one."""

    def __init__(
        self, update: Callable[[Annealed], Counts], actors: ResidentActors, device: torch.device
    ) -> None:
        """Repeat an update, which must never wait for the device."""
        self._update, self._actors = update, actors
        self._now = torch.zeros(len(Annealed._fields), device=device)
        self._episodes = {name: value.clone() for name, value in actors.episodes().items()}
        self._warm_ups = WARM_UPS
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, now: Annealed) -> Counts:
        """Make an update; the next one overwrites the counts that are returned."""
        self._now.copy_(torch.tensor(now), non_blocking=True)
        if self._warm_ups:
            self._warm_ups -= 1
            return warm_up(self.in_place)
        if self._graph is None:
            self._capture()
        assert self._graph is not None
        self._graph.replay()
        return self._counts

    def _capture(self) -> None:
        graph = torch.cuda.CUDAGraph()
        graph.register_generator_state(self._actors.generator)
        with torch.cuda.graph(graph):
            self._counts = self.in_place()
        self._graph = graph

    def in_place(self) -> Counts:
        """An update that changes the episodes' tensors in place."""
        self._actors.set_episodes(self._episodes)
        counts = self._update(Annealed(*self._now.unbind()))
        for name, value in self._actors.episodes().items():
            self._episodes[name].copy_(value)
        self._actors.set_episodes(self._episodes)
        return counts
