"""How learning uses the machine: bfloat16 where it is faster, learners side by side, memory kept.

Actor, log-probabilities and losses stay in single precision, on a GPU by TF32 unless `float32` is
asked for; what is exported is not touched.
"""

import ctypes
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Semaphore
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn

T = TypeVar("T")
Precision = Literal["auto", "float32", "bfloat16"]

TRIM_THRESHOLD, MMAP_MAX, ARENA_MAX = -1, -4, -8
"""Parameters of glibc's `mallopt`, from its malloc.h."""
NEVER = 2**31 - 1

_workers = ThreadPoolExecutor(2, thread_name_prefix="renet-learn")
"""One for each level on which work is divided: `side_by_side` inside `side_by_side`."""
_half = 0
"""Number of threads in half of torch's; 0 where work is not divided."""
_idle = Semaphore(1)
"""How many halves have nothing to do, besides that of the thread that divides the work."""


def has_bfloat16(device: torch.device) -> bool:
    """Whether the hardware multiplies bfloat16: NVIDIA from Ampere on, CPUs with AVX-512 BF16."""
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    return torch.cpu._is_avx512_bf16_supported()


def multiply_by_onednn() -> bool:
    """Let oneDNN in place of MKL multiply single-precision matrices on a CPU; whether it does.

    MKL makes no use of AVX-512 on AMD's processors. torch hands oneDNN such products only where it
    may round factors to bfloat16, but that needs AMX: with it, or without AVX-512, nothing changes,
    so that products are single precision everywhere.
    """
    if not torch.cpu._is_avx512_supported() or torch.cpu._is_amx_tile_supported():
        return False
    torch.backends.mkldnn.matmul.fp32_precision = "bf16"
    return True


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
    """Let a module compute in `dtype` while inside; what it returns is single precision."""
    if dtype == torch.float32:
        yield
        return
    forward, device = module.forward, next(module.parameters()).device.type

    def rounded(value: Tensor) -> Tensor:
        with torch.autocast(device, dtype):
            return forward(value).float()

    module.forward = rounded
    try:
        yield
    finally:
        del module.forward


@contextmanager
def halved_threads(device: str | torch.device) -> Iterator[None]:
    """Let `side_by_side` give each piece of work half of torch's threads while inside.

    So does what stands between, for small tensors are done before more threads wake. On a GPU,
    and where torch has one thread, nothing changes.
    """
    global _half
    threads = torch.get_num_threads()
    if torch.device(device).type != "cpu" or threads == 1:
        yield
        return
    _half = threads // 2
    torch.set_num_threads(_half)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        _half = 0


def side_by_side(first: Callable[[], T], second: Callable[[], T]) -> tuple[T, T]:
    """Run two pieces of work, inside `halved_threads` at once if a half has nothing to do.

    Half as many threads per layer wait less for each other. Pieces may be divided once more: the
    work that ends first leaves its half to parts of the other. Each runs on as many threads
    wherever it runs, so that results do not depend on who was free.

    The pieces may each build a graph and go back through it if they share no parameters; only one
    of them may draw random numbers.
    """
    half = _half
    if not half or not _idle.acquire(blocking=False):
        return first(), second()

    def on_threads() -> T:
        torch.set_num_threads(half)  # OpenMP's number belongs to the calling thread.
        try:
            return second()
        finally:
            _idle.release()

    other = _workers.submit(on_threads)
    try:
        result = first()
    finally:
        _idle.release()
        wait([other])
        _idle.acquire()
    return result, other.result()


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
