// Items of work that threads share: each takes more until none are left.
struct Work {
    int threads;  // How many have begun.
    int taken;    // How many items have been given out.
};

// The number of the calling thread, from 0.
static int join(Work& work) { return __atomic_fetch_add(&work.threads, 1, __ATOMIC_RELAXED); }

// The first of the next `count` items.
static int take(Work& work, int count) {
    return __atomic_fetch_add(&work.taken, count, __ATOMIC_RELAXED);
}
