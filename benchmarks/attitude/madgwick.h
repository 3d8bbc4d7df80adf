/* Madgwick's filter for gyroscope, accelerometer and magnetometer, without its bias: S. Madgwick, A.
 * Harrison, R. Vaidyanathan, "Estimation of IMU and MARG orientation using a gradient descent
 * algorithm", ICORR 2011, Eqs. 11 to 12, 25 to 26, 31 to 34 and 42 to 46. Gain 0.041 as there. The
 * quaternion of the paper is from the earth to the body; the field's reference is its own mean
 * direction, (b_x, 0, b_z), so its earth frame is north, west, up. */

#include "quaternion.h"

typedef struct {
    real q[4], dt; /* body to north, west, up */
} filter_state;

static int begin(filter_state *filter, real dt, const real *acc, const real *mag)
{
    from_vectors(acc, mag, filter->q);
    filter->dt = dt;
    return 0;
}

static int step(filter_state *filter, const real *gyr, const real *acc, const real *mag)
{
    const real beta = (real)0.041, half = (real)0.5;
    const real w = filter->q[0], x = filter->q[1], y = filter->q[2], z = filter->q[3];
    real a[3] = {acc[0], acc[1], acc[2]}, m[3] = {mag[0], mag[1], mag[2]}, gradient[4], h[3];
    real bx, bz, f[6];
    int i;
    to_unit(a, 3);
    to_unit(m, 3);
    /* The field in the earth frame, and its reference without a heading. */
    h[0] = m[0] * (1 - 2 * (y * y + z * z)) + 2 * m[1] * (x * y - w * z) + 2 * m[2] * (x * z + w * y);
    h[1] = 2 * m[0] * (x * y + w * z) + m[1] * (1 - 2 * (x * x + z * z)) + 2 * m[2] * (y * z - w * x);
    h[2] = 2 * m[0] * (x * z - w * y) + 2 * m[1] * (y * z + w * x) + m[2] * (1 - 2 * (x * x + y * y));
    bx = sqrt_of(h[0] * h[0] + h[1] * h[1]);
    bz = h[2];
    /* What both vectors are off by, and the gradient of half its square. */
    f[0] = 2 * (x * z - w * y) - a[0];
    f[1] = 2 * (w * x + y * z) - a[1];
    f[2] = 1 - 2 * (x * x + y * y) - a[2];
    f[3] = 2 * bx * (half - y * y - z * z) + 2 * bz * (x * z - w * y) - m[0];
    f[4] = 2 * bx * (x * y - w * z) + 2 * bz * (w * x + y * z) - m[1];
    f[5] = 2 * bx * (w * y + x * z) + 2 * bz * (half - x * x - y * y) - m[2];
    gradient[0] = -2 * y * f[0] + 2 * x * f[1] - 2 * bz * y * f[3] + 2 * (-bx * z + bz * x) * f[4] +
                  2 * bx * y * f[5];
    gradient[1] = 2 * z * f[0] + 2 * w * f[1] - 4 * x * f[2] + 2 * bz * z * f[3] +
                  2 * (bx * y + bz * w) * f[4] + 2 * (bx * z - 2 * bz * x) * f[5];
    gradient[2] = -2 * w * f[0] + 2 * z * f[1] - 4 * y * f[2] - 2 * (2 * bx * y + bz * w) * f[3] +
                  2 * (bx * x + bz * z) * f[4] + 2 * (bx * w - 2 * bz * y) * f[5];
    gradient[3] = 2 * x * f[0] + 2 * y * f[1] + 2 * (-2 * bx * z + bz * x) * f[3] +
                  2 * (-bx * w + bz * y) * f[4] + 2 * bx * x * f[5];
    to_unit(gradient, 4);
    for (i = 0; i < 4; ++i) {
        gradient[i] *= beta;
    }
    return integrate(filter->q, gyr, filter->dt, gradient);
}

static void attitude(const filter_state *filter, real *q)
{
    to_east_north_up(filter->q, q);
}
