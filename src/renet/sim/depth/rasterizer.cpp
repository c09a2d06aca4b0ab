// Depth images and terrain heights on the CPU: each shape near the camera fills the pixels that it
// covers, in rows that the compiler vectorises.
#include "../native/work.h"

typedef long long int64;

struct Box {
    float centre[3];
    float rotation[9];  // By rows.
    float half[3];
};

struct Triangle {
    float corner[3][3];
};

// Shapes in square bins, seen from above. Shape s is box s, or triangle s - num_boxes.
struct Terrain {
    const Box* boxes;
    const Triangle* triangles;
    int num_boxes;
    const int* wide;       // Shapes that are in no bin and always drawn.
    int num_wide;
    int bins_x;
    int bins_y;
    float corner_x;        // Of the first bin, m.
    float corner_y;
    float side;            // Of a bin, m.
    const int* offsets;    // [bins + 1] where each bin's shapes begin in `items`; y varies fastest.
    const int* items;
    const int* first_bin;  // [shapes, 2] the lowest bin in x and y that each is in.
};

struct Draw {
    Work work;
    Terrain terrain;
    int cameras;
    const float* eyes;       // [cameras, 3] m, world.
    const float* rotations;  // [cameras, 3, 3] axes (forward, left, up) as columns.
    int width;
    int height;
    const float* left;  // [width] of rays with forward component 1, evenly spaced.
    const float* up;    // [height].
    float limit;        // m beyond which nothing is seen.
    float* images;      // [cameras, height, width] m; -1 where nothing is seen.
};

struct Scan {
    Work work;
    Terrain terrain;
    int frames;
    const float* positions;  // [frames, 3] m, world.
    const float* rotations;  // [frames, 3, 3] whose yaw turns the pattern; NULL: it is not turned.
    const float* pattern;    // [points, 2] m around each frame.
    int points;
    float top;               // m, above all terrain.
    float drop;              // m below the top where terrain is taken to be if there is none.
    float* clearances;       // [frames, points] m.
};

// One camera, with the image that is being drawn.
struct View {
    const Draw* call;
    const float* eye;
    const float* rotation;
    float* image;
};

// The pixels that a shape spans, from its corners and edges in front of the camera.
struct Span {
    float nearest;
    float column[2];
    float row[2];
    int columns[2];  // Half-open ranges.
    int rows[2];
};

static float near_plane() { return 1e-6f; }
static float far() { return 1e30f; }

static void to_camera(const View& view, const float* point, float* out) {
    const float* rotation = view.rotation;
    const float x = point[0] - view.eye[0], y = point[1] - view.eye[1];
    const float z = point[2] - view.eye[2];
    for (int k = 0; k < 3; ++k)
        out[k] = rotation[k] * x + rotation[3 + k] * y + rotation[6 + k] * z;
}

static Span nothing() { return {far(), {far(), -far()}, {far(), -far()}, {0, 0}, {0, 0}}; }

static void widen(float* range, float value) {
    range[0] = value < range[0] ? value : range[0];
    range[1] = value > range[1] ? value : range[1];
}

static void cover(Span& span, const Draw& call, float x, float y, float z) {
    widen(span.column, (y / x - call.left[0]) / (call.left[1] - call.left[0]));
    widen(span.row, (z / x - call.up[0]) / (call.up[1] - call.up[0]));
}

static void cover_corner(Span& span, const Draw& call, const float* a) {
    span.nearest = a[0] < span.nearest ? a[0] : span.nearest;
    if (a[0] >= near_plane()) cover(span, call, a[0], a[1], a[2]);
}

static void cover_edge(Span& span, const Draw& call, const float* a, const float* b) {
    if ((a[0] < near_plane()) == (b[0] < near_plane())) return;
    const float s = (near_plane() - a[0]) / (b[0] - a[0]);
    cover(span, call, near_plane(), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2]));
}

static int clamp(float value, int most) {
    return value < 0.0f ? 0 : value > (float)most ? most : (int)value;
}

// Sets the rows and columns of a span; false if it is outside the image.
static bool find_pixels(Span& span, const Draw& call) {
    const int width = call.width, height = call.height;
    if (!(span.nearest <= call.limit)) return false;
    if (!(span.column[1] > -1.0f) || !(span.row[1] > -1.0f)) return false;
    if (!(span.column[0] < (float)width) || !(span.row[0] < (float)height)) return false;
    span.columns[0] = clamp(span.column[0] - 0.01f, width - 1);
    span.columns[1] = clamp(span.column[1] + 1.01f, width);
    span.rows[0] = clamp(span.row[0] - 0.01f, height - 1);
    span.rows[1] = clamp(span.row[1] + 1.01f, height);
    return true;
}

static bool find_box_pixels(
    Span& span, const Draw& call, const float* centre, const float axis[3][3], const float* half
) {
    float at[8][3];
    span = nothing();
    for (int v = 0; v < 8; ++v) {
        for (int j = 0; j < 3; ++j)
            at[v][j] = centre[j] + (v & 1 ? half[0] : -half[0]) * axis[0][j]
                     + (v & 2 ? half[1] : -half[1]) * axis[1][j]
                     + (v & 4 ? half[2] : -half[2]) * axis[2][j];
        cover_corner(span, call, at[v]);
    }
    for (int v = 0; v < 8; ++v)
        for (int bit = 1; bit < 8; bit *= 2)
            if (!(v & bit)) cover_edge(span, call, at[v], at[v | bit]);
    return find_pixels(span, call);
}

// Clips each ray to the box's three slabs, from `low` to `high` along its axes, camera frame.
static void fill_box(
    const View& view, const Span& span, const float axis[3][3], const float* low, const float* high
) {
    const float slack = 1e-5f;
    const float *left = view.call->left, *up = view.call->up;
    const int first = span.columns[0], last = span.columns[1], width = view.call->width;
    const float x1 = axis[0][1], y1 = axis[1][1], z1 = axis[2][1];
    const float xa = low[0], xb = high[0], ya = low[1], yb = high[1], za = low[2], zb = high[2];
    for (int i = span.rows[0]; i < span.rows[1]; ++i) {
        float* row = view.image + i * width;
        const float x0 = axis[0][0] + axis[0][2] * up[i];
        const float y0 = axis[1][0] + axis[1][2] * up[i];
        const float z0 = axis[2][0] + axis[2][2] * up[i];
        for (int j = first; j < last; ++j) {
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
            // A ray from inside the box sees where it leaves.
            const float t = in >= 0.0f ? in : out;
            const bool seen = (in <= out + slack) & (out >= 0.0f);
            const float hit = seen ? t : 1e30f;
            row[j] = hit < row[j] ? hit : row[j];
        }
    }
}

static void draw_box(const View& view, const Box& box) {
    const float *rotation = view.rotation, *half = box.half;
    float centre[3], axis[3][3], low[3], high[3];
    to_camera(view, box.centre, centre);
    for (int k = 0; k < 3; ++k) {
        for (int j = 0; j < 3; ++j)
            axis[k][j] = rotation[j] * box.rotation[k] + rotation[3 + j] * box.rotation[3 + k]
                       + rotation[6 + j] * box.rotation[6 + k];
        const float eye
            = -(centre[0] * axis[k][0] + centre[1] * axis[k][1] + centre[2] * axis[k][2]);
        low[k] = -half[k] - eye;
        high[k] = half[k] - eye;
    }
    Span span;
    if (find_box_pixels(span, *view.call, centre, axis, half))
        fill_box(view, span, axis, low, high);
}

// `edge` holds the normals of the planes through the eye and each edge; `size` is positive.
static void fill_triangle(
    const View& view, const Span& span, const float edge[3][3], float size
) {
    const float slack = 1e-5f;
    const float *left = view.call->left, *up = view.call->up;
    const int first = span.columns[0], last = span.columns[1], width = view.call->width;
    for (int i = span.rows[0]; i < span.rows[1]; ++i) {
        float* row = view.image + i * width;
        const float a0 = edge[0][0] + edge[0][2] * up[i], a1 = edge[0][1];
        const float b0 = edge[1][0] + edge[1][2] * up[i], b1 = edge[1][1];
        const float d0 = edge[2][0] + edge[2][2] * up[i], d1 = edge[2][1];
        for (int j = first; j < last; ++j) {
            const float a = a0 + a1 * left[j], b = b0 + b1 * left[j];
            const float d = d0 + d1 * left[j], sum = a + b + d, least = -slack * sum;
            const bool seen = (a >= least) & (b >= least) & (d >= least) & (sum > 0.0f);
            const float hit = seen ? size / sum : 1e30f;
            row[j] = hit < row[j] ? hit : row[j];
        }
    }
}

static void draw_triangle(const View& view, const Triangle& triangle) {
    const Draw& call = *view.call;
    float v[3][3], edge[3][3];
    Span span = nothing();
    for (int k = 0; k < 3; ++k) {
        to_camera(view, triangle.corner[k], v[k]);
        cover_corner(span, call, v[k]);
    }
    if (!(span.nearest <= call.limit)) return;
    for (int k = 0; k < 3; ++k) cover_edge(span, call, v[k], v[(k + 1) % 3]);
    if (!find_pixels(span, call)) return;
    for (int k = 0; k < 3; ++k) {
        const float *a = v[(k + 1) % 3], *b = v[(k + 2) % 3];
        edge[k][0] = a[1] * b[2] - a[2] * b[1];
        edge[k][1] = a[2] * b[0] - a[0] * b[2];
        edge[k][2] = a[0] * b[1] - a[1] * b[0];
    }
    const float volume = v[0][0] * edge[0][0] + v[0][1] * edge[0][1] + v[0][2] * edge[0][2];
    const float sign = volume < 0.0f ? -1.0f : 1.0f;
    if (volume == 0.0f) return;
    for (int k = 0; k < 9; ++k) edge[k / 3][k % 3] *= sign;
    fill_triangle(view, span, edge, volume * sign);
}

static void draw_shape(const View& view, const Terrain& terrain, int shape) {
    if (shape < terrain.num_boxes) draw_box(view, terrain.boxes[shape]);
    else draw_triangle(view, terrain.triangles[shape - terrain.num_boxes]);
}

// The horizontal box around the pyramid in view; false if the pose is not finite.
static bool find_ground(const View& view, float* low, float* high) {
    const Draw& call = *view.call;
    float sum = view.eye[2] - view.eye[2];
    for (int k = 0; k < 9; ++k) sum += view.rotation[k] - view.rotation[k];
    for (int j = 0; j < 2; ++j) low[j] = high[j] = view.eye[j];
    for (int k = 0; k < 4; ++k) {
        const float l = call.left[k & 1 ? call.width - 1 : 0];
        const float u = call.up[k & 2 ? call.height - 1 : 0];
        for (int j = 0; j < 2; ++j) {
            const float* r = view.rotation + 3 * j;
            const float end = view.eye[j] + call.limit * (r[0] + r[1] * l + r[2] * u);
            low[j] = end < low[j] ? end : low[j];
            high[j] = end > high[j] ? end : high[j];
            sum += end - end;
        }
    }
    return sum == 0.0f;
}

static void draw_bins(const View& view, const float* low, const float* high) {
    const Terrain& terrain = view.call->terrain;
    const float corner[2] = {terrain.corner_x, terrain.corner_y};
    const int bins[2] = {terrain.bins_x, terrain.bins_y};
    int from[2], to[2];
    for (int j = 0; j < 2; ++j) {
        const float end = (high[j] - corner[j]) / terrain.side;
        from[j] = clamp((low[j] - corner[j]) / terrain.side, bins[j]);
        to[j] = end < 0.0f ? 0 : clamp(end + 1.0f, bins[j]);
    }
    for (int x = from[0]; x < to[0]; ++x)
        for (int y = from[1]; y < to[1]; ++y) {
            const int bin = x * terrain.bins_y + y;
            for (int k = terrain.offsets[bin]; k < terrain.offsets[bin + 1]; ++k) {
                // A shape in several bins is drawn with the first of them that is in view.
                const int* first = terrain.first_bin + 2 * terrain.items[k];
                if (x == (first[0] > from[0] ? first[0] : from[0])
                    && y == (first[1] > from[1] ? first[1] : from[1]))
                    draw_shape(view, terrain, terrain.items[k]);
            }
        }
}

static void draw(Draw& call) {
    const int pixels = call.width * call.height;
    for (int camera; (camera = take(call.work, 1)) < call.cameras;) {
        float* image = call.images + (int64)camera * pixels;
        const View view = {&call, call.eyes + 3 * camera, call.rotations + 9 * camera, image};
        for (int i = 0; i < pixels; ++i) image[i] = far();
        float low[2], high[2];
        if (find_ground(view, low, high)) {
            for (int k = 0; k < call.terrain.num_wide; ++k)
                draw_shape(view, call.terrain, call.terrain.wide[k]);
            draw_bins(view, low, high);
        }
        for (int i = 0; i < pixels; ++i) image[i] = image[i] <= call.limit ? image[i] : -1.0f;
    }
}

// Where a vertical line first meets a box from above, if that is higher than `highest`.
static float over_box(const Box& box, float x, float y, float top, float highest) {
    const float slack = 1e-6f;
    const float p[3] = {x - box.centre[0], y - box.centre[1], top - box.centre[2]};
    float in = -1e30f, out = 1e30f;
    for (int k = 0; k < 3; ++k) {
        const float* r = box.rotation;
        const float o = p[0] * r[k] + p[1] * r[3 + k] + p[2] * r[6 + k];
        const float d = -r[6 + k], half = box.half[k] + slack;
        if (d > -1e-9f && d < 1e-9f) {
            if (o < -half || o > half) return highest;
            continue;
        }
        const float a = (-box.half[k] - o) / d, b = (box.half[k] - o) / d;
        const float l = a < b ? a : b, h = a < b ? b : a;
        in = l > in ? l : in;
        out = h < out ? h : out;
    }
    return in <= out && top - in > highest ? top - in : highest;
}

static float over_triangle(const Triangle& t, float x, float y, float highest) {
    const float slack = 1e-6f;
    float weight[3], sum = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const float *a = t.corner[(k + 1) % 3], *b = t.corner[(k + 2) % 3];
        weight[k] = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x);
        sum += weight[k];
    }
    if (sum == 0.0f) return highest;
    const float scale = 1.0f / sum;
    for (int k = 0; k < 3; ++k)
        if (weight[k] * scale < -slack) return highest;
    const float z = (weight[0] * t.corner[0][2] + weight[1] * t.corner[1][2]
                     + weight[2] * t.corner[2][2]) * scale;
    return z > highest ? z : highest;
}

static float over_shape(const Terrain& terrain, int shape, float x, float y, float top, float z) {
    if (shape < terrain.num_boxes) return over_box(terrain.boxes[shape], x, y, top, z);
    return over_triangle(terrain.triangles[shape - terrain.num_boxes], x, y, z);
}

static float highest_at(const Scan& call, float x, float y) {
    const Terrain& terrain = call.terrain;
    float highest = call.top - call.drop;
    if (x - x != 0.0f || y - y != 0.0f) return highest;
    for (int k = 0; k < terrain.num_wide; ++k)
        highest = over_shape(terrain, terrain.wide[k], x, y, call.top, highest);
    const float u = (x - terrain.corner_x) / terrain.side;
    const float v = (y - terrain.corner_y) / terrain.side;
    if (!(u >= 0.0f && v >= 0.0f && u < (float)terrain.bins_x && v < (float)terrain.bins_y))
        return highest;
    const int bin = (int)u * terrain.bins_y + (int)v;
    for (int k = terrain.offsets[bin]; k < terrain.offsets[bin + 1]; ++k)
        highest = over_shape(terrain, terrain.items[k], x, y, call.top, highest);
    return highest;
}

// Heights of frames over the highest surface at each point of a pattern around them.
static void scan(Scan& call) {
    for (int frame; (frame = take(call.work, 1)) < call.frames;) {
        const float* origin = call.positions + 3 * frame;
        float cosine = 1.0f, sine = 0.0f;
        if (call.rotations) {
            const float* rotation = call.rotations + 9 * frame;
            const float a = rotation[0], b = rotation[3], size = __builtin_sqrtf(a * a + b * b);
            cosine = a / (size > 1e-12f ? size : 1e-12f);
            sine = b / (size > 1e-12f ? size : 1e-12f);
        }
        float* clearance = call.clearances + (int64)frame * call.points;
        for (int point = 0; point < call.points; ++point) {
            const float* at = call.pattern + 2 * point;
            const float x = origin[0] + cosine * at[0] - sine * at[1];
            const float y = origin[1] + sine * at[0] + cosine * at[1];
            clearance[point] = origin[2] - highest_at(call, x, y);
        }
    }
}
