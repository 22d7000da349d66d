"""Several processes that learn one network, as `torchrun` starts them: each plays, all make the same step.

    torchrun --nproc-per-node 2 -m activelsd train env=modelnet

Every process has episodes of its own (`train.envs` each) and the same weights. Gradients are averaged before
they are clipped, so an update is that of one process with all the episodes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from datetime import timedelta
from typing import NoReturn

import torch
import torch.distributed as dist
from torch import Tensor, nn

_PATIENCE = timedelta(hours=2)
"""How long a process waits for another; the first of them may have views to prepare."""


_LONGEST = 4096
"""Bytes of a text that is agreed on."""


def started_together() -> bool:
    """Whether `torchrun` started this process."""
    return "TORCHELASTIC_RUN_ID" in os.environ


def is_first() -> bool:
    """Whether this process speaks for all."""
    return os.environ.get("RANK", "0") == "0" or not started_together()


def leave(code: int) -> NoReturn:
    """End a process that `torchrun` started, all it has to say said.

    PyTorch's threads for talking to other processes now and then abort what ends in the usual way, and
    torchrun takes that for a failure (seen with 2.13 and gloo).
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class Group:
    """The processes that learn together; alone, its operations do nothing.

    Attributes:
        rank: this process's number.
        size: how many there are.
    """

    def __init__(self, rank: int = 0, size: int = 1) -> None:
        """A process by itself; `joined` finds those that `torchrun` started."""
        self.rank, self.size = rank, size

    @classmethod
    def joined(cls, device: str) -> Group:
        """The group that `torchrun` started this process in, or this process alone."""
        if not started_together():
            return cls()
        backend = "cpu:gloo,cuda:nccl" if device.startswith("cuda") else "gloo"
        dist.init_process_group(backend, timeout=_PATIENCE)
        return cls(dist.get_rank(), dist.get_world_size())

    def __enter__(self) -> Group:
        """Work together."""
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        """Part, after all have come so far; where one has failed, at once."""
        if self.size > 1:
            if failed is None:
                self.wait()
            dist.destroy_process_group()

    def average(self, parameters: Iterable[nn.Parameter]) -> None:
        """Put the mean over processes in the place of every gradient."""
        if self.size == 1:
            return
        gradients = [p.grad for p in parameters if p.grad is not None]
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        dist.all_reduce(flat)
        flat /= self.size
        for gradient, mean in zip(gradients, torch.split(flat, [g.numel() for g in gradients]), strict=True):
            gradient.copy_(mean.view_as(gradient))

    def any(self, wanted: bool) -> bool:
        """Whether one of the processes wants something."""
        if self.size == 1:
            return wanted
        asked = torch.tensor(float(wanted))
        dist.all_reduce(asked)
        return bool(asked > 0)

    def gathered(self, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        """The tensors of all processes, below their numbers as `1/name`; alone, as they are.

        They are of the same names, shapes and types everywhere.
        """
        if self.size == 1:
            return tensors
        found: dict[str, Tensor] = {}
        for name, tensor in tensors.items():
            own = tensor.to(torch.uint8) if tensor.dtype == torch.bool else tensor
            each = [torch.empty_like(own) for _ in range(self.size)]
            dist.all_gather(each, own.contiguous())
            found |= {f"{rank}/{name}": one.to(tensor.dtype) for rank, one in enumerate(each)}
        return found

    def own(self, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        """This process's part of what `gathered` gave.

        Raises:
            ValueError: they are of another number of processes.
        """
        ranks = [name.partition("/")[0] for name in tensors]
        trained = 1 + max((int(rank) for rank in ranks if rank.isdigit()), default=0)
        if tensors and trained != self.size:
            raise ValueError(f"it was written by {trained} processes, not {self.size}")
        mine = f"{self.rank}/" if self.size > 1 else ""
        return {k.removeprefix(mine): v for k, v in tensors.items() if k.startswith(mine)}

    def agreed(self, text: str) -> str:
        """The first process's text, in all of them."""
        if self.size == 1:
            return text
        said = torch.zeros(_LONGEST, dtype=torch.uint8)
        if self.rank == 0:
            encoded = text.encode()
            said[: len(encoded)] = torch.tensor(list(encoded), dtype=torch.uint8)
        dist.broadcast(said, 0)
        return bytes(said[said > 0].tolist()).decode()

    def wait(self) -> None:
        """Until all are here."""
        if self.size > 1:
            dist.barrier()


ALONE = Group()
"""A process that learns by itself."""
