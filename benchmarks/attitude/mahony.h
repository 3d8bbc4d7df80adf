/* Mahony's explicit complementary filter for gyroscope, accelerometer and magnetometer, with its bias:
 * R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal
 * group", IEEE TAC 53(5), 2008, Eq. 32 and Eqs. 48a to 48c. Gains k_P 1 and k_I 0.3 as there. The
 * field's reference is its own mean direction, (b_x, 0, b_z): the earth frame is north, west, up. */

#include "quaternion.h"

typedef struct {
    real q[4], bias[3], dt; /* body to north, west, up */
} filter_state;

static int begin(filter_state *filter, real dt, const real *acc, const real *mag)
{
    from_vectors(acc, mag, filter->q);
    filter->bias[0] = filter->bias[1] = filter->bias[2] = 0;
    filter->dt = dt;
    return 0;
}

static int step(filter_state *filter, const real *gyr, const real *acc, const real *mag)
{
    const real kp = 1, ki = (real)0.3, dt = filter->dt;
    const real w = filter->q[0], x = filter->q[1], y = filter->q[2], z = filter->q[3];
    real a[3] = {acc[0], acc[1], acc[2]}, m[3] = {mag[0], mag[1], mag[2]}, R[3][3], v[3], u[3];
    real hx, hy, bx, bz, turn[3];
    int i;
    to_unit(a, 3);
    to_unit(m, 3);
    R[0][0] = 1 - 2 * (y * y + z * z), R[0][1] = 2 * (x * y - w * z), R[0][2] = 2 * (x * z + w * y);
    R[1][0] = 2 * (x * y + w * z), R[1][1] = 1 - 2 * (x * x + z * z), R[1][2] = 2 * (y * z - w * x);
    R[2][0] = 2 * (x * z - w * y), R[2][1] = 2 * (y * z + w * x), R[2][2] = 1 - 2 * (x * x + y * y);
    hx = R[0][0] * m[0] + R[0][1] * m[1] + R[0][2] * m[2];
    hy = R[1][0] * m[0] + R[1][1] * m[1] + R[1][2] * m[2];
    bx = sqrt_of(hx * hx + hy * hy);
    bz = R[2][0] * m[0] + R[2][1] * m[1] + R[2][2] * m[2];
    for (i = 0; i < 3; ++i) {
        v[i] = R[2][i];                     /* up, in the body */
        u[i] = bx * R[0][i] + bz * R[2][i]; /* the field's reference, in the body */
    }
    for (i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const real off = a[j] * v[k] - a[k] * v[j] + m[j] * u[k] - m[k] * u[j];
        filter->bias[i] -= ki * off * dt;
        turn[i] = gyr[i] - filter->bias[i] + kp * off;
    }
    return integrate(filter->q, turn, dt, 0);
}

static void attitude(const filter_state *filter, real *q)
{
    to_east_north_up(filter->q, q);
}
