"""How learning uses the machine: bfloat16 where it is faster, networks side by side, memory kept.

Actor, log-probabilities and losses stay in single precision, on a GPU by TF32 unless `float32` is
asked for; what is exported is not touched.
"""

import ctypes
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn

T = TypeVar("T")
Precision = Literal["auto", "float32", "bfloat16"]

TRIM_THRESHOLD, MMAP_MAX, ARENA_MAX = -1, -4, -8
"""Parameters of glibc's `mallopt`, from its malloc.h."""
NEVER = 2**31 - 1

_second = ThreadPoolExecutor(1, thread_name_prefix="renet-learn")
_spare = 0
"""Threads of torch's that are left to the second piece of work of `side_by_side`."""


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
    if device.type == "cuda":
        exact = "ieee" if precision == "float32" else "tf32"
        torch.backends.cuda.matmul.fp32_precision = torch.backends.cudnn.fp32_precision = exact
    if precision == "float32" or (precision == "auto" and not has_bfloat16(device)):
        return torch.float32
    return torch.bfloat16


@contextmanager
def computed_in(dtype: torch.dtype, module: nn.Module) -> Iterator[None]:
    """Let a module compute in `dtype` while inside; what it returns is single precision.

    Other than in single precision, in which one piece of work would take twice as long as the
    other, learning on a CPU then runs `side_by_side`, on half of torch's threads; so does what
    stands between, for small tensors are done before more threads wake.
    """
    if dtype == torch.float32:
        yield
        return
    global _spare
    forward, device = module.forward, next(module.parameters()).device.type
    threads = torch.get_num_threads()

    def rounded(value: Tensor) -> Tensor:
        with torch.autocast(device, dtype):
            return forward(value).float()

    module.forward = rounded
    _spare = threads // 2 if device == "cpu" else 0
    torch.set_num_threads(threads - _spare)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        _spare = 0
        del module.forward


def side_by_side(first: Callable[[], T], second: Callable[[], T]) -> tuple[T, T]:
    """Run two pieces of work, on a CPU inside `computed_in` at once, each on half of the threads.

    They may each build a graph and go back through it if they share no parameters; only one of
    them may draw random numbers. Half as many threads per layer wait less for each other.
    """
    if not _spare:
        return first(), second()
    spare = _spare

    def on_threads() -> T:
        torch.set_num_threads(spare)  # OpenMP's number belongs to the calling thread.
        return second()

    other = _second.submit(on_threads)
    try:
        return first(), other.result()
    finally:
        wait([other])


def keep_freed_memory() -> bool:
    """Keep what is freed, in one heap for all threads, however large; False without glibc.

    By default large tensors are mapped anew each time, and the kernel clears every page of them
    once more.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows.
        return False
    parameters = ((TRIM_THRESHOLD, NEVER), (MMAP_MAX, 0), (ARENA_MAX, 1))
    return all([mallopt(*parameter) for parameter in parameters])
