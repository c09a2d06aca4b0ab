"""How learning uses the machine: bfloat16 where it is faster, independent networks side by side.

Actor, log-probabilities and losses always stay in single precision; what acts and what is exported
is not touched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor, nn

from renet.sim.threads import one_torch_thread

T = TypeVar("T")
Precision = Literal["auto", "float32", "bfloat16"]

_second = ThreadPoolExecutor(1, thread_name_prefix="renet-learn")


def has_bfloat16(device: torch.device) -> bool:
    """Whether the hardware multiplies bfloat16: NVIDIA from Ampere on, CPUs with AVX-512 BF16."""
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    return torch.cpu._is_avx512_bf16_supported()


def learning_type(precision: Precision, device: str | torch.device) -> torch.dtype:
    """What critics and the depth embedding learn in.

    On a GPU anything but `float32` also lets the other layers use TF32.
    """
    device = torch.device(device)
    if device.type == "cuda" and precision != "float32":
        torch.set_float32_matmul_precision("high")
        torch.backends.cudnn.allow_tf32 = True
    if precision == "float32" or (precision == "auto" and not has_bfloat16(device)):
        return torch.float32
    return torch.bfloat16


@contextmanager
def computed_in(dtype: torch.dtype, *modules: nn.Module) -> Iterator[None]:
    """Let modules compute in `dtype` while inside; what they return is single precision."""
    if dtype == torch.float32:
        yield
        return
    for module in modules:
        module.forward = partial(_autocast, module.forward, dtype)
    try:
        yield
    finally:
        for module in modules:
            del module.forward


def _autocast(forward: Callable[..., Tensor], dtype: torch.dtype, value: Tensor) -> Tensor:
    with torch.autocast(value.device.type, dtype):
        return forward(value).float()


def side_by_side(first: Callable[[], T], second: Callable[[], T]) -> tuple[T, T]:
    """Run two pieces of work on a CPU, each on half of torch's threads.

    They may each build a graph and go back through it if they share no parameters; only one of
    them may draw random numbers. Half as many threads per layer wait less for each other.
    """
    threads = torch.get_num_threads()
    if threads == 1:
        return first(), second()
    share = threads // 2
    torch.set_num_threads(share)
    try:
        other = _second.submit(_on_threads, share, second)
        try:
            return first(), other.result()
        finally:
            wait([other])
    finally:
        torch.set_num_threads(threads)


def step_on_one_thread(optimizer: torch.optim.Optimizer) -> None:
    """Let an optimiser of small tensors on a CPU wake no other thread: its steps take a third."""
    device = optimizer.param_groups[0]["params"][0].device
    held = ExitStack()
    optimizer.register_step_pre_hook(lambda *_: held.enter_context(one_torch_thread(device)))
    optimizer.register_step_post_hook(lambda *_: held.close())


def _on_threads(share: int, work: Callable[[], Any]) -> Any:
    torch.set_num_threads(share)  # OpenMP's number belongs to the calling thread.
    return work()
