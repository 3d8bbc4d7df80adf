/* Gives an exported filter a million samples and checks its state after each. Most samples contain
 * garbage. A plausible sample follows each refused one and must be accepted. Returns 0, or the
 * number of the check that failed. */

#include "posegsa.h"
#include <string.h>

#ifndef STEPS
#define STEPS 1000000
#endif

static unsigned long long seed = 88172645463325252ULL;

/* xorshift64 */
static unsigned long long bits(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed;
}

/* From -1 to 1. */
static posegsa_real noise(void)
{
    return POSEGSA_C((double)(bits() >> 11) / 4503599627370496.0 - 1.0);
}

/* Any number: a special one, one of any magnitude, or one that a sensor might give. */
static posegsa_real garbage(void)
{
    const posegsa_real tiny = POSEGSA_C(sizeof(posegsa_real) < sizeof(double) ? 1e-45 : 5e-324);
    switch (bits() % 12) {
    case 0:
        return POSEGSA_C(NAN);
    case 1:
        return POSEGSA_C(INFINITY);
    case 2:
        return -POSEGSA_C(INFINITY);
    case 3:
        return tiny;
    case 4:
        return 0;
    case 5:
        return POSEGSA_C(1e26) * noise();
    case 6:
        return POSEGSA_C(pow(10.0, 38.0 * (double)noise()));
    case 7:
        return POSEGSA_C(pow(10.0, 9.0 * (double)noise()));
    default:
        return noise();
    }
}

/* The measurements of a body at rest and upright at the origin, with noise; returns dt. */
static posegsa_real plausible(posegsa_measurement *sample)
{
    int i, k;
    for (k = 0; k < 3; ++k) {
        sample->angular_velocity[k] = POSEGSA_C(0.1) * noise();
        sample->velocity[k] = POSEGSA_C(0.1) * noise();
        for (i = 0; i < POSEGSA_VECTORS; ++i) {
            sample->vectors[i][k] = posegsa_vectors[i][k] + POSEGSA_C(0.1) * noise();
            sample->vector_weights[i] = 1;
        }
        for (i = 0; i < POSEGSA_LANDMARKS; ++i) {
            sample->landmarks[i][k] = posegsa_landmarks[i][k] + POSEGSA_C(0.1) * noise();
            sample->landmark_weights[i] = 1;
        }
    }
    return POSEGSA_C(0.01);
}

int main(void)
{
    enum { NUMBERS = sizeof(posegsa_measurement) / sizeof(posegsa_real) };
    const posegsa_real attitude[4] = {1, 0, 0, 0}, position[3] = {0, 0, 0};
    posegsa_real numbers[NUMBERS];
    posegsa_measurement sample;
    posegsa_state state, before;
    int k, n, refused = 0;
    if (posegsa_init(&state, attitude, position) != POSEGSA_OK) {
        return 1;
    }
    for (k = 0; k < STEPS; ++k) {
        posegsa_real dt = plausible(&sample), square = 0;
        const int wild = !refused && bits() % 16;
        int code;
        if (wild) {
            /* Replace one number, several or all. */
            const unsigned long long share = 1 + bits() % NUMBERS;
            memcpy(numbers, &sample, sizeof sample);
            for (n = 0; n < NUMBERS; ++n) {
                numbers[n] = bits() % NUMBERS < share * share / NUMBERS ? garbage() : numbers[n];
            }
            memcpy(&sample, numbers, sizeof sample);
            dt = bits() % 4 ? dt : garbage();
        }
        before = state;
        code = posegsa_step(&state, &sample, dt);
        if (code != POSEGSA_OK && code != POSEGSA_INVALID_INPUT && code != POSEGSA_NOT_FINITE) {
            return 2;
        }
        if (code != POSEGSA_OK && memcmp(&state, &before, sizeof state) != 0) {
            return 3;
        }
        for (n = 0; n < 4; ++n) {
            square += state.attitude[n] * state.attitude[n];
        }
        if (!(posegsa_max(square - 1, 1 - square) < POSEGSA_C(1e-5))) {
            return 4;
        }
        if (!wild && code != POSEGSA_OK) {
            return 5;
        }
        refused = code != POSEGSA_OK;
    }
    return 0;
}
