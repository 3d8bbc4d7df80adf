/* The fuzzy gain of a block of agents, and what else both filters in C share.
 *
 * Blocks of LANES agents, one array of LANES floats for each number of an agent.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef LANES
#define LANES 16
#endif

enum { TERMS = 5, GROUP = 4 };

/* Area and first moment under two output terms clipped at h: polynomials in min(h, cap). */
typedef struct {
    float cap[LANES], area1[LANES], area2[LANES], moment1[LANES], moment2[LANES], moment3[LANES];
} Overlap;

/* A fuzzy controller with the paper's rules. */
typedef struct {
    float rise[TERMS][LANES], rise_at_0[TERMS][LANES]; /* input edges as lines through (0, .) */
    float fall[TERMS][LANES], fall_at_0[TERMS][LANES];
    Overlap single[TERMS], next[TERMS - 1], second[TERMS - 2], third[TERMS - 3], ends;
} Controller;

#define INLINE static inline __attribute__((always_inline))

INLINE float least(float a, float b) { return a < b ? a : b; }
INLINE float most(float a, float b) { return a > b ? a : b; }

INLINE void overlap(Overlap *o, int lane, const float *first, const float *second, float sign)
{
    const float a = second[0], c = first[2];
    const float u = second[1] - a, v = c - first[1], width = c - a, slope = u + v;
    o->cap[lane] = width <= 0 ? 0 : slope > 0 ? least(1, width / slope) : 1;
    o->area1[lane] = sign * width;
    o->area2[lane] = -sign * 0.5f * slope;
    o->moment1[lane] = sign * 0.5f * width * (c + a);
    o->moment2[lane] = -sign * 0.5f * (c * v + a * u);
    o->moment3[lane] = sign * slope * (v - u) / 6;
}

INLINE void add(float h, const Overlap *o, int lane, float *area, float *moment)
{
    *area += h * (o->area1[lane] + h * o->area2[lane]);
    *moment += h * (o->moment1[lane] + h * (o->moment2[lane] + h * o->moment3[lane]));
}

/* Minus the part of a pair that lies above what stands between its terms. */
INLINE void take_pair(float both, float between, const Overlap *o, int lane, float *area, float *moment)
{
    const float h = least(both, o->cap[lane]), covered = least(h, between);
    add(h, o, lane, area, moment);
    *area -= covered * (o->area1[lane] + covered * o->area2[lane]);
    *moment -= covered * (o->moment1[lane] +
                          covered * (o->moment2[lane] + covered * o->moment3[lane]));
}

INLINE float rising(const Controller *b, int term, int lane, float x)
{
    return x * b->rise[term][lane] + b->rise_at_0[term][lane];
}

INLINE float falling(const Controller *b, int term, int lane, float x)
{
    return x * b->fall[term][lane] + b->fall_at_0[term][lane];
}

/* Memberships of x in [0, 1]; the first term has no left edge, the last no right one. */
INLINE void fuzzify(const Controller *b, int lane, float x, float m[TERMS])
{
    m[0] = most(0, falling(b, 0, lane, x));
    m[1] = most(0, least(rising(b, 1, lane, x), falling(b, 1, lane, x)));
    m[2] = most(0, least(rising(b, 2, lane, x), falling(b, 2, lane, x)));
    m[3] = most(0, least(rising(b, 3, lane, x), falling(b, 3, lane, x)));
    m[4] = most(0, rising(b, 4, lane, x));
}

/* Gain of signal e and rate r; `far` says whether terms two or more apart may overlap. */
INLINE float fuzzy_gain(const Controller *b, int lane, float e_, float r_, float last, int far)
{
    float e[TERMS], r[TERMS], h[TERMS], area = 0, moment = 0;
    fuzzify(b, lane, e_, e);
    fuzzify(b, lane, r_, r);
    /* The paper's Table I, from VS to VL: rows are the rate, columns the error.
     *     0 1 2 4 4 | 1 2 2 4 4 | 2 2 3 4 4 | 2 3 4 4 4 | 3 3 4 4 4 */
    const float e34 = most(e[3], e[4]), e01 = most(e[0], e[1]), r34 = most(r[3], r[4]);
    h[0] = least(r[0], e[0]);
    h[1] = most(least(r[0], e[1]), least(r[1], e[0]));
    h[2] = most(most(least(r[0], e[2]), least(r[1], most(e[1], e[2]))),
                most(least(r[2], e01), least(r[3], e[0])));
    h[3] = most(most(least(r[2], e[2]), least(r[3], e[1])), least(r[4], e01));
    h[4] = most(least(most(most(r[0], r[1]), most(r[2], r34)), e34), least(r34, e[2]));
    for (int i = 0; i < TERMS; ++i) {
        add(h[i], &b->single[i], lane, &area, &moment);
    }
    for (int i = 0; i + 1 < TERMS; ++i) {
        add(least(least(h[i], h[i + 1]), b->next[i].cap[lane]), &b->next[i], lane, &area, &moment);
    }
    for (int i = 0; i + 2 < TERMS; ++i) {
        take_pair(least(h[i], h[i + 2]), h[i + 1], &b->second[i], lane, &area, &moment);
    }
    if (far) {
        const float h12 = most(h[1], h[2]), h23 = most(h[2], h[3]);
        take_pair(least(h[0], h[3]), h12, &b->third[0], lane, &area, &moment);
        take_pair(least(h[1], h[4]), h23, &b->third[1], lane, &area, &moment);
        take_pair(least(h[0], h[4]), most(h12, h[3]), &b->ends, lane, &area, &moment);
    }
    return area > 0 ? 1 + moment / area : last;
}

/* sum_n (-x)^n / (2 n + first)!, n < terms. */
INLINE float series(float x, int first, int terms)
{
    double factorial = 1;
#pragma GCC unroll 32
    for (int k = 2; k <= 2 * (terms - 1) + first; ++k) {
        factorial *= k;
    }
    float sum = 0;
#pragma GCC unroll 16
    for (int n = terms - 1; n >= 0; --n) {
        sum = (float)(1 / factorial) - x * sum;
        factorial /= n > 0 ? (2 * n + first) * (2 * n + first - 1) : 1;
    }
    return sum;
}

/* The controller of one lane from its terms. */
static void begin_controller(Controller *b, int l, const float *in, const float *out)
{
    for (int i = 0; i < TERMS; ++i) {
        const float *t = in + 3 * i;
        b->rise[i][l] = 1 / most(t[1] - t[0], 1e-6f);
        b->rise_at_0[i][l] = -t[0] * b->rise[i][l];
        b->fall[i][l] = -1 / most(t[2] - t[1], 1e-6f);
        b->fall_at_0[i][l] = -t[2] * b->fall[i][l];
        overlap(&b->single[i], l, out + 3 * i, out + 3 * i, 1);
    }
    for (int i = 0; i + 1 < TERMS; ++i) {
        overlap(&b->next[i], l, out + 3 * i, out + 3 * (i + 1), -1);
    }
    for (int i = 0; i + 2 < TERMS; ++i) {
        overlap(&b->second[i], l, out + 3 * i, out + 3 * (i + 2), -1);
    }
    for (int i = 0; i + 3 < TERMS; ++i) {
        overlap(&b->third[i], l, out + 3 * i, out + 3 * (i + 3), -1);
    }
    overlap(&b->ends, l, out, out + 3 * (TERMS - 1), -1);
}

/* Whether terms three or more apart overlap for any agent. */
static int reach_far(int agents, const float *outputs)
{
    for (int agent = 0; agent < agents; ++agent) {
        const float *out = outputs + 3 * TERMS * agent;
        if (out[2] > out[3 * 3] || out[3 + 2] > out[3 * 4]) {
            return 1;
        }
    }
    return 0;
}

/* Groups that so many blocks go in: as even as possible, a multiple of the threads, none above
 * GROUP. */
static int group_count(int blocks, int threads)
{
    const int groups = (blocks + GROUP - 1) / GROUP;
    return (groups + threads - 1) / threads * threads;
}
