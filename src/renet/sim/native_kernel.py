"""The per-environment loop of the native engine, in C but without a compiler to install.

Warp's bundled clang compiles the snippet below at first use. It is handed raw addresses: for each
environment it loads single-precision Warp arrays into a double-precision `MjData`, calls MuJoCo
through a function pointer, and stores the results back. Called through ctypes, it runs without the
GIL, so that several Python threads step in parallel.
"""

from __future__ import annotations

import warp as wp

ROW = 5
"""Numbers per transfer: Warp address, bytes per environment, MuJoCo address, count, type."""
FLOAT, INT, BYTE = 0, 1, 2
"""Element types: float32 to float64, int32, and bytes (bool)."""


@wp.func_native(
    """
    typedef unsigned long long u64;
    typedef void (*mj_function)(const void*, void*);
    const u64* head = (const u64*)(u64)program;
    const void* model = (const void*)head[0];
    void* data = (void*)head[1];
    mj_function call = (mj_function)head[2];
    const int loads = (int)head[3], stores = (int)head[4], guarded = (int)head[5];
    const u64* rows = head + 6;

    int* const queue = (int*)(u64)next;
    int env;
    while ((env = __atomic_fetch_add(queue, 1, __ATOMIC_RELAXED)) < count) {
        bool finite = true;
        for (int r = 0; r < loads; ++r) {
            const u64* row = rows + 5 * r;
            const char* source = (const char*)row[0] + row[1] * (u64)env;
            const int size = (int)row[3];
            if (row[4] == 0) {
                const float* from = (const float*)source;
                double* to = (double*)row[2];
                for (int i = 0; i < size; ++i) to[i] = (double)from[i];
                if (r < guarded) {
                    for (int i = 0; i < size; ++i) finite = finite && (from[i] - from[i] == 0.0f);
                }
            } else if (row[4] == 1) {
                const int* from = (const int*)source;
                int* to = (int*)row[2];
                for (int i = 0; i < size; ++i) to[i] = from[i];
            } else {
                const unsigned char* from = (const unsigned char*)source;
                unsigned char* to = (unsigned char*)row[2];
                for (int i = 0; i < size; ++i) to[i] = from[i];
            }
        }
        if (!finite) continue;
        for (int i = 0; i < repeats; ++i) call(model, data);
        for (int r = loads; r < loads + stores; ++r) {
            const u64* row = rows + 5 * r;
            float* to = (float*)((char*)row[0] + row[1] * (u64)env);
            const double* from = (const double*)row[2];
            const int size = (int)row[3];
            for (int i = 0; i < size; ++i) to[i] = (float)from[i];
        }
    }
    """
)
def _advance(program: wp.uint64, next: wp.uint64, count: int, repeats: int): ...


@wp.kernel
def advance(program: wp.uint64, next: wp.uint64, count: int, repeats: int):
    """Run a transfer program over `count` environments, calling MuJoCo `repeats` times for each.

    `next` is the address of an int32, 0 at first, by which calls on several threads share them out.
    `program` is the address of a uint64 table: model, data, function, number of loads, number of
    stores, number of leading loads that must be finite, then the rows. An environment whose state
    is not finite is left alone: its NaN stays for the task to see.
    """
    _advance(program, next, count, repeats)
