/* One population by hand: pose filter, fuzzy gain and running cost of many agents, vectorised.
 *
 * What a good C programmer gets out of a CPU for the computation of configs/paper.toml, the limit
 * that posegsa is measured against: the gradient law with one step per sample, vectors and one
 * landmark, the measured error signal, five terms, the paper's rules, the exact centroid.
 *
 * Blocks of LANES agents, one array of LANES floats for each number of an agent; every loop over
 * lanes is one vector instruction per operation. No trigonometry, no branches, and per step and
 * block 4 square roots and 2 divisions. Three things make it shorter than the textbook's form:
 *   - the position is carried in the body frame, p = R^T P. All that the filter needs is then
 *     there without a rotation matrix: W_v = u2 - p x u1, the bias law's first half is
 *     a/2 + y x u2, and the true position error is |p - R_true^T P_true|;
 *   - vectors enter through Davenport's matrix K, tr(R B) = q' K q (16 products for both the
 *     attitude part of the signal and the innovation);
 *   - pairs of output terms that overlap for no agent of the population are left out.
 *
 * Built by c.py: gcc -O3 -march=native -ffast-math and a few options that pay.
 */
#include "fuzzy_gain.h"

/* What one sample tells every agent; nothing in it depends on an agent. */
typedef struct {
    float ww, wx, wy, wz, xx, xy, xz, yy, yz, zz; /* Davenport's K of the vectors */
    float attitude_offset, attitude_slope;        /* signal's attitude part = offset - slope q'Kq */
    float position_part;                          /* its weight of the landmark's residual [1/m] */
    float smoothing;                              /* weight of the last signal in this one */
    float y[3], p[3], half_weight;                /* landmark: body, inertial [m]; s/2 */
    float curvature, curvature_x, curvature_1x;   /* L = these . (1, |x|, sqrt(1 + |x|^2)) */
    float turn[3], shift[3];                      /* measured velocities times dt [rad, m] */
    float q_true[4], p_true[3];                   /* R; R^T P [m] */
    float cost_weight, dt;
} Sample;

typedef struct {
    float gamma_angular, gamma_linear, gain_limit; /* gain_limit <= 0: none */
    float signal_scale, rate_scale, cost_position; /* 1 / error scale; 1; [1/m] */
    float initial_gain;
} Settings;

typedef struct {
    float q[4][LANES], p[3][LANES];                      /* attitude; R^T P [m] */
    float bias_angular[3][LANES], bias_linear[3][LANES]; /* [rad/s], [m/s] */
    float signal[LANES], gain[LANES], cost[LANES];
    Controller controller;
} Block;

/* One sample of one block: cost, signal, gain, filter step. */
INLINE void step(Block *restrict b, const Sample *restrict s, const Settings *restrict c,
                 int limited, int far)
{
#pragma omp simd
    for (int l = 0; l < LANES; ++l) {
        const float w = b->q[0][l], x = b->q[1][l], y = b->q[2][l], z = b->q[3][l];
        const float p0 = b->p[0][l], p1 = b->p[1][l], p2 = b->p[2][l];

        /* Running cost: ||R_err||_I = 1 - (q . q_true)^2, and the position error. */
        const float d = w * s->q_true[0] + x * s->q_true[1] + y * s->q_true[2] + z * s->q_true[3];
        const float d0 = p0 - s->p_true[0], d1 = p1 - s->p_true[1], d2 = p2 - s->p_true[2];
        const float distance = sqrtf(d0 * d0 + d1 * d1 + d2 * d2);
        b->cost[l] += s->cost_weight * (1 - d * d + c->cost_position * distance);

        /* Vectors: a = sum s v^B x R^T v^I, tr = sum s v^I . R v^B. */
        const float kw = s->ww * w + s->wx * x + s->wy * y + s->wz * z;
        const float kx = s->wx * w + s->xx * x + s->xy * y + s->xz * z;
        const float ky = s->wy * w + s->xy * x + s->yy * y + s->yz * z;
        const float kz = s->wz * w + s->xz * x + s->yz * y + s->zz * z;
        const float trace = w * kw + x * kx + y * ky + z * kz;
        const float a0 = w * kx - x * kw + z * ky - y * kz;
        const float a1 = w * ky - y * kw + x * kz - z * kx;
        const float a2 = w * kz - z * kw + y * kx - x * ky;

        /* Landmark: r = R^T (p_i - x_i), x = R^T x_i. */
        const float t0 = 2 * (y * s->p[2] - z * s->p[1]);
        const float t1 = 2 * (z * s->p[0] - x * s->p[2]);
        const float t2 = 2 * (x * s->p[1] - y * s->p[0]);
        const float x0 = s->y[0] + p0, x1 = s->y[1] + p1, x2 = s->y[2] + p2;
        const float r0 = s->p[0] - w * t0 + (y * t2 - z * t1) - x0;
        const float r1 = s->p[1] - w * t1 + (z * t0 - x * t2) - x1;
        const float r2 = s->p[2] - w * t2 + (x * t1 - y * t0) - x2;

        /* Signal and gain. */
        const float attitude = most(0, s->attitude_offset - s->attitude_slope * trace);
        const float now = attitude + s->position_part * sqrtf(r0 * r0 + r1 * r1 + r2 * r2);
        const float previous = b->signal[l] < 0 ? now : b->signal[l];
        const float signal = now + s->smoothing * (previous - now);
        const float e = least(1, signal * c->signal_scale);
        const float rate = least(1, fabsf(signal - previous) * c->rate_scale);
        const float asked = fuzzy_gain(&b->controller, l, e, rate, b->gain[l], far);
        b->signal[l] = signal;
        b->gain[l] = asked;

        /* Innovation in the body frame; the first half of the bias law is u1 - p x u2. */
        const float v0 = s->half_weight * r0, v1 = s->half_weight * r1, v2 = s->half_weight * r2;
        const float g0 = 0.5f * a0 + (s->y[1] * v2 - s->y[2] * v1);
        const float g1 = 0.5f * a1 + (s->y[2] * v0 - s->y[0] * v2);
        const float g2 = 0.5f * a2 + (s->y[0] * v1 - s->y[1] * v0);
        const float u0 = g0 + (p1 * v2 - p2 * v1);
        const float u1 = g1 + (p2 * v0 - p0 * v2);
        const float u2 = g2 + (p0 * v1 - p1 * v0);
        float length = asked * s->dt;
        if (limited) {
            const float square = x0 * x0 + x1 * x1 + x2 * x2;
            const float curvature = s->curvature + s->curvature_x * sqrtf(square) +
                                    s->curvature_1x * sqrtf(1 + square);
            length = least(length, c->gain_limit / curvature);
        }

        /* Displacement [omega; v] of the step, and the biases. */
        const float o0 = length * u0 + (s->turn[0] - s->dt * b->bias_angular[0][l]);
        const float o1 = length * u1 + (s->turn[1] - s->dt * b->bias_angular[1][l]);
        const float o2 = length * u2 + (s->turn[2] - s->dt * b->bias_angular[2][l]);
        const float m0 = length * (v0 - (p1 * u2 - p2 * u1)) +
                         (s->shift[0] - s->dt * b->bias_linear[0][l]);
        const float m1 = length * (v1 - (p2 * u0 - p0 * u2)) +
                         (s->shift[1] - s->dt * b->bias_linear[1][l]);
        const float m2 = length * (v2 - (p0 * u1 - p1 * u0)) +
                         (s->shift[2] - s->dt * b->bias_linear[2][l]);
        const float angular = c->gamma_angular * s->dt, linear = c->gamma_linear * s->dt;
        b->bias_angular[0][l] -= angular * g0;
        b->bias_angular[1][l] -= angular * g1;
        b->bias_angular[2][l] -= angular * g2;
        b->bias_linear[0][l] -= linear * v0;
        b->bias_linear[1][l] -= linear * v1;
        b->bias_linear[2][l] -= linear * v2;

        /* T <- T exp([omega; v]^): p <- exp(-omega) p + V(-omega) v. The gain limit keeps the
         * angle t under 1.5 rad and what the gyroscope says; without it there may be whole turns. */
        const float angle2 = o0 * o0 + o1 * o1 + o2 * o2;
        float half_cos, half_sinc, t_minus_sin; /* cos(t/2), sin(t/2)/t, (t - sin t)/t^3 */
        if (limited) {
            half_cos = series(0.25f * angle2, 0, 5);
            half_sinc = 0.5f * series(0.25f * angle2, 1, 5);
            t_minus_sin = series(angle2, 3, 6);
        } else {
            const float angle = sqrtf(angle2), turns = rintf(angle * 0.15915494f);
            const float rest = angle - turns * 6.2831853f; /* q and -q are the same attitude */
            half_cos = series(0.25f * rest * rest, 0, 8);
            half_sinc = 0.5f * series(0.25f * rest * rest, 1, 8);
            half_sinc = turns > 0 ? half_sinc * rest / angle : half_sinc;
            t_minus_sin = angle2 < 1 ? series(angle2, 3, 5)
                                     : (1 - 2 * half_sinc * half_cos) / most(angle2, 1);
        }
        const float sinc = 2 * half_sinc * half_cos, one_minus_cos = 2 * half_sinc * half_sinc;
        const float i0 = one_minus_cos * p0 + t_minus_sin * m0;
        const float i1 = one_minus_cos * p1 + t_minus_sin * m1;
        const float i2 = one_minus_cos * p2 + t_minus_sin * m2;
        const float j0 = sinc * p0 + one_minus_cos * m0 - (o1 * i2 - o2 * i1);
        const float j1 = sinc * p1 + one_minus_cos * m1 - (o2 * i0 - o0 * i2);
        const float j2 = sinc * p2 + one_minus_cos * m2 - (o0 * i1 - o1 * i0);
        b->p[0][l] = p0 + m0 - (o1 * j2 - o2 * j1);
        b->p[1][l] = p1 + m1 - (o2 * j0 - o0 * j2);
        b->p[2][l] = p2 + m2 - (o0 * j1 - o1 * j0);
        const float n0 = half_sinc * o0, n1 = half_sinc * o1, n2 = half_sinc * o2;
        const float qw = w * half_cos - x * n0 - y * n1 - z * n2;
        const float qx = w * n0 + x * half_cos + y * n2 - z * n1;
        const float qy = w * n1 - x * n2 + y * half_cos + z * n0;
        const float qz = w * n2 + x * n1 - y * n0 + z * half_cos;
        const float unit = 1.5f - 0.5f * (qw * qw + qx * qx + qy * qy + qz * qz);
        b->q[0][l] = unit * qw;
        b->q[1][l] = unit * qx;
        b->q[2][l] = unit * qy;
        b->q[3][l] = unit * qz;
    }
}

/* Agents of one block from their terms; a lane without an agent repeats the last one. */
static void begin(Block *b, int first, int agents, const float *inputs, const float *outputs,
                  const float *start, const Settings *c)
{
    memset(b, 0, sizeof *b);
    for (int l = 0; l < LANES; ++l) {
        const int agent = first + l < agents ? first + l : agents - 1;
        const float *in = inputs + 3 * TERMS * agent, *out = outputs + 3 * TERMS * agent;
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
        begin_controller(&b->controller, l, in, out);
    }
}

#define RUN(limited, far)                                                                          \
    for (int k = 0; k < samples; ++k) {                                                            \
        for (int i = 0; i < count; ++i) {                                                          \
            step(blocks + i, sample + k, c, limited, far);                                         \
        }                                                                                          \
    }

static void run(Block *blocks, int count, const Sample *sample, int samples, const Settings *c,
                int far)
{
    const int limited = c->gain_limit > 0;
    if (limited && !far) {
        RUN(1, 0)
    } else if (limited) {
        RUN(1, 1)
    } else if (!far) {
        RUN(0, 0)
    } else {
        RUN(0, 1)
    }
}

/* Numbers in a sample, for the caller to check its packing. */
int pose_filter_sample_numbers(void) { return sizeof(Sample) / sizeof(float); }

/* Costs (scenarios, agents) of terms inputs and outputs (agents, 5, 3).
 *
 * sample is (scenarios, samples), start (scenarios, 13): quaternion, R^T P, biases. Blocks go in
 * groups through time, so that one block's work fills the other's waiting; a group stays in the
 * first-level cache. */
int pose_filter_costs(int scenarios, int samples, int agents, const Sample *sample,
                      const float *start, const float *inputs, const float *outputs,
                      const Settings *c, int threads, float *costs)
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
                begin(own + i, (first + i) * LANES, agents, inputs, outputs, start + 13 * scenario, c);
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
