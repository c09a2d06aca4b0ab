"""The per-environment loop of the native engine, in C but without a compiler to install.

Warp's bundled clang compiles the snippet below at first use. It is handed raw addresses: for each
environment it loads single-precision Warp arrays into a double-precision `MjData`, calls MuJoCo
through function pointers, and stores the results back.
"""

from __future__ import annotations

import warp as wp

from renet.sim.native_call import SHARED

ROW = 5
"""Numbers per transfer: Warp address, bytes per environment, MuJoCo address, count, type."""
FLOAT, INT, BYTE = 0, 1, 2
"""Element types: float32 to float64, int32, and bytes (bool)."""


@wp.func_native(
    SHARED
    + """
    typedef void (*mj_function)(const void*, void*);
    const int count = (int)own[0], repeats = (int)own[1];
    const bool only_written = own[2], derive = own[3];
    const u64* program = (const u64*)own[4 + thread];
    const void* model = (const void*)program[0];
    void* data = (void*)program[1];
    u64* const shown_bodies = (u64*)program[2];
    u64* const shown_geoms = (u64*)program[3];
    const u64 whole[2] = {*shown_bodies, *shown_geoms};
    const int loads = (int)program[4], stores = (int)program[5], guarded = (int)program[6];
    char* const known = (char*)program[7];
    const int watched = (int)program[8], size_known = (int)program[9];
    const u64* const step = program + 10;
    const u64* const last_step = step + 1 + 3 * step[0];
    const u64* const derivation = last_step + 1 + 3 * last_step[0];
    const u64* const near = derivation + 1 + 3 * derivation[0];
    auto call_stages = [&](const u64* stages) {
        for (const u64* s = stages + 1; s < stages + 1 + 3 * stages[0]; s += 3) {
            *shown_bodies = s[1];
            *shown_geoms = s[2];
            ((mj_function)s[0])(model, data);
        }
    };
    const int bodies = (int)near[0], roots = (int)near[1], all_bodies = (int)near[2];
    const int* columns = (const int*)near[3];
    const float* reach = (const float*)near[4];
    float* const seen = (float*)near[5];
    const int* body = (const int*)near[6];
    const float* bounds = (const float*)near[7];
    const float half_travel = *(const float*)near[12];
    const u64* rows = near + 13;

    int env;
    while ((env = take(1)) < count) {
        char* const state = known + (u64)size_known * env;
        auto written = [&]() {
            const char* before = state;
            for (int r = 0; r < watched; ++r) {
                const u64* row = rows + 5 * r;
                const char* now = (const char*)row[0] + row[1] * (u64)env;
                for (u64 i = 0; i < 4 * row[3]; ++i) if (now[i] != before[i]) return true;
                before += 4 * row[3];
            }
            return false;
        };
        if (only_written && !written()) continue;

        // Which static bodies can collide; a position that is not finite is near them all.
        const float* qpos = (const float*)((const char*)rows[0] + rows[1] * (u64)env);
        float* const last = seen + 2 * roots * (u64)env;
        bool moved = false;
        for (int r = 0; bodies && r < 2 * roots; ++r) {
            const float by = qpos[columns[r / 2] + r % 2] - last[r];
            moved = moved || !(by <= half_travel && by >= -half_travel);
        }
        if (moved) {
            for (int r = 0; r < 2 * roots; ++r) last[r] = qpos[columns[r / 2] + r % 2];
            for (int b = 0; b < bodies; ++b) {
                const float* low = bounds + 4 * b;
                bool touches = false;
                for (int r = 0; r < roots; ++r) {
                    const float x = last[2 * r], y = last[2 * r + 1], far = reach[r];
                    touches = touches || !(x < low[0] - far || x > low[2] + far
                                           || y < low[1] - far || y > low[3] + far);
                }
                for (int k = 0; k < 2; ++k)
                    ((int*)near[8 + k])[all_bodies * (u64)env + body[b]]
                        = touches ? ((const int*)near[10 + k])[body[b]] : 0;
            }
        }

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
                    for (int i = 0; i < size; ++i)
                        finite = finite && (from[i] - from[i] == 0.0f);
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
        for (int i = 1; i < repeats; ++i) call_stages(step);
        call_stages(last_step);
        if (derive) call_stages(derivation);
        *shown_bodies = whole[0];
        *shown_geoms = whole[1];
        for (int r = loads; r < loads + stores; ++r) {
            const u64* row = rows + 5 * r;
            float* to = (float*)((char*)row[0] + row[1] * (u64)env);
            const double* from = (const double*)row[2];
            const int size = (int)row[3];
            for (int i = 0; i < size; ++i) to[i] = (float)from[i];
        }
        char* keep = state;
        for (int r = 0; derive && r < watched; ++r) {
            const u64* row = rows + 5 * r;
            const char* now = (const char*)row[0] + row[1] * (u64)env;
            for (u64 i = 0; i < 4 * row[3]; ++i) *keep++ = now[i];
        }
    }
    """
)
def _advance(call: wp.uint64): ...


@wp.kernel
def advance(call: wp.uint64):
    """Load, step or derive, and store environments.

    The call's numbers: environments; how many steps each takes; whether only those whose state was
    written since the last time are looked at; whether to derive what the last step left behind;
    then the address of each thread's program: model, data, addresses of the model's numbers of
    bodies and geoms, numbers of loads, of stores and of leading loads that must be finite; where
    states as they are left are kept, number of leading loads they are made of and bytes of an
    environment; number of stages and Pipeline's stages of a step, the same of the last, the same of
    what derives; Neighbourhood.numbers; then the rows, that of qpos first.

    An environment whose state is not finite is left alone: its NaN stays for the task to see.
    """
    _advance(call)
