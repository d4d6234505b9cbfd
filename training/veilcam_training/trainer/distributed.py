"""Ranks: processes that fit one model together, each on its share of every batch.

The gradients are averaged by torch's DistributedDataParallel. Batch normalisation takes its moments
over the whole batch; torch's SyncBatchNorm would do so on GPUs alone, ours does it everywhere.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor, distributed, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.nn.parallel import DistributedDataParallel

from veilcam_training.errors import require
from veilcam_training.models.whitening import WhitenedWeights


def choose_device(name: str) -> torch.device:
    """The device called ``name``: cpu, cuda, or auto for cuda if there is one.

    Raises:
        TrainingError: an unknown name, or CUDA where there is none.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    require(name in ("cpu", "cuda"), f"--device {name} is not valid: use cpu, cuda or auto")
    require(
        name != "cuda" or torch.cuda.is_available(),
        "--device cuda is not valid: torch sees no CUDA device; use cpu",
    )
    return torch.device(name)


def has_bfloat16(device: torch.device) -> bool:
    """True if ``device`` has instructions for bfloat16; torch emulates them elsewhere.

    Every CUDA device is taken to have them: those before compute capability 8.0 do not.
    """
    capabilities = torch.cpu.get_capabilities()
    return device.type != "cpu" or any(
        present for name, present in capabilities.items() if "bf16" in name
    )


ValueT = TypeVar("ValueT")


@dataclass(frozen=True)
class Ranks:
    """This process is number ``rank`` of ``size``; by default it is alone.

    Number 0 reports, validates and writes; what it decides holds for all.
    """

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """True in the process that reports and writes."""
        return self.rank == 0

    @property
    def purpose(self) -> tuple[str | int, ...]:
        """What sets this rank's random streams apart; nothing for the first one."""
        return () if self.is_first else ("rank", self.rank)

    def share(self, batch: Tensor) -> Tensor:
        """Return this rank's part of the indices of a batch.

        Raises:
            TrainingError: the batch cannot be divided evenly.
        """
        require(
            len(batch) % self.size == 0,
            f"batch = {len(batch)} cannot be divided over {self.size} processes: "
            f"use a multiple of {self.size}",
        )
        return batch.chunk(self.size)[self.rank]

    def wrap(self, module: nn.Module) -> nn.Module:
        """``module`` as all ranks train it together; its batch normalisations are replaced."""
        if self.size == 1:
            return module
        _take_moments_over_ranks(module)
        # Buffers are the same everywhere already, and a camera's matrix is large.
        return DistributedDataParallel(module, forward_sync_buffers=False)

    def total(self, *values: float) -> list[float]:
        """Sum of every value over the ranks."""
        if self.size == 1:
            return list(values)
        device = "cuda" if distributed.get_backend() == "nccl" else "cpu"
        sums = torch.tensor(values, dtype=torch.float64, device=device)
        distributed.all_reduce(sums)
        return [float(value) for value in sums]

    def from_first(self, make: Callable[[], ValueT]) -> ValueT:
        """What ``make`` returns in the first rank, which alone calls it, in all of them."""
        if self.size == 1:
            return make()
        values: list[Any] = [make() if self.is_first else None]
        distributed.broadcast_object_list(values)
        value: ValueT = values[0]
        return value


ALONE = Ranks()


@contextmanager
def join_ranks(device: torch.device) -> Iterator[tuple[Ranks, torch.device]]:
    """This process's place among those that ``torchrun`` started, and its device.

    Args:
        device: ``cuda`` gives every process of a machine a GPU of its own.

    Raises:
        TrainingError: there are fewer GPUs than processes.
    """
    if not distributed.is_torchelastic_launched():
        yield ALONE, device
        return
    cuda = device.type == "cuda"
    if cuda:
        place, gpus = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
        require(place < gpus, f"there are {gpus} GPUs: use --nproc-per-node {gpus}")
        device = torch.device("cuda", place)
        torch.cuda.set_device(device)
    distributed.init_process_group("nccl" if cuda else "gloo")
    try:
        yield Ranks(distributed.get_rank(), distributed.get_world_size()), device
    finally:
        distributed.destroy_process_group()


class _MeanOverRanks(torch.autograd.Function):
    """Mean over the ranks, differentiable: every rank's loss depends on every rank's values."""

    @staticmethod
    def forward(_: Any, values: Tensor) -> Tensor:
        mean = values.clone()
        distributed.all_reduce(mean)
        return mean / distributed.get_world_size()

    @staticmethod
    def backward(_: Any, gradient: Tensor) -> Tensor:
        mean = gradient.clone()
        distributed.all_reduce(mean)
        return mean / distributed.get_world_size()


def _mean_over_ranks(values: Tensor) -> Tensor:
    mean: Tensor = _MeanOverRanks.apply(values)  # type: ignore[no-untyped-call]
    return mean


class _BatchNormOverRanks(_BatchNorm):
    """Batch normalisation by the moments of the whole batch, all ranks' shares being equal."""

    running_mean: Tensor
    running_var: Tensor
    num_batches_tracked: Tensor

    def __init__(self, own: _BatchNorm) -> None:
        super().__init__(own.num_features, own.eps, own.momentum)
        # The very same tensors: an optimiser may hold them.
        self.weight, self.bias = own.weight, own.bias
        for name, buffer in own.named_buffers():
            setattr(self, name, buffer)

    def forward(self, values: Tensor) -> Tensor:
        if not self.training:
            return super().forward(values)
        axes = [axis for axis in range(values.ndim) if axis != 1]
        shape = [-1 if axis == 1 else 1 for axis in range(values.ndim)]
        wide = values.to(torch.promote_types(values.dtype, torch.float32))
        mean = _mean_over_ranks(wide.mean(axes))
        centred = wide - mean.view(shape)
        variance = _mean_over_ranks(centred.square().mean(axes))
        self._track(mean.detach(), variance.detach(), values.numel() // self.num_features)
        scale = self.weight * (variance + self.eps).rsqrt()
        return (centred * scale.view(shape) + self.bias.view(shape)).to(values.dtype)

    def _track(self, mean: Tensor, variance: Tensor, samples: int) -> None:
        count, momentum = samples * distributed.get_world_size(), self.momentum or 0.0
        self.running_mean.lerp_(mean, momentum)
        self.running_var.lerp_(variance * count / (count - 1), momentum)
        self.num_batches_tracked += 1

    def _check_input_dim(self, values: Tensor) -> None:
        """Shapes were checked when the classifier was made."""


def _take_moments_over_ranks(module: nn.Module) -> None:
    for name, child in module.named_children():
        if isinstance(child, _BatchNorm):
            setattr(module, name, _BatchNormOverRanks(child))
            continue
        if isinstance(child, WhitenedWeights):
            child.mean = _mean_over_ranks
        _take_moments_over_ranks(child)
