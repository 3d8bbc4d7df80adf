/* One population of invariant Kalman filters by hand: the equations of posegsa/filters/kalman.py.
 *
 * Two vectors and one landmark; STATES is 12, or 18 with the vectors' biases. LANES filters at
 * once: a number of all of them is one vector, and every operation one vector instruction. Only the
 * upper triangle of the covariance is kept, in the first-level cache; nothing is multiplied that
 * is known to be 0 or 1:
 *   - a row of the measurements' derivatives has two or three entries;
 *   - the transition is three cheap ones, xi <- xi - dt/2 b, xi <- A xi, xi <- xi - dt/2 b;
 *     A is a cross product and a rotation for each column.
 * Each sensor has to be seen in every sample.
 *
 * Built by c.py: gcc -O3 -march=native -ffast-math and a few options that pay.
 */
#include "fuzzy_gain.h"

#ifndef STATES
#define STATES 18
#endif

enum { VECTORS = 2, LEARNT = (STATES - 12) / 3, ENTRIES = STATES * (STATES + 1) / 2 };
enum { ATTITUDE = 0, POSITION = 3, ANGULAR = 6, LINEAR = 9, BIASES = 12 }; /* first states */

/* Nine times in line, unrolled code overflows the cache of instructions: 1.7 times slower. */
#define OUTLINE static __attribute__((noinline)) void

typedef float V __attribute__((vector_size(4 * LANES)));

typedef struct {
    float omega[3], v[3];                          /* measured velocities [rad/s, m/s] */
    float measured[VECTORS][3], known[VECTORS][3]; /* vectors: body, inertial */
    float y[3], p[3];                              /* landmark: body, inertial [m] */
    float q_true[4], p_true[3];                    /* R; R^T P [m] */
    float cost_weight, dt;
} Sample;

/* What a filter believes, in the order of KalmanNoise: standard deviations; here their squares. */
typedef struct {
    V angular_velocity, velocity, angular_walk, linear_walk, vector_walk, vector, landmark;
    V start[5]; /* attitude, position, angular, linear, vectors' biases */
} Noise;

enum { NUMBERS = sizeof(Noise) / sizeof(V) };

typedef struct {
    V q[4], P[3], b[6], c[VECTORS][3];
    V sigma[ENTRIES], x[STATES], cost;
    Noise noise;
} Block;

INLINE V larger(V a, V b)
{
    typedef int M __attribute__((vector_size(4 * LANES)));
    const M first = a > b;
    return (V)((first & (M)a) | (~first & (M)b));
}

INLINE int at(int i, int j)
{
    const int first = i < j ? i : j, second = i < j ? j : i;
    return first * STATES - first * (first - 1) / 2 + second - first;
}

INLINE V cross(const V *a, const V *b, int i)
{
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    return a[j] * b[k] - a[k] * b[j];
}

/* cos(t/2), sin(t/2)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 from t^2. */
INLINE void exponential(V angle_squared, V *half_cos, V *half_sinc, V *one_minus_cos,
                        V *t_minus_sin)
{
    float in[LANES], c[LANES], s[LANES], d[LANES];
    memcpy(in, &angle_squared, sizeof in);
#pragma omp simd
    for (int l = 0; l < LANES; ++l) {
        const float t2 = in[l], t = sqrtf(t2), turns = rintf(t * 0.15915494f);
        const float rest = t - turns * 6.2831853f; /* q and -q are the same attitude */
        const float sinc = 0.5f * series(0.25f * rest * rest, 1, 7);
        c[l] = series(0.25f * rest * rest, 0, 7);
        s[l] = turns > 0 ? sinc * rest / t : sinc;
        d[l] = t2 < 1 ? series(t2, 3, 6) : (1 - 2 * s[l] * c[l]) / most(t2, 1);
    }
    memcpy(half_cos, c, sizeof c);
    memcpy(half_sinc, s, sizeof s);
    memcpy(t_minus_sin, d, sizeof d);
    *one_minus_cos = 2 * *half_sinc * *half_sinc;
}

/* q, P of exp([o; m]^). */
INLINE void motion(const V *o, const V *m, V *q, V *P)
{
    V half_cos, half_sinc, b, c, turned[3];
    exponential(o[0] * o[0] + o[1] * o[1] + o[2] * o[2], &half_cos, &half_sinc, &b, &c);
    for (int i = 0; i < 3; ++i) {
        turned[i] = cross(o, m, i);
    }
    q[0] = half_cos;
    for (int i = 0; i < 3; ++i) {
        q[1 + i] = half_sinc * o[i];
        P[i] = m[i] + b * turned[i] + c * cross(o, turned, i);
    }
}

INLINE void rotation(const V *q, V R[3][3])
{
    const V w = q[0], x = q[1], y = q[2], z = q[3];
    const V xx = 2 * x * x, yy = 2 * y * y, zz = 2 * z * z;
    R[0][0] = 1 - yy - zz, R[0][1] = 2 * (x * y - w * z), R[0][2] = 2 * (x * z + w * y);
    R[1][0] = 2 * (x * y + w * z), R[1][1] = 1 - xx - zz, R[1][2] = 2 * (y * z - w * x);
    R[2][0] = 2 * (x * z - w * y), R[2][1] = 2 * (y * z + w * x), R[2][2] = 1 - xx - yy;
}

/* The estimate, whose rotation is R, moved by the pose (d, D) in the body frame. */
INLINE void move(Block *b, V R[3][3], const V *d, const V *D)
{
    const V w = b->q[0], x = b->q[1], y = b->q[2], z = b->q[3];
    for (int i = 0; i < 3; ++i) {
        b->P[i] += R[i][0] * D[0] + R[i][1] * D[1] + R[i][2] * D[2];
    }
    const V qw = w * d[0] - x * d[1] - y * d[2] - z * d[3];
    const V qx = w * d[1] + x * d[0] + y * d[3] - z * d[2];
    const V qy = w * d[2] - x * d[3] + y * d[0] + z * d[1];
    const V qz = w * d[3] + x * d[2] - y * d[1] + z * d[0];
    const V unit = 1.5f - 0.5f * (qw * qw + qx * qx + qy * qy + qz * qz);
    b->q[0] = unit * qw, b->q[1] = unit * qx, b->q[2] = unit * qy, b->q[3] = unit * qz;
}

/* One scalar: its derivatives are f and g by states i and j, and `own` by state k (none if 0). */
OUTLINE take(Block *restrict b, int i, V f, int j, V g, int k, float own, V residual,
                  V variance)
{
    V gain[STATES], part[STATES];
#pragma GCC unroll 18
    for (int n = 0; n < STATES; ++n) {
        gain[n] = f * b->sigma[at(i, n)] + g * b->sigma[at(j, n)];
        if (own != 0) {
            gain[n] += own * b->sigma[at(k, n)];
        }
    }
    V total = f * gain[i] + g * gain[j], expected = f * b->x[i] + g * b->x[j];
    if (own != 0) {
        total += own * gain[k], expected += own * b->x[k];
    }
    const V smallest = 128 * 1.1920929e-7f * total; /* a variance is not cut by all of itself */
    total += larger(variance, smallest);
    const V per_total = 1 / total, surprise = per_total * (residual - expected);
#pragma GCC unroll 18
    for (int n = 0; n < STATES; ++n) {
        part[n] = per_total * gain[n];
        b->x[n] += surprise * gain[n];
    }
#pragma GCC unroll 18
    for (int n = 0; n < STATES; ++n) {
#pragma GCC unroll 18
        for (int m = n; m < STATES; ++m) {
            b->sigma[at(n, m)] -= part[n] * gain[m];
        }
    }
}

/* Vectors and landmark, each component after the other, all linearised at the estimate before. */
INLINE void update(Block *restrict b, const Sample *restrict s)
{
    V R[3][3], d[4], D[3];
    rotation(b->q, R);
    for (int n = 0; n < STATES; ++n) {
        b->x[n] = (V){0};
    }
#pragma GCC unroll 2
    for (int sensor = 0; sensor < VECTORS; ++sensor) {
        V seen[3];
        for (int i = 0; i < 3; ++i) {
            seen[i] = R[0][i] * s->known[sensor][0] + R[1][i] * s->known[sensor][1] +
                      R[2][i] * s->known[sensor][2];
        }
#pragma GCC unroll 3
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            const V expected = LEARNT ? seen[i] + b->c[sensor][i] : seen[i];
            take(b, j, -seen[k], k, seen[j], LEARNT ? BIASES + 3 * sensor + i : 0, LEARNT > 0,
                 s->measured[sensor][i] - expected, b->noise.vector);
        }
    }
    V y[3], off[3];
    for (int i = 0; i < 3; ++i) {
        off[i] = s->p[i] - b->P[i];
    }
    for (int i = 0; i < 3; ++i) {
        y[i] = R[0][i] * off[0] + R[1][i] * off[1] + R[2][i] * off[2];
    }
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        take(b, j, -y[k], k, y[j], POSITION + i, -1, s->y[i] - y[i], b->noise.landmark);
    }
    motion(b->x, b->x + POSITION, d, D);
    move(b, R, d, D);
    for (int i = 0; i < 6; ++i) {
        b->b[i] += b->x[ANGULAR + i];
    }
    for (int i = 0; i < LEARNT; ++i) {
        for (int j = 0; j < 3; ++j) {
            b->c[i][j] += b->x[BIASES + 3 * i + j];
        }
    }
}

/* xi <- xi - h b. */
OUTLINE shear(V *restrict sigma, float h)
{
#pragma GCC unroll 6
    for (int i = 0; i < 6; ++i) {
#pragma GCC unroll 6
        for (int j = i; j < 6; ++j) {
            sigma[at(i, j)] -= h * sigma[at(j, ANGULAR + i)];
        }
#pragma GCC unroll 18
        for (int j = 6; j < STATES; ++j) {
            sigma[at(i, j)] -= h * sigma[at(ANGULAR + i, j)];
        }
    }
#pragma GCC unroll 6
    for (int i = 0; i < 6; ++i) {
#pragma GCC unroll 6
        for (int j = i; j < 6; ++j) {
            sigma[at(i, j)] -= h * sigma[at(i, ANGULAR + j)];
        }
    }
}

/* [theta; rho] <- [E theta; E (rho - P x theta)]. */
INLINE void adjoint(V E[3][3], const V *P, V *xi)
{
    V rho[3], theta[3] = {xi[0], xi[1], xi[2]};
    for (int i = 0; i < 3; ++i) {
        rho[i] = xi[3 + i] - cross(P, theta, i);
    }
    for (int i = 0; i < 3; ++i) {
        xi[i] = E[i][0] * theta[0] + E[i][1] * theta[1] + E[i][2] * theta[2];
        xi[3 + i] = E[i][0] * rho[0] + E[i][1] * rho[1] + E[i][2] * rho[2];
    }
}

INLINE void propagate(Block *restrict b, const Sample *restrict s)
{
    V o[3], m[3], d[4], D[3], R[3][3], E[3][3], turned[3][3], block[6][6];
    for (int i = 0; i < 3; ++i) {
        o[i] = s->dt * (s->omega[i] - b->b[i]);
        m[i] = s->dt * (s->v[i] - b->b[3 + i]);
    }
    motion(o, m, d, D);
    rotation(b->q, R);
    move(b, R, d, D);
    rotation(d, turned);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            E[i][j] = turned[j][i];
        }
    }
    V *sigma = b->sigma;
    shear(sigma, 0.5f * s->dt);
#pragma GCC unroll 12
    for (int j = 6; j < STATES; ++j) {
        V column[6];
        for (int i = 0; i < 6; ++i) {
            column[i] = sigma[at(i, j)];
        }
        adjoint(E, D, column);
        for (int i = 0; i < 6; ++i) {
            sigma[at(i, j)] = column[i];
        }
    }
#pragma GCC unroll 6
    for (int j = 0; j < 6; ++j) {
        for (int i = 0; i < 6; ++i) {
            block[j][i] = sigma[at(i, j)];
        }
        adjoint(E, D, block[j]);
    }
#pragma GCC unroll 6
    for (int i = 0; i < 6; ++i) {
        V row[6];
        for (int j = 0; j < 6; ++j) {
            row[j] = block[j][i];
        }
        adjoint(E, D, row);
        for (int j = i; j < 6; ++j) {
            sigma[at(i, j)] = row[j];
        }
    }
    shear(sigma, 0.5f * s->dt);
    const V *density = &b->noise.angular_velocity;
#pragma GCC unroll 18
    for (int i = 0; i < STATES; ++i) {
        sigma[at(i, i)] += s->dt * density[i < BIASES ? i / 3 : 4];
    }
}

static void step(Block *restrict b, const Sample *restrict s, float cost_position)
{
    /* Running cost: sin^2(angle/2) = 1 - (q . q_true)^2, and |P - R R_true^T P_true|. */
    V d = {0}, R[3][3], square = {0};
    for (int i = 0; i < 4; ++i) {
        d += b->q[i] * s->q_true[i];
    }
    rotation(b->q, R);
    for (int i = 0; i < 3; ++i) {
        const V off = b->P[i] - (R[i][0] * s->p_true[0] + R[i][1] * s->p_true[1] +
                                 R[i][2] * s->p_true[2]);
        square += off * off;
    }
    float distance[LANES];
    memcpy(distance, &square, sizeof distance);
    for (int l = 0; l < LANES; ++l) {
        distance[l] = sqrtf(distance[l]);
    }
    memcpy(&square, distance, sizeof distance);
    b->cost += s->cost_weight * (1 - d * d + cost_position * square);
    update(b, s);
    propagate(b, s);
}

/* Filters of one block from what each believes; a lane without a filter repeats the last one. */
static void begin(Block *b, int first, int agents, const float *noises, const float *start)
{
    memset(b, 0, sizeof *b);
    for (int l = 0; l < LANES; ++l) {
        const int agent = first + l < agents ? first + l : agents - 1;
        for (int i = 0; i < NUMBERS; ++i) {
            const float deviation = noises[NUMBERS * agent + i];
            ((float *)&b->noise)[i * LANES + l] = deviation * deviation;
        }
    }
    for (int i = 0; i < 13; ++i) {
        (i < 4 ? b->q + i : i < 7 ? b->P + i - 4 : b->b + i - 7)[0] += start[i];
    }
    for (int i = 0; i < STATES; ++i) {
        b->sigma[at(i, i)] = b->noise.start[i < BIASES ? i / 3 : 4];
    }
}

/* Numbers in a sample and of a filter, for the caller to check its packing. */
int kalman_filter_sample_numbers(void) { return sizeof(Sample) / sizeof(float); }
int kalman_filter_numbers(void) { return NUMBERS; }

/* Costs (scenarios, agents) of what filters believe, noises (agents, 12).
 *
 * sample is (scenarios, samples), start (scenarios, 13): quaternion, position, velocities' biases.
 * One block's simulation after the other. */
void kalman_filter_costs(int scenarios, int samples, int agents, const Sample *sample,
                         const float *start, const float *noises, float cost_position, int threads,
                         float *costs)
{
    const int blocks = (agents + LANES - 1) / LANES;
#pragma omp parallel for num_threads(threads) schedule(static) collapse(2)
    for (int scenario = 0; scenario < scenarios; ++scenario) {
        for (int i = 0; i < blocks; ++i) {
            Block own;
            begin(&own, i * LANES, agents, noises, start + 13 * scenario);
            for (int k = 0; k < samples; ++k) {
                step(&own, sample + (size_t)scenario * samples + k, cost_position);
            }
            const float *cost = (const float *)&own.cost;
            for (int l = 0; l < LANES && i * LANES + l < agents; ++l) {
                costs[(size_t)scenario * agents + i * LANES + l] = cost[l];
            }
        }
    }
}
