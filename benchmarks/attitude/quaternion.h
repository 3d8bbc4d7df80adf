/* Quaternions w, x, y, z from the body to north, west, up, and vectors, in the type `real`. */

#include <math.h>

static real sqrt_of(real x)
{
    return sizeof(real) < sizeof(double) ? (real)sqrtf((float)x) : (real)sqrt((double)x);
}

static void to_unit(real *a, int n)
{
    real square = 0;
    int i;
    for (i = 0; i < n; ++i) {
        square += a[i] * a[i];
    }
    if (square > 0) {
        const real scale = 1 / sqrt_of(square);
        for (i = 0; i < n; ++i) {
            a[i] *= scale;
        }
    }
}

/* The attitude that an acceleration and a field show. */
static void from_vectors(const real *acc, const real *mag, real *q)
{
    real R[3][3]; /* rows: north, west and up, in the body */
    int i, best = 0;
    for (i = 0; i < 3; ++i) {
        R[2][i] = acc[i];
    }
    to_unit(R[2], 3);
    for (i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        R[1][i] = R[2][j] * mag[k] - R[2][k] * mag[j];
    }
    to_unit(R[1], 3);
    for (i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        R[0][i] = R[1][j] * R[2][k] - R[1][k] * R[2][j];
    }
    {
        /* Each row is q times one of its components; the longest is the most accurate. */
        const real by[4][4] = {
            {1 + R[0][0] + R[1][1] + R[2][2], R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]},
            {R[2][1] - R[1][2], 1 + R[0][0] - R[1][1] - R[2][2], R[1][0] + R[0][1], R[0][2] + R[2][0]},
            {R[0][2] - R[2][0], R[1][0] + R[0][1], 1 - R[0][0] + R[1][1] - R[2][2], R[2][1] + R[1][2]},
            {R[1][0] - R[0][1], R[0][2] + R[2][0], R[2][1] + R[1][2], 1 - R[0][0] - R[1][1] + R[2][2]},
        };
        for (i = 1; i < 4; ++i) {
            best = by[i][i] > by[best][best] ? i : best;
        }
        for (i = 0; i < 4; ++i) {
            q[i] = by[best][i];
        }
    }
    to_unit(q, 4);
}

/* q + dt times its derivative at the angular velocity omega [rad/s], and less `descent`, if there is
 * one, dt times; then at length 1. Returns 1 if that is not finite. */
static int integrate(real *q, const real *omega, real dt, const real *descent)
{
    const real w = q[0], x = q[1], y = q[2], z = q[3], half = (real)0.5 * dt;
    int i;
    q[0] += half * (-x * omega[0] - y * omega[1] - z * omega[2]);
    q[1] += half * (w * omega[0] + y * omega[2] - z * omega[1]);
    q[2] += half * (w * omega[1] - x * omega[2] + z * omega[0]);
    q[3] += half * (w * omega[2] + x * omega[1] - y * omega[0]);
    for (i = 0; descent && i < 4; ++i) {
        q[i] -= dt * descent[i];
    }
    to_unit(q, 4);
    for (i = 0; i < 4; ++i) {
        if (!(q[i] - q[i] == 0)) {
            return 1;
        }
    }
    return 0;
}

/* To east, north, up: a quarter of a turn about the vertical. */
static void to_east_north_up(const real *q, real *found)
{
    const real c = (real)0.70710678118654752;
    found[0] = c * (q[0] - q[3]);
    found[1] = c * (q[1] - q[2]);
    found[2] = c * (q[2] + q[1]);
    found[3] = c * (q[3] + q[0]);
}
