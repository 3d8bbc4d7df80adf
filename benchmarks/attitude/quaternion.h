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

static void to_identity(real *q)
{
    q[0] = 1;
    q[1] = q[2] = q[3] = 0;
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
