"""Reductions over ranks. In a single process every function is the identity."""

from collections.abc import Iterable

import torch
import torch.distributed as dist
from rsl_rl.modules import EmpiricalNormalization
from torch import Tensor, nn


def world_size() -> int:
    """Return the number of processes that train one model."""
    if dist.is_available() and dist.is_initialized():
        return dist.get_world_size()
    return 1


def mean(value: Tensor) -> Tensor:
    """Average a tensor over ranks."""
    if world_size() == 1:
        return value
    total = value.clone()
    dist.all_reduce(total)
    return total / world_size()


def moments(value: Tensor) -> tuple[Tensor, Tensor]:
    """Compute mean and population variance over all ranks' rows [B, ...], with B equal on each."""
    average = mean(value.mean(0))
    variance = mean(((value - average) ** 2).mean(0))
    return average, variance


def update_normalizer(normalizer: EmpiricalNormalization, rows: Tensor) -> None:
    """Update a normalizer with all ranks' rows [B, C], as if one process had them all.

    Ranks exchange moments, which are 2 * C numbers, rather than rows.
    """
    if world_size() == 1:
        normalizer.update(rows)
        return
    average, variance = moments(rows)
    count = rows.shape[0] * world_size()
    # These are the normalizer's own buffers; the arithmetic is that of its `update`.
    running = normalizer.state_dict()
    running["count"] += count
    rate = count / running["count"]
    difference = average - running["_mean"]
    running["_mean"] += rate * difference
    # The distance from the old mean times that from the new one.
    total_variance = variance + difference * (average - running["_mean"])
    running["_var"] += rate * (total_variance - running["_var"])
    running["_std"].copy_(running["_var"].sqrt())


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Replace each gradient by its mean over ranks; a parameter without one counts as zero.

    All ranks must give the same parameters: asking which have gradients would wait for a GPU.
    """
    if world_size() == 1:
        return
    gradients = []
    for parameter in parameters:
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
        gradients.append(parameter.grad)
    # One message for all of them.
    flat = mean(torch.cat([gradient.reshape(-1) for gradient in gradients]))
    pieces = flat.split([gradient.numel() for gradient in gradients])
    for gradient, piece in zip(gradients, pieces, strict=True):
        gradient.copy_(piece.view_as(gradient))


def broadcast(module: nn.Module) -> None:
    """Copy the parameters and buffers of rank 0 to all other ranks."""
    if world_size() > 1:
        for tensor in module.state_dict().values():
            dist.broadcast(tensor, src=0)
