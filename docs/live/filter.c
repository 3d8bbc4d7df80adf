/* An exported filter for the live page: one WebAssembly module for each filter, all with the same
 * functions. Compiled natively, it filters standard input: the test compares the two.
 *
 * BELIEF, UNKNOWN or GAIN names what the filter schedules; without one it schedules nothing. */

#include "posegsa.h"

#ifdef __wasm__
#define EXPORT(name) __attribute__((export_name(name)))
#else
#define EXPORT(name) static
#endif

enum { SENSORS = POSEGSA_VECTORS + POSEGSA_LANDMARKS, POSE = 6 };

/* What the page reads after a step, all double. */
typedef struct output {
    double attitude[4]; /* w, x, y, z, body to inertial */
    double position[3]; /* [m], inertial frame */
    double bias_angular[3], bias_linear[3], vector_bias[POSEGSA_VECTORS][3]; /* body frame */
    double covariance[POSE][POSE]; /* of attitude [rad] and position [m], body frame; or all NaN */
    double scheduled[SENSORS]; /* belief in each sensor; or in the first place factor or gain */
} output;

static posegsa_state state;
static posegsa_measurement sample;
static output last;

static void write_output(void)
{
    int i, k;
    for (i = 0; i < 4; ++i) {
        last.attitude[i] = state.attitude[i];
    }
    for (i = 0; i < 3; ++i) {
        last.position[i] = state.position[i];
        last.bias_angular[i] = state.bias_angular[i];
        last.bias_linear[i] = state.bias_linear[i];
        for (k = 0; k < POSEGSA_VECTORS; ++k) {
            last.vector_bias[k][i] = state.vector_bias[k][i];
        }
    }
#ifdef GAIN
    for (i = 0; i < POSE * POSE; ++i) {
        last.covariance[i / POSE][i % POSE] = NAN;
    }
    last.scheduled[0] = state.gain_used;
#else
    for (i = 0; i < POSE; ++i) {
        for (k = i; k < POSE; ++k) { /* the upper triangle by rows */
            const int row = i * POSEGSA_ERROR_STATES - i * (i - 1) / 2;
            last.covariance[i][k] = last.covariance[k][i] = state.covariance[row + k - i];
        }
    }
#endif
    /* A factor is largest^((K - 1) / 100), K the output of the schedule: the third of the four
     * numbers that it remembers of each input. */
#ifdef UNKNOWN
    last.scheduled[0] = exp(0.01 * (state.memory_unknown_gain - 1) *
                            log(posegsa_filter_signals_unknown_largest));
#endif
#ifdef BELIEF
    for (i = 0; i < SENSORS; ++i) {
        const posegsa_real *const memory =
            i < POSEGSA_VECTORS ? state.memory_vectors + 4 * i
                                : state.memory_landmarks + 4 * (i - POSEGSA_VECTORS);
        last.scheduled[i] =
            exp(-0.01 * (memory[2] - 1) * log(posegsa_filter_signals_belief_largest));
    }
#endif
}

/* Starts the filter at a pose. */
EXPORT("start")
int start(double w, double x, double y, double z, double east, double north, double up)
{
    const posegsa_real attitude[4] = {w, x, y, z}, position[3] = {east, north, up};
    const int code = posegsa_init(&state, attitude, position);
    write_output();
    return code;
}

/* One sample, which has been written to `measurement`. */
EXPORT("step")
int step(double dt)
{
    const int code = posegsa_step(&state, &sample, dt);
    write_output();
    return code;
}

#ifdef __wasm__

EXPORT("measurement")
void *measurement(void) { return &sample; }

EXPORT("output")
void *output_of_last(void) { return &last; }

EXPORT("measurement_size")
int measurement_size(void) { return sizeof sample / sizeof(double); }

EXPORT("output_size")
int output_size(void) { return sizeof last / sizeof(double); }

#else

#include <stdio.h>

/* Standard input: dt, the first pose, and each sample. Standard output: the output of each. */
int main(void)
{
    double dt, p[7];
    if (fread(&dt, sizeof dt, 1, stdin) != 1 || fread(p, sizeof p, 1, stdin) != 1 ||
        start(p[0], p[1], p[2], p[3], p[4], p[5], p[6]) != POSEGSA_OK) {
        return 1;
    }
    while (fread(&sample, sizeof sample, 1, stdin) == 1) {
        if (step(dt) != POSEGSA_OK || fwrite(&last, sizeof last, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}

#endif
