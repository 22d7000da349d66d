"""Several processes that train one network, started by `torchrun`; all make the same optimiser steps.

    torchrun --nproc-per-node 2 -m activelsd train env=modelnet

Every process has its own episodes (`train.envs` each) and the same weights. Gradients are averaged before
they are clipped, so an update equals that of one process with all the episodes.
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
"""How long a process waits for another; the first may be preparing views."""


_LONGEST = 4096
"""Largest size in bytes of a text for `Group.agreed`."""


def started_together() -> bool:
    """Whether `torchrun` started this process."""
    return "TORCHELASTIC_RUN_ID" in os.environ


def is_first() -> bool:
    """Whether this is the first process, which writes and prints for all."""
    return os.environ.get("RANK", "0") == "0" or not started_together()


def leave(code: int) -> NoReturn:
    """End a process that `torchrun` started, after flushing its output.

    At a usual exit, PyTorch's communication threads sometimes abort the process, which torchrun takes for a
    failure (seen with 2.13 and gloo).
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class Group:
    """The processes that train together; for a single process its operations do nothing.

    Attributes:
        rank: this process's index.
        size: number of processes.
    """

    def __init__(self, rank: int = 0, size: int = 1) -> None:
        """By default a single process; `joined` finds those that `torchrun` started."""
        self.rank, self.size = rank, size

    @classmethod
    def joined(cls, device: str) -> Group:
        """The group in which `torchrun` started this process, or this process alone."""
        if not started_together():
            return cls()
        backend = "cpu:gloo,cuda:nccl" if device.startswith("cuda") else "gloo"
        dist.init_process_group(backend, timeout=_PATIENCE)
        return cls(dist.get_rank(), dist.get_world_size())

    def __enter__(self) -> Group:
        """The group itself."""
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        """Leave the group: waits for the others, unless an error is on its way."""
        if self.size > 1:
            if failed is None:
                self.wait()
            dist.destroy_process_group()

    def average(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace every gradient by its mean over the processes."""
        if self.size == 1:
            return
        gradients = [p.grad for p in parameters if p.grad is not None]
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        dist.all_reduce(flat)
        flat /= self.size
        for gradient, mean in zip(gradients, torch.split(flat, [g.numel() for g in gradients]), strict=True):
            gradient.copy_(mean.view_as(gradient))

    def total(self, tensor: Tensor) -> Tensor:
        """The sum of a tensor over the processes."""
        if self.size > 1:
            tensor = tensor.clone()
            dist.all_reduce(tensor)
        return tensor

    def any(self, flag: bool) -> bool:
        """Whether the flag is true in any of the processes."""
        if self.size == 1:
            return flag
        flags = torch.tensor(float(flag))
        dist.all_reduce(flags)
        return bool(flags > 0)

    def gathered(self, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
        """The tensors of all processes, named by rank as in `1/name`; of a single process, unchanged.

        Names, shapes and types must be the same in all processes.
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
        """This process's part of what `gathered` returned.

        Raises:
            ValueError: the number of processes was another.
        """
        ranks = [name.partition("/")[0] for name in tensors]
        trained = 1 + max((int(rank) for rank in ranks if rank.isdigit()), default=0)
        if tensors and trained != self.size:
            raise ValueError(f"it was written by {trained} processes, not {self.size}")
        mine = f"{self.rank}/" if self.size > 1 else ""
        return {k.removeprefix(mine): v for k, v in tensors.items() if k.startswith(mine)}

    def agreed(self, text: str) -> str:
        """The text of the first process, returned in all of them."""
        if self.size == 1:
            return text
        shared = torch.zeros(_LONGEST, dtype=torch.uint8)
        if self.rank == 0:
            encoded = text.encode()
            shared[: len(encoded)] = torch.tensor(list(encoded), dtype=torch.uint8)
        dist.broadcast(shared, 0)
        return bytes(shared[shared > 0].tolist()).decode()

    def wait(self) -> None:
        """Wait for all processes."""
        if self.size > 1:
            dist.barrier()


ALONE = Group()
"""A single process."""
