/* One population of configs/observer.toml by hand: the filter that learns the vectors' biases.
 *
 * As pose_filter.c, from which blocks, groups and the body frame are taken, and whose gain this
 * uses; what configs/observer.toml adds (the equations are those of posegsa/filters/observer.py
 * and vectors.py):
 *   - two vectors, freed of the biases learnt so far, normalised, and their cross product: Wahba's
 *     sums are every agent's own, so that Davenport's matrix is made in each step, once for all
 *     sub-steps;
 *   - two sub-steps, the measured velocity in the last; gamma follows the square of the gain;
 *   - the vectors' bias law;
 *   - numbers of the filter that are tuned with the controller, so that every lane has its own.
 */
#include "fuzzy_gain.h"

enum { SUBSTEPS = 2, NUMBERS = 8 };

typedef struct {
    float x, y, z;
} Vec;

/* What one sample tells every agent. */
typedef struct {
    Vec measured[2], known[2]; /* vectors: body; inertial */
    Vec weighted[3];           /* weight times reference, as U uses it; the third: of the cross product */
    float attitude_offset, attitude_slope; /* signal's attitude part = offset - slope q'Kq */
    float curvature;                       /* vectors' part of L */
    Vec y, p;                              /* landmark: body, inertial [m] */
    float p_length, reach;                 /* |p| [m], |y|^2 [m^2] */
    Vec turn, shift;                       /* measured velocities times dt [rad, m] */
    Vec turning;                           /* low-passed measured angular velocity [rad/s] */
    float q_true[4];
    Vec p_true; /* R; R^T P [m] */
    float cost_weight, dt, dt_before;
} Sample;

typedef struct {
    float gain_limit, rate_scale, cost_position, initial_gain;
    float leak, per_bound, per_turning; /* of the vectors' bias law; 1 / bound^2, 1 / w_0^4 */
} Settings;

typedef struct {
    float q[4][LANES], p[3][LANES];                      /* attitude; R^T P [m] */
    float bias_angular[3][LANES], bias_linear[3][LANES]; /* [rad/s], [m/s] */
    float vector_bias[2][3][LANES];
    float signal[LANES], gain[LANES], cost[LANES];
    /* The agent's own, in the order of the caller's array. */
    float half_weight[LANES], unit[LANES];                   /* s/2; l^2 [m^2] */
    float gamma_angular[LANES], gamma_linear[LANES];         /* at K = 10/s */
    float learning[LANES];                                   /* gamma_c at K = 10/s [1/s] */
    float position_weight[LANES], smoothing[LANES], signal_scale[LANES];
    float kept[LANES]; /* weight of the last signal in this one, from smoothing and dt */
    Controller controller;
} Block;

INLINE Vec vec(float x, float y, float z) { return (Vec){x, y, z}; }
INLINE Vec plus(Vec a, Vec b) { return vec(a.x + b.x, a.y + b.y, a.z + b.z); }
INLINE Vec minus(Vec a, Vec b) { return vec(a.x - b.x, a.y - b.y, a.z - b.z); }
INLINE Vec times(float s, Vec a) { return vec(s * a.x, s * a.y, s * a.z); }
INLINE float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE Vec cross(Vec a, Vec b)
{
    return vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
INLINE Vec unit_vec(Vec a) { return times(1 / sqrtf(dot(a, a)), a); }
INLINE Vec lane(float (*a)[LANES], int l) { return vec(a[0][l], a[1][l], a[2][l]); }
INLINE void put(float (*a)[LANES], int l, Vec v) { a[0][l] = v.x, a[1][l] = v.y, a[2][l] = v.z; }

/* R^T a of the attitude (w, v). */
INLINE Vec unrotate(float w, Vec v, Vec a)
{
    const Vec t = times(2, cross(v, a));
    return plus(minus(a, times(w, t)), cross(v, t));
}

/* One sample of one block: cost, signal, gain, filter step, biases. */
INLINE void step(Block *restrict b, const Sample *restrict s, const Settings *restrict c, int far)
{
#pragma omp simd
    for (int l = 0; l < LANES; ++l) {
        float w = b->q[0][l];
        Vec v = vec(b->q[1][l], b->q[2][l], b->q[3][l]), p = lane(b->p, l);
        Vec bias_angular = lane(b->bias_angular, l), bias_linear = lane(b->bias_linear, l);
        const Vec bias_before = bias_angular;

        /* Running cost: ||R_err||_I = 1 - (q . q_true)^2, and the position error. */
        const float d = w * s->q_true[0] + v.x * s->q_true[1] + v.y * s->q_true[2] + v.z * s->q_true[3];
        const Vec off = minus(p, s->p_true);
        b->cost[l] += s->cost_weight * (1 - d * d + c->cost_position * sqrtf(dot(off, off)));

        /* Vectors freed of their biases; sum s v^I u^T and Davenport's matrix of it. */
        const Vec d1 = minus(s->measured[0], lane(b->vector_bias[0], l));
        const Vec d2 = minus(s->measured[1], lane(b->vector_bias[1], l));
        const Vec u1 = unit_vec(d1), u2 = unit_vec(d2), u3 = unit_vec(cross(d1, d2));
        const Vec m1 = s->weighted[0], m2 = s->weighted[1], m3 = s->weighted[2];
        const Vec c0 = plus(plus(times(m1.x, u1), times(m2.x, u2)), times(m3.x, u3));
        const Vec c1 = plus(plus(times(m1.y, u1), times(m2.y, u2)), times(m3.y, u3));
        const Vec c2 = plus(plus(times(m1.z, u1), times(m2.z, u2)), times(m3.z, u3));
        const float ww = c0.x + c1.y + c2.z, xx = c0.x - c1.y - c2.z;
        const float yy = c1.y - c0.x - c2.z, zz = c2.z - c0.x - c1.y;
        const float wx = c2.y - c1.z, wy = c0.z - c2.x, wz = c1.x - c0.y;
        const float xy = c0.y + c1.x, xz = c0.z + c2.x, yz = c1.z + c2.y;

        /* What the bias law of the vectors needs of the attitude before the step. */
        const Vec residual1 = minus(d1, unrotate(w, v, s->known[0]));
        const Vec residual2 = minus(d2, unrotate(w, v, s->known[1]));

        const float h = s->dt / SUBSTEPS;
        const float half_weight = b->half_weight[l], unit = b->unit[l];
        float asked = 0, used_total = 0;
#pragma GCC unroll 4
        for (int j = 0; j < SUBSTEPS; ++j) {
            const float kw = ww * w + wx * v.x + wy * v.y + wz * v.z;
            const float kx = wx * w + xx * v.x + xy * v.y + xz * v.z;
            const float ky = wy * w + xy * v.x + yy * v.y + yz * v.z;
            const float kz = wz * w + xz * v.x + yz * v.y + zz * v.z;
            const Vec a = vec(w * kx - v.x * kw + v.z * ky - v.y * kz,
                              w * ky - v.y * kw + v.x * kz - v.z * kx,
                              w * kz - v.z * kw + v.y * kx - v.x * ky);

            /* Landmark: x = R^T x_i, r = R^T (p_i - x_i). */
            const Vec x = plus(s->y, p), r = minus(unrotate(w, v, s->p), x);
            if (j == 0) { /* signal and gain */
                const float trace = w * kw + v.x * kx + v.y * ky + v.z * kz;
                const float attitude = most(0, s->attitude_offset - s->attitude_slope * trace);
                const float now = attitude + b->position_weight[l] * sqrtf(dot(r, r));
                const float previous = b->signal[l] < 0 ? now : b->signal[l];
                const float signal = now + b->kept[l] * (previous - now);
                const float e = least(1, signal * b->signal_scale[l]);
                const float rate = least(1, fabsf(signal - previous) * c->rate_scale);
                asked = fuzzy_gain(&b->controller, l, e, rate, b->gain[l], far);
                b->signal[l] = signal;
                b->gain[l] = asked;
            }

            /* In the body frame W = [u; l^2 f - p x u], the velocity's bias law has [g; l^2 f]. */
            const Vec f = times(half_weight, r), g = plus(times(0.5f, a), cross(s->y, f));
            const Vec u = plus(g, cross(p, f)), pull = times(unit, f);
            const float x2 = dot(x, x), p2 = s->p_length * s->p_length;
            const float curvature =
                s->curvature + 0.5f * half_weight * (unit + s->p_length * sqrtf(x2) +
                                                     sqrtf((unit + x2) * (unit + p2)));
            const float length = least(asked * h, c->gain_limit / curvature);
            const float used = length * (1 / h);
            used_total += used;
            Vec omega = times(length, u), shift = times(length, minus(pull, cross(p, u)));
            if (j == SUBSTEPS - 1) {
                omega = plus(omega, minus(s->turn, times(s->dt, bias_angular)));
                shift = plus(shift, minus(s->shift, times(s->dt, bias_linear)));
            }
            const float follow = 0.01f * used * used, most_linear = used * (0.5f / s->dt);
            const float most_angular = most_linear / (1 + s->reach / unit);
            const float angular = h * least(b->gamma_angular[l] * follow, most_angular);
            const float linear = h * least(b->gamma_linear[l] * follow, most_linear);
            bias_angular = minus(bias_angular, times(angular, g));
            bias_linear = minus(bias_linear, times(linear, pull));

            /* T <- T exp([omega; shift]^); see pose_filter.c. */
            const float angle2 = dot(omega, omega);
            const float half_cos = series(0.25f * angle2, 0, 5);
            const float half_sinc = 0.5f * series(0.25f * angle2, 1, 5);
            const float t_minus_sin = series(angle2, 3, 6);
            const float sinc = 2 * half_sinc * half_cos, one_minus_cos = 2 * half_sinc * half_sinc;
            const Vec in = plus(times(one_minus_cos, p), times(t_minus_sin, shift));
            const Vec out = minus(plus(times(sinc, p), times(one_minus_cos, shift)), cross(omega, in));
            p = minus(plus(p, shift), cross(omega, out));
            const Vec n = times(half_sinc, omega);
            const float qw = w * half_cos - dot(v, n);
            const Vec qv = plus(plus(times(w, n), times(half_cos, v)), cross(v, n));
            const float near_1 = 1.5f - 0.5f * (qw * qw + dot(qv, qv));
            w = near_1 * qw;
            v = times(near_1, qv);
        }
        b->q[0][l] = w, b->q[1][l] = v.x, b->q[2][l] = v.y, b->q[3][l] = v.z;
        put(b->p, l, p);
        put(b->bias_angular, l, bias_angular);
        put(b->bias_linear, l, bias_linear);

        /* Vectors' biases, learnt while the body turns. */
        const Vec turning = minus(s->turning, bias_before);
        const float turning2 = dot(turning, turning);
        const float gain = b->learning[l] * (0.1f / SUBSTEPS) * used_total;
        const float share =
            least(1, s->dt * gain * least(1, c->per_turning * turning2 * turning2));
        const float kept = 1 - s->dt * c->leak;
        const Vec e1 = plus(times(kept, lane(b->vector_bias[0], l)), times(share, residual1));
        const Vec e2 = plus(times(kept, lane(b->vector_bias[1], l)), times(share, residual2));
        const float excess1 = c->per_bound * dot(e1, e1), excess2 = c->per_bound * dot(e2, e2);
        put(b->vector_bias[0], l, times(excess1 > 1 ? most(0, 1.5f - 0.5f * excess1) : 1, e1));
        put(b->vector_bias[1], l, times(excess2 > 1 ? most(0, 1.5f - 0.5f * excess2) : 1, e2));
    }
}

/* Agents of one block; a lane without an agent repeats the last one. */
static void begin(Block *b, int first, int agents, const float *inputs, const float *outputs,
                  const float *numbers, const float *start, const Settings *c)
{
    memset(b, 0, sizeof *b);
    for (int l = 0; l < LANES; ++l) {
        const int agent = first + l < agents ? first + l : agents - 1;
        const float *own = numbers + NUMBERS * agent;
        for (int i = 0; i < 4; ++i) {
            b->q[i][l] = start[i];
        }
        for (int i = 0; i < 3; ++i) {
            b->p[i][l] = start[4 + i];
            b->bias_angular[i][l] = start[7 + i];
            b->bias_linear[i][l] = start[10 + i];
        }
        b->signal[l] = -1;
        b->gain[l] = c->initial_gain;
        b->half_weight[l] = own[0], b->unit[l] = own[1];
        b->gamma_angular[l] = own[2], b->gamma_linear[l] = own[3];
        b->learning[l] = own[4];
        b->position_weight[l] = own[5], b->smoothing[l] = own[6], b->signal_scale[l] = own[7];
        begin_controller(&b->controller, l, inputs + 3 * TERMS * agent, outputs + 3 * TERMS * agent);
    }
}

#define RUN(far)                                                                                   \
    for (int k = 0; k < samples; ++k) {                                                            \
        if (k == 0 || sample[k].dt_before != sample[k - 1].dt_before) {                            \
            for (int i = 0; i < count; ++i) {                                                      \
                for (int l = 0; l < LANES; ++l) {                                                  \
                    const float smoothing = blocks[i].smoothing[l];                                \
                    blocks[i].kept[l] = smoothing / (smoothing + sample[k].dt_before);             \
                }                                                                                  \
            }                                                                                      \
        }                                                                                          \
        for (int i = 0; i < count; ++i) {                                                          \
            step(blocks + i, sample + k, c, far);                                                  \
        }                                                                                          \
    }

static void run(Block *blocks, int count, const Sample *sample, int samples, const Settings *c,
                int far)
{
    if (far) {
        RUN(1)
    } else {
        RUN(0)
    }
}

/* Numbers in a sample, and of each agent beside its terms, for the caller to check its packing. */
int learning_filter_sample_numbers(void) { return sizeof(Sample) / sizeof(float); }
int learning_filter_agent_numbers(void) { return NUMBERS; }

/* Costs (scenarios, agents) of terms inputs and outputs (agents, 5, 3) and numbers (agents, 8);
 * all else as pose_filter_costs. */
int learning_filter_costs(int scenarios, int samples, int agents, const Sample *sample,
                          const float *start, const float *inputs, const float *outputs,
                          const float *numbers, const Settings *c, int threads, float *costs)
{
    const int blocks = (agents + LANES - 1) / LANES;
    const int far = reach_far(agents, outputs), groups = group_count(blocks, threads);
    int failed = 0;
#pragma omp parallel for num_threads(threads) schedule(static) collapse(2)
    for (int scenario = 0; scenario < scenarios; ++scenario) {
        for (int group = 0; group < groups; ++group) {
            const int first = (int)((long)blocks * group / groups);
            const int count = (int)((long)blocks * (group + 1) / groups) - first;
            Block own[GROUP] __attribute__((aligned(64)));
            if (count > GROUP) {
                failed = 1;
                continue;
            }
            for (int i = 0; i < count; ++i) {
                begin(own + i, (first + i) * LANES, agents, inputs, outputs, numbers,
                      start + 13 * scenario, c);
            }
            run(own, count, sample + (size_t)scenario * samples, samples, c, far);
            for (int i = 0; i < count; ++i) {
                for (int l = 0; l < LANES && (first + i) * LANES + l < agents; ++l) {
                    costs[(size_t)scenario * agents + (first + i) * LANES + l] = own[i].cost[l];
                }
            }
        }
    }
    return failed;
}
