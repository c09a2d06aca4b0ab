"""Depth images and terrain heights on the CPU, in C but without a compiler to install.

Compiled by Warp's bundled clang, like native_kernel.

A call's numbers: boxes, wide shapes, bins along x and along y; then addresses of boxes (centre,
rotation by rows, half sizes: 15 floats), triangles (9 floats), bins' offsets, bins' items, each
shape's first bin (2 ints), wide shapes, and the bins' corner and side (3 floats); then what each
kernel documents. Shape s is box s, or triangle s - boxes.
"""

from __future__ import annotations

import warp as wp

from renet.sim.native_call import SHARED

wp.set_module_options({"enable_backward": False})

SHAPES = (
    SHARED
    + """
    const int boxes = (int)own[0], wides = (int)own[1], nx = (int)own[2], ny = (int)own[3];
    const float* box_data = (const float*)own[4];
    const float* triangle_data = (const float*)own[5];
    const int* offsets = (const int*)own[6];
    const int* items = (const int*)own[7];
    const int* corner = (const int*)own[8];
    const int* wide = (const int*)own[9];
    const float* frame = (const float*)own[10];
"""
)


@wp.func_native(
    SHAPES
    + """
    const float* eyes = (const float*)own[11];
    const float* rotations = (const float*)own[12];
    float* images = (float*)own[13];
    const float* left = (const float*)own[14];
    const float* up = (const float*)own[15];
    const int count = (int)own[16], width = (int)own[17], height = (int)own[18];
    const float limit = *(const float*)own[19];
    const float NEAR = 1e-6f, FAR = 1e30f, SLACK = 1e-5f;
    const float column_step = left[1] - left[0], row_step = up[1] - up[0];

    int camera;
    while ((camera = take(1)) < count) {
        const float* eye = eyes + 3 * camera;
        const float* rotation = rotations + 9 * camera;
        float* image = images + (long long)camera * width * height;
        for (int i = 0; i < width * height; ++i) image[i] = FAR;

        // Pixels that shapes' corners span, found edge by edge in front of the camera.
        int row_low, row_high, column_low, column_high;
        float nearest, c0, c1, r0, r1;
        auto begin = [&]() { nearest = FAR; c0 = r0 = FAR; c1 = r1 = -FAR; };
        auto cover = [&](float x, float y, float z) {
            const float c = (y / x - left[0]) / column_step, r = (z / x - up[0]) / row_step;
            c0 = c < c0 ? c : c0; c1 = c > c1 ? c : c1;
            r0 = r < r0 ? r : r0; r1 = r > r1 ? r : r1;
        };
        auto corner_at = [&](const float* a) {
            nearest = a[0] < nearest ? a[0] : nearest;
            if (a[0] >= NEAR) cover(a[0], a[1], a[2]);
        };
        auto edge = [&](const float* a, const float* b) {
            if ((a[0] < NEAR) == (b[0] < NEAR)) return;
            const float s = (NEAR - a[0]) / (b[0] - a[0]);
            cover(NEAR, a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2]));
        };
        auto clamp = [](float v, int most) {
            return v < 0.0f ? 0 : v > (float)most ? most : (int)v;
        };
        auto visible = [&]() {
            if (!(nearest <= limit) || !(c1 > -1.0f) || !(r1 > -1.0f)) return false;
            if (!(c0 < (float)width) || !(r0 < (float)height)) return false;
            column_low = clamp(c0 - 0.01f, width - 1); column_high = clamp(c1 + 1.01f, width);
            row_low = clamp(r0 - 0.01f, height - 1); row_high = clamp(r1 + 1.01f, height);
            return true;
        };
        auto to_camera = [&](const float* v, float* out) {
            const float x = v[0] - eye[0], y = v[1] - eye[1], z = v[2] - eye[2];
            for (int k = 0; k < 3; ++k)
                out[k] = rotation[k] * x + rotation[3 + k] * y + rotation[6 + k] * z;
        };

        auto draw_box = [&](const float* box) {
            float centre[3], axis[3][3], at[8][3], o[3];
            to_camera(box, centre);
            for (int k = 0; k < 3; ++k) {
                for (int j = 0; j < 3; ++j)
                    axis[k][j] = rotation[j] * box[3 + k] + rotation[3 + j] * box[6 + k]
                               + rotation[6 + j] * box[9 + k];
                o[k] = -(centre[0] * axis[k][0] + centre[1] * axis[k][1] + centre[2] * axis[k][2]);
            }
            const float* half = box + 12;
            begin();
            for (int v = 0; v < 8; ++v) {
                for (int j = 0; j < 3; ++j)
                    at[v][j] = centre[j] + (v & 1 ? half[0] : -half[0]) * axis[0][j]
                             + (v & 2 ? half[1] : -half[1]) * axis[1][j]
                             + (v & 4 ? half[2] : -half[2]) * axis[2][j];
                corner_at(at[v]);
            }
            for (int v = 0; v < 8; ++v)
                for (int bit = 1; bit < 8; bit *= 2)
                    if (!(v & bit)) edge(at[v], at[v | bit]);
            if (!visible()) return;
            const float x1 = axis[0][1], y1 = axis[1][1], z1 = axis[2][1];
            const float xa = -half[0] - o[0], xb = half[0] - o[0];
            const float ya = -half[1] - o[1], yb = half[1] - o[1];
            const float za = -half[2] - o[2], zb = half[2] - o[2];
            for (int i = row_low; i < row_high; ++i) {
                float* row = image + i * width;
                const float x0 = axis[0][0] + axis[0][2] * up[i];
                const float y0 = axis[1][0] + axis[1][2] * up[i];
                const float z0 = axis[2][0] + axis[2][2] * up[i];
                for (int j = column_low; j < column_high; ++j) {
                    const float ix = 1.0f / (x0 + x1 * left[j]);
                    const float iy = 1.0f / (y0 + y1 * left[j]);
                    const float iz = 1.0f / (z0 + z1 * left[j]);
                    const float ax = xa * ix, bx = xb * ix, ay = ya * iy, by = yb * iy;
                    const float az = za * iz, bz = zb * iz;
                    const float lx = ax < bx ? ax : bx, hx = ax < bx ? bx : ax;
                    const float ly = ay < by ? ay : by, hy = ay < by ? by : ay;
                    const float lz = az < bz ? az : bz, hz = az < bz ? bz : az;
                    float in = lx > ly ? lx : ly; in = in > lz ? in : lz;
                    float out = hx < hy ? hx : hy; out = out < hz ? out : hz;
                    // From inside, a ray sees where it leaves.
                    const float t = in >= 0.0f ? in : out;
                    const bool seen = (in <= out + SLACK) & (out >= 0.0f);
                    const float hit = seen ? t : FAR;
                    row[j] = hit < row[j] ? hit : row[j];
                }
            }
        };

        auto draw_triangle = [&](const float* triangle) {
            float v[3][3], e[3][3];
            begin();
            for (int k = 0; k < 3; ++k) { to_camera(triangle + 3 * k, v[k]); corner_at(v[k]); }
            if (!(nearest <= limit)) return;
            for (int k = 0; k < 3; ++k) edge(v[k], v[(k + 1) % 3]);
            if (!visible()) return;
            for (int k = 0; k < 3; ++k) {
                const float* a = v[(k + 1) % 3];
                const float* b = v[(k + 2) % 3];
                e[k][0] = a[1] * b[2] - a[2] * b[1];
                e[k][1] = a[2] * b[0] - a[0] * b[2];
                e[k][2] = a[0] * b[1] - a[1] * b[0];
            }
            const float volume = v[0][0] * e[0][0] + v[0][1] * e[0][1] + v[0][2] * e[0][2];
            const float sign = volume < 0.0f ? -1.0f : 1.0f, size = volume * sign;
            if (size == 0.0f) return;
            for (int k = 0; k < 9; ++k) e[k / 3][k % 3] *= sign;
            for (int i = row_low; i < row_high; ++i) {
                float* row = image + i * width;
                const float a0 = e[0][0] + e[0][2] * up[i], a1 = e[0][1];
                const float b0 = e[1][0] + e[1][2] * up[i], b1 = e[1][1];
                const float d0 = e[2][0] + e[2][2] * up[i], d1 = e[2][1];
                for (int j = column_low; j < column_high; ++j) {
                    const float a = a0 + a1 * left[j], b = b0 + b1 * left[j];
                    const float d = d0 + d1 * left[j], sum = a + b + d, edge = -SLACK * sum;
                    const bool seen = (a >= edge) & (b >= edge) & (d >= edge) & (sum > 0.0f);
                    const float hit = seen ? size / sum : FAR;
                    row[j] = hit < row[j] ? hit : row[j];
                }
            }
        };
        auto draw_shape = [&](int shape) {
            if (shape < boxes) draw_box(box_data + 15 * shape);
            else draw_triangle(triangle_data + 9 * (shape - boxes));
        };

        // The pyramid in view, from above.
        float low[2] = {eye[0], eye[1]}, high[2] = {eye[0], eye[1]}, whole = eye[2] - eye[2];
        for (int k = 0; k < 9; ++k) whole += rotation[k] - rotation[k];
        for (int k = 0; k < 4; ++k) {
            const float l = left[k & 1 ? width - 1 : 0], u = up[k & 2 ? height - 1 : 0];
            for (int j = 0; j < 2; ++j) {
                const float* r = rotation + 3 * j;
                const float far = eye[j] + limit * (r[0] + r[1] * l + r[2] * u);
                low[j] = far < low[j] ? far : low[j]; high[j] = far > high[j] ? far : high[j];
                whole += far - far;
            }
        }
        // A pose that is not finite sees nothing.
        if (whole == 0.0f) {
            for (int k = 0; k < wides; ++k) draw_shape(wide[k]);
            int from[2], to[2];
            const int bins[2] = {nx, ny};
            for (int j = 0; j < 2; ++j) {
                const float a = (low[j] - frame[j]) / frame[2], b = (high[j] - frame[j]) / frame[2];
                from[j] = clamp(a, bins[j]);
                to[j] = b < 0.0f ? 0 : clamp(b + 1.0f, bins[j]);
            }
            for (int x = from[0]; x < to[0]; ++x)
                for (int y = from[1]; y < to[1]; ++y)
                    for (int k = offsets[x * ny + y]; k < offsets[x * ny + y + 1]; ++k) {
                        // A shape in several bins is drawn in the first that is looked at.
                        const int* c = corner + 2 * items[k];
                        if (x == (c[0] > from[0] ? c[0] : from[0])
                            && y == (c[1] > from[1] ? c[1] : from[1])) draw_shape(items[k]);
                    }
        }
        for (int i = 0; i < width * height; ++i) image[i] = image[i] <= limit ? image[i] : -1.0f;
    }
    """
)
def _draw(call: wp.uint64): ...


@wp.kernel
def draw(call: wp.uint64):
    """Depth images; -1 where nothing is within a limit.

    The call goes on with addresses of positions [N, 3], rotations [N, 3, 3], images [N, height,
    width], and what rays' left [width] and up [height] components are, both evenly spaced; then N,
    width, height, and the address of the limit.
    """
    _draw(call)


@wp.func_native(
    SHAPES
    + """
    const float* positions = (const float*)own[11];
    const float* rotations = (const float*)own[13];
    const long long stride = (long long)own[12], turn = (long long)own[14];
    const int parts = (int)own[15];
    const long long* part = (const long long*)own[16];
    const float* pattern = (const float*)own[17];
    float* clearances = (float*)own[18];
    const int count = (int)own[19], points = (int)own[20];
    const float top = ((const float*)own[21])[0], drop = ((const float*)own[21])[1];
    const float SLACK = 1e-6f;
    int frame_number;
    while ((frame_number = take(1)) < count) {
        const long long row = frame_number / parts, column = part[frame_number % parts];
        const float* origin = positions + stride * row + 3 * column;
        float cosine = 1.0f, sine = 0.0f;
        if (rotations) {
            const float* rotation = rotations + turn * row + 9 * column;
            const float a = rotation[0], b = rotation[3], size = __builtin_sqrtf(a * a + b * b);
            cosine = a / (size > 1e-12f ? size : 1e-12f);
            sine = b / (size > 1e-12f ? size : 1e-12f);
        }
        for (int point = 0; point < points; ++point) {
            const float* at = pattern + 2 * point;
            const float x = origin[0] + cosine * at[0] - sine * at[1];
            const float y = origin[1] + sine * at[0] + cosine * at[1];
            float highest = top - drop;
            auto look = [&](int shape) {
                if (shape < boxes) {
                    const float* box = box_data + 15 * shape;
                    const float p[3] = {x - box[0], y - box[1], top - box[2]};
                    float in = -1e30f, out = 1e30f;
                    for (int k = 0; k < 3; ++k) {
                        const float o = p[0] * box[3 + k] + p[1] * box[6 + k] + p[2] * box[9 + k];
                        const float d = -box[9 + k], half = box[12 + k] + SLACK;
                        if (d > -1e-9f && d < 1e-9f) {
                            if (o < -half || o > half) return;
                            continue;
                        }
                        const float a = (-box[12 + k] - o) / d, b = (box[12 + k] - o) / d;
                        const float l = a < b ? a : b, h = a < b ? b : a;
                        in = l > in ? l : in; out = h < out ? h : out;
                    }
                    if (in <= out && top - in > highest) highest = top - in;
                    return;
                }
                const float* t = triangle_data + 9 * (shape - boxes);
                float weight[3], sum = 0.0f;
                for (int k = 0; k < 3; ++k) {
                    const float* a = t + 3 * ((k + 1) % 3);
                    const float* b = t + 3 * ((k + 2) % 3);
                    weight[k] = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x);
                    sum += weight[k];
                }
                if (sum == 0.0f) return;
                const float scale = 1.0f / sum;
                for (int k = 0; k < 3; ++k) if (weight[k] * scale < -SLACK) return;
                const float z = (weight[0] * t[2] + weight[1] * t[5] + weight[2] * t[8]) * scale;
                highest = z > highest ? z : highest;
            };
            if (x - x == 0.0f && y - y == 0.0f) {
                for (int k = 0; k < wides; ++k) look(wide[k]);
                const float u = (x - frame[0]) / frame[2], v = (y - frame[1]) / frame[2];
                if (u >= 0.0f && v >= 0.0f && u < (float)nx && v < (float)ny) {
                    const int bin = (int)u * ny + (int)v;
                    for (int k = offsets[bin]; k < offsets[bin + 1]; ++k) look(items[k]);
                }
            }
            clearances[(long long)frame_number * points + point] = origin[2] - highest;
        }
    }
    """
)
def _scan(call: wp.uint64): ...


@wp.kernel
def scan(call: wp.uint64):
    """Height of frames over the highest surface at each point of a pattern around them.

    Where there is no surface it is taken to be at top - drop. The call goes on with the address of
    positions [N, B, 3] and the floats from one row to the next; the same of rotations [N, B, 3, 3],
    whose yaw turns the pattern, or 0; how many of the B are looked at, and the address of which;
    addresses of the pattern [P, 2] and of the results [frames, P]; frames, P, and the address of
    top and drop.
    """
    _scan(call)
