"""Use of the machine while learning: bfloat16, pieces of work side by side, and freed memory.

Critics and the depth embedding learn in bfloat16 where that is faster. Actor, log-probabilities
and losses stay in single precision, on a GPU by TF32 unless `float32` is asked for. Exported
networks are single precision everywhere.
"""

import ctypes
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Semaphore
from typing import Literal, TypeVar

import torch
from torch import Tensor, nn

_T = TypeVar("_T")
Precision = Literal["auto", "float32", "bfloat16"]

# Parameters of glibc's `mallopt`, from its malloc.h.
M_TRIM_THRESHOLD = -1
M_MMAP_MAX = -4
M_ARENA_MAX = -8
LARGEST_THRESHOLD = 2**31 - 1
"""Threshold in bytes that no heap reaches: memory is never given back to the system."""

_workers = ThreadPoolExecutor(2, thread_name_prefix="renet-learn")
"""One worker for each level of division: `side_by_side` inside `side_by_side`."""
_half = 0
"""Number of threads in half of torch's; 0 outside `halve_threads`."""
_idle = Semaphore(1)
"""Number of halves without work, besides the half of the thread that divides the work."""


def has_bfloat16(device: torch.device) -> bool:
    """Return True if the hardware multiplies bfloat16.

    NVIDIA GPUs do from Ampere on, CPUs with AVX-512 BF16.
    """
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    return torch.cpu._is_avx512_bf16_supported()


def multiply_by_onednn() -> bool:
    """Multiply single-precision matrices on a CPU by oneDNN in place of MKL, where that is exact.

    MKL makes no use of AVX-512 on AMD's processors. torch gives such products to oneDNN only if
    oneDNN may round factors to bfloat16, which it does only on CPUs with AMX. This function
    therefore changes nothing on a CPU with AMX, or without AVX-512.

    Returns:
        True if oneDNN multiplies from now on.
    """
    if not torch.cpu._is_avx512_supported() or torch.cpu._is_amx_tile_supported():
        return False
    torch.backends.mkldnn.matmul.fp32_precision = "bf16"
    return True


def learning_type(precision: Precision, device: str | torch.device) -> torch.dtype:
    """Return the type in which critics and the depth embedding learn.

    On a GPU this also sets the precision of all other layers: TF32 unless `precision` is `float32`.
    """
    device = torch.device(device)
    if device.type == "cuda":
        mode = "ieee" if precision == "float32" else "tf32"
        torch.backends.cuda.matmul.fp32_precision = mode
        torch.backends.cudnn.fp32_precision = mode
    if precision == "float32":
        return torch.float32
    if precision == "auto" and not has_bfloat16(device):
        return torch.float32
    return torch.bfloat16


@contextmanager
def compute_in(dtype: torch.dtype, module: nn.Module) -> Iterator[None]:
    """Context in which a module computes in `dtype`; its outputs are single precision."""
    if dtype == torch.float32:
        yield
        return
    forward = module.forward
    device = next(module.parameters()).device.type

    def autocast_forward(value: Tensor) -> Tensor:
        with torch.autocast(device, dtype):
            return forward(value).float()

    # An attribute of the instance hides the method of its class until it is deleted.
    module.forward = autocast_forward
    try:
        yield
    finally:
        del module.forward


@contextmanager
def halve_threads(device: str | torch.device) -> Iterator[None]:
    """Context in which each piece of work of `side_by_side` runs on half of torch's threads.

    Work outside `side_by_side` runs on half of them, too: small tensors are done before more
    threads wake. On a GPU, and where torch has one thread, nothing changes.
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


def side_by_side(first: Callable[[], _T], second: Callable[[], _T]) -> tuple[_T, _T]:
    """Run two functions, inside `halve_threads` at the same time if half of the threads are idle.

    Half as many threads per layer wait less for each other. A function may call `side_by_side`
    itself: the one that ends first leaves its half of the threads to parts of the other. Each part
    runs on the same number of threads in any case, so that results do not depend on timing.

    Args:
        first: Runs on the calling thread.
        second: Runs beside it. The two may compute gradients if they share no parameters, and only
            one of them may draw random numbers.

    Returns:
        Both results.
    """
    half = _half
    if not half or not _idle.acquire(blocking=False):
        return first(), second()

    def run_second() -> _T:
        # OpenMP has a number of threads for each calling thread.
        torch.set_num_threads(half)
        try:
            return second()
        finally:
            # Parts of `first` may use this half from now on.
            _idle.release()

    future = _workers.submit(run_second)
    try:
        result = first()
    finally:
        # Parts of `second` may use this thread's half until it ends.
        _idle.release()
        wait([future])
        _idle.acquire()
    return result, future.result()


def keep_freed_memory() -> bool:
    """Keep freed memory in the process, in one heap for all threads.

    By default the kernel maps and clears the pages of a large tensor each time it is allocated.

    Returns:
        True if the C library is glibc and accepted the settings.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        # macOS, musl, Windows.
        return False
    trim = mallopt(M_TRIM_THRESHOLD, LARGEST_THRESHOLD)
    mmap = mallopt(M_MMAP_MAX, 0)
    arena = mallopt(M_ARENA_MAX, 1)
    return all((trim, mmap, arena))
