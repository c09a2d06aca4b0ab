// Counts what each of several threads does.
#include "../../../src/renet/sim/native/work.h"

typedef long long int64;

struct Count {
    Work work;
    bool flag;
    int64 size;
    int things;
    int waits_for;   // Threads that must have begun before any goes on, if they soon do.
    float* done;     // [things]
    float* threads;
};

static void count(Count& call) {
    call.threads[join(call.work)] += 1.0f;
    for (int64 spins = 0; spins < (int64)1 << 33; ++spins)
        if (__atomic_load_n(&call.work.threads, __ATOMIC_RELAXED) >= call.waits_for) break;
    call.size = sizeof(Count);
    call.flag = false;
    for (int first; (first = take(call.work, 3)) < call.things;)
        for (int i = first; i < first + 3 && i < call.things; ++i) call.done[i] += 1.0f;
}
