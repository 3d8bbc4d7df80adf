/* Vectors and quaternions of length 1, in the type `real`. */

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
