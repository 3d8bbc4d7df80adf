/* One of the attitude filters that are compared, under common names. Which one: FILTER.
 *
 * begin(filter, dt, acc, mag) with the first sample, from which the filters of Madgwick and of Mahony,
 * without a start of their own, take the first attitude; step(filter, gyr, acc, mag) with a sample in
 * rad/s, m/s^2 and any unit; attitude(filter, q) gives w, x, y, z from the body to east, north, up. */

#ifndef ATTITUDE_FILTER_H
#define ATTITUDE_FILTER_H

#define POSEGSA 1
#define VQF_CPP 2
#define MADGWICK 3
#define MAHONY 4

#if FILTER == POSEGSA

#include "posegsa.h"

typedef posegsa_real real;
typedef struct {
    posegsa_state state;
    real dt;
} filter_state;

static int begin(filter_state *filter, real dt, const real *acc, const real *mag)
{
    (void)acc, (void)mag;
    const real upright[4] = {1, 0, 0, 0};
    filter->dt = dt;
    return posegsa_init(&filter->state, upright);
}

static int step(filter_state *filter, const real *gyr, const real *acc, const real *mag)
{
    const posegsa_measurement seen = {
        {gyr[0], gyr[1], gyr[2]},
        {{acc[0], acc[1], acc[2]}, {mag[0], mag[1], mag[2]}},
        {1, 1},
    };
    return posegsa_step(&filter->state, &seen, filter->dt);
}

/* At the sample, as the others have it. */
static void attitude(const filter_state *filter, real *q)
{
    int i;
    for (i = 0; i < 4; ++i) {
        q[i] = filter->state.at_sample[i];
    }
}

#elif FILTER == VQF_CPP

#include "vqf.hpp"
#include <new>

typedef vqf_real_t real;
struct filter_state {
    alignas(VQF) unsigned char memory[sizeof(VQF)]; /* it has no constructor without a rate */
};

static VQF *of(filter_state *filter)
{
    return reinterpret_cast<VQF *>(filter->memory);
}

static int begin(filter_state *filter, real dt, const real *acc, const real *mag)
{
    (void)acc, (void)mag;
    new (filter->memory) VQF(dt);
    return 0;
}

static int step(filter_state *filter, const real *gyr, const real *acc, const real *mag)
{
    of(filter)->update(gyr, acc, mag);
    return 0;
}

static void attitude(filter_state *filter, real *q)
{
    of(filter)->getQuat9D(q);
}

#else

#ifndef REAL
#define REAL float
#endif
typedef REAL real;
#if FILTER == MADGWICK
#include "madgwick.h"
#else
#include "mahony.h"
#endif

#endif
#endif
