// Steps many environments with C MuJoCo: for each one, copies single-precision Warp arrays into a
// double-precision mjData, calls MuJoCo's functions, and copies the results back.
#include "work.h"

typedef long long int64;
typedef void (*mj_function)(const void* model, void* data);

// One field of an environment, in a Warp array and in MuJoCo's memory.
struct Copy {
    char* warp;    // Of environment 0.
    int64 stride;  // Bytes from one environment to the next.
    char* mujoco;
    int64 count;
    bool convert;  // float in Warp and double in MuJoCo; else plain bytes, `count` of them.
};

// A function of MuJoCo, and the numbers of bodies and geoms of the model that it gets.
struct Stage {
    void* function;  // Null: a physics step begins, see `drive`.
    int64 bodies;
    int64 geoms;
};

// One thread's model and data.
struct Worker {
    void* model;
    void* data;
    int64* nbody;  // In the model; smaller while a stage gets a part of it.
    int64* ngeom;
    int64 bodies;  // In the whole model.
    int64 geoms;
    const Copy* loads;
    int num_loads;
    int num_finite;  // Leading loads that must be finite.
    const Copy* stores;
    int num_stores;
    const double* qvel;
    double* ctrl;
    double* forcerange;  // Of the actuators.
};

// Static bodies that are kept out of collision detection while no root of a robot is near.
struct Culling {
    int bodies;        // 0: nothing is culled.
    int roots;         // Of an environment.
    int model_bodies;
    const int* body;       // [bodies] their ids.
    const float* bounds;   // [bodies, 4] low x, low y, high x, high y, m.
    const int* column;     // [roots] where in qpos a root's position begins.
    const float* reach;    // [roots] m.
    float half_travel;     // m that a root may move before bodies are culled anew.
    float* last;           // [N, roots, 2] m, positions of roots when that was last done.
    int* contype;          // [N, model_bodies] collision masks.
    int* conaffinity;
    const int* whole_contype;      // [model_bodies] the model's own.
    const int* whole_conaffinity;
};

// Servos whose targets come late, and whose torque falls with speed.
struct Motors {
    int actuators;
    int substeps;       // Physics steps of a control step.
    int kept;           // Targets that are remembered; 0: none comes late.
    const int* lag;     // [N, actuators] physics steps by which targets are late.
    float* targets;     // [N, kept, actuators] newest first; NaN: none since the reset.
    const float* speed; // [N, actuators] no-load speed, rad/s; null: torque does not fall.
    const int* dof;     // [actuators] degree of freedom that each of them drives.
    const char* limits; // [N, actuators, 2] lowest and highest torque at rest, N m.
    int64 stride;       // Bytes of `limits` from one environment to the next.
};

struct Advance {
    Work work;
    int environments;
    const Stage* stages;
    int num_stages;
    bool derives;       // Whether they end with all that follows from the pose.
    bool only_written;  // Whether to skip environments with the same pose as in `last_pose`.
    const bool* at_rest;  // [N] environments that are skipped in any case.
    Culling culling;
    Motors motors;
    const Worker* workers;  // One for each thread that finds an environment.
    const Copy* pose;       // qpos first.
    int num_pose;
    char* last_pose;        // [N, pose_bytes] the poses that all else was derived from.
    int64 pose_bytes;
};

static char* in_warp(const Copy& copy, int env) { return copy.warp + copy.stride * env; }

static bool is_written(const Advance& call, int env) {
    const char* before = call.last_pose + call.pose_bytes * env;
    for (int c = 0; c < call.num_pose; ++c) {
        const char* now = in_warp(call.pose[c], env);
        const int64 bytes = sizeof(float) * call.pose[c].count;
        for (int64 i = 0; i < bytes; ++i)
            if (now[i] != before[i]) return true;
        before += bytes;
    }
    return false;
}

static void keep_pose(const Advance& call, int env) {
    char* to = call.last_pose + call.pose_bytes * env;
    for (int c = 0; c < call.num_pose; ++c) {
        const int64 bytes = sizeof(float) * call.pose[c].count;
        __builtin_memcpy(to, in_warp(call.pose[c], env), bytes);
        to += bytes;
    }
}

// Whether a root has moved far; true for a position that is not finite.
static bool has_moved(const Culling& culling, const float* qpos, const float* last) {
    for (int r = 0; r < 2 * culling.roots; ++r) {
        const float by = qpos[culling.column[r / 2] + r % 2] - last[r];
        if (!(by <= culling.half_travel && by >= -culling.half_travel)) return true;
    }
    return false;
}

// Whether a body is within reach of a root; true for a position that is not finite.
static bool is_near(const Culling& culling, const float* roots, const float* bounds) {
    for (int r = 0; r < culling.roots; ++r) {
        const float x = roots[2 * r], y = roots[2 * r + 1], reach = culling.reach[r];
        if (!(x < bounds[0] - reach || x > bounds[2] + reach || y < bounds[1] - reach
              || y > bounds[3] + reach)) return true;
    }
    return false;
}

static void cull(const Advance& call, int env) {
    const Culling& culling = call.culling;
    if (!culling.bodies) return;
    const float* qpos = (const float*)in_warp(call.pose[0], env);
    float* const last = culling.last + 2 * (int64)culling.roots * env;
    if (!has_moved(culling, qpos, last)) return;
    for (int r = 0; r < 2 * culling.roots; ++r) last[r] = qpos[culling.column[r / 2] + r % 2];
    for (int b = 0; b < culling.bodies; ++b) {
        const bool near = is_near(culling, last, culling.bounds + 4 * b);
        const int body = culling.body[b];
        const int64 at = (int64)culling.model_bodies * env + body;
        culling.contype[at] = near ? culling.whole_contype[body] : 0;
        culling.conaffinity[at] = near ? culling.whole_conaffinity[body] : 0;
    }
}

// False if the state is not finite, and must not be stepped.
static bool load(const Worker& worker, int env) {
    for (int c = 0; c < worker.num_loads; ++c) {
        const Copy& copy = worker.loads[c];
        if (!copy.convert) {
            __builtin_memcpy(copy.mujoco, in_warp(copy, env), copy.count);
            continue;
        }
        const float* from = (const float*)in_warp(copy, env);
        double* to = (double*)copy.mujoco;
        bool finite = true;
        for (int64 i = 0; i < copy.count; ++i) {
            to[i] = (double)from[i];
            finite = finite && (from[i] - from[i] == 0.0f);
        }
        if (!finite && c < worker.num_finite) return false;
    }
    return true;
}

static void store(const Worker& worker, int env) {
    for (int c = 0; c < worker.num_stores; ++c) {
        const Copy& copy = worker.stores[c];
        float* to = (float*)in_warp(copy, env);
        const double* from = (const double*)copy.mujoco;
        for (int64 i = 0; i < copy.count; ++i) to[i] = (float)from[i];
    }
}

// Take in the target of a new control step. The first one after a reset counts as all before it.
static void remember(const Motors& motors, const double* ctrl, int env) {
    const int size = motors.actuators;
    float* const targets = motors.targets + (int64)motors.kept * size * env;
    for (int a = 0; a < size; ++a) {
        const bool first = targets[a] != targets[a];
        for (int k = motors.kept - 1; k > 0; --k)
            targets[k * size + a] = first ? (float)ctrl[a] : targets[(k - 1) * size + a];
        targets[a] = (float)ctrl[a];
    }
}

// Give the servos the target that has reached them at a physics step of a control step.
static void delay(const Motors& motors, const Worker& worker, int env, int step) {
    if (step == 0) remember(motors, worker.ctrl, env);
    const int size = motors.actuators;
    const float* targets = motors.targets + (int64)motors.kept * size * env;
    const int* lag = motors.lag + (int64)size * env;
    for (int a = 0; a < size; ++a) {
        const int late = lag[a] - step;
        const int age = late > 0 ? (late + motors.substeps - 1) / motors.substeps : 0;
        worker.ctrl[a] = targets[age * size + a];
    }
}

// The share of its torque at rest that a motor has at a speed in the torque's direction.
static double torque_share(double speed, double no_load) {
    const double share = 1.0 - speed / no_load;
    return share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
}

// Let torque fall linearly to zero at the no-load speed; a motor brakes with all of it.
static void limit(const Motors& motors, const Worker& worker, int env) {
    const float* limits = (const float*)(motors.limits + motors.stride * env);
    const float* no_load = motors.speed + (int64)motors.actuators * env;
    for (int a = 0; a < motors.actuators; ++a) {
        const double speed = worker.qvel[motors.dof[a]];
        worker.forcerange[2 * a] = limits[2 * a] * torque_share(-speed, no_load[a]);
        worker.forcerange[2 * a + 1] = limits[2 * a + 1] * torque_share(speed, no_load[a]);
    }
}

// What motors do at the beginning of a physics step.
static void drive(const Motors& motors, const Worker& worker, int env, int step) {
    if (motors.kept) delay(motors, worker, env, step);
    if (motors.speed) limit(motors, worker, env);
}

// An environment whose state is not finite is skipped, and keeps its NaN for the task to see.
static void advance(Advance& call) {
    const int number = join(call.work);
    if (number >= call.environments) return;
    const Worker& worker = call.workers[number];
    for (int env; (env = take(call.work, 1)) < call.environments;) {
        if (call.at_rest[env] || (call.only_written && !is_written(call, env))) continue;
        cull(call, env);
        if (!load(worker, env)) continue;
        for (int s = 0, step = 0; s < call.num_stages; ++s) {
            if (!call.stages[s].function) {
                drive(call.motors, worker, env, step++);
                continue;
            }
            *worker.nbody = call.stages[s].bodies;
            *worker.ngeom = call.stages[s].geoms;
            ((mj_function)call.stages[s].function)(worker.model, worker.data);
        }
        *worker.nbody = worker.bodies;
        *worker.ngeom = worker.geoms;
        store(worker, env);
        if (call.derives) keep_pose(call, env);
    }
}
