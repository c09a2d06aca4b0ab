"""Agreement between ranks; every function is the identity in a single process."""

from collections.abc import Iterable

import torch
import torch.distributed as dist
from rsl_rl.modules import EmpiricalNormalization
from torch import Tensor, nn


def world_size() -> int:
    """Number of processes that train one model."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def mean(value: Tensor) -> Tensor:
    """Average a tensor over ranks."""
    if world_size() == 1:
        return value
    total = value.clone()
    dist.all_reduce(total)
    return total / world_size()


def moments(value: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and (population) variance over the first axis of all ranks' rows, as many on each."""
    average = mean(value.mean(0))
    variance = mean(((value - average) ** 2).mean(0))
    return average, variance


def update_normalizer(normalizer: EmpiricalNormalization, rows: Tensor) -> None:
    """Let a normaliser learn from all ranks' rows [B, C], as if one process had them all.

    Ranks exchange moments, 2 * C numbers, rather than rows.
    """
    if world_size() == 1:
        normalizer.update(rows)
        return
    average, variance = moments(rows)
    count = rows.shape[0] * world_size()
    # The buffers themselves, by their names in checkpoints; the arithmetic is that of `update`.
    running = normalizer.state_dict()
    running["count"] += count
    rate = count / running["count"]
    difference = average - running["_mean"]
    running["_mean"] += rate * difference
    # With the new mean: the product is that of both distances.
    spread = variance + difference * (average - running["_mean"])
    running["_var"] += rate * (spread - running["_var"])
    running["_std"].copy_(running["_var"].sqrt())


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Replace each gradient by its mean over ranks, where one that is missing counts as zero.

    All ranks must name the same parameters: asking which have gradients would wait for a GPU.
    """
    if world_size() == 1:
        return
    gradients = []
    for parameter in parameters:
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
        gradients.append(parameter.grad)
    flat = mean(torch.cat([g.reshape(-1) for g in gradients]))
    for gradient, piece in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(piece.view_as(gradient))


def broadcast(module: nn.Module) -> None:
    """Give every rank the parameters and buffers of rank 0."""
    if world_size() > 1:
        for tensor in module.state_dict().values():
            dist.broadcast(tensor, src=0)
