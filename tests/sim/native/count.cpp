// Counts what each of several threads does.
#include "../../../src/renet/sim/native/work.h"

typedef long long int64;

struct Count {
    Work work;
    bool flag;
    int64 size;
    int things;
    float* done;     // [things]
    float* threads;
};

static void count(Count& call) {
    call.threads[join(call.work)] += 1.0f;
    call.size = sizeof(Count);
    call.flag = false;
    for (int first; (first = take(call.work, 3)) < call.things;)
        for (int i = first; i < first + 3 && i < call.things; ++i) call.done[i] += 1.0f;
}
