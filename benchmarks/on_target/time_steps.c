/* Times an exported filter on this machine: all samples of a file, several times over.
 *
 * Standard input: the first attitude (and position), then dt and a measurement a sample, in
 * POSEGSA_REAL. Standard output: nanoseconds a step of each pass, a line each; then the sizes of
 * state and measurement in bytes and, of the last attitude, millionths of w without its sign. */

#define _POSIX_C_SOURCE 199309L
#include "posegsa.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

typedef struct sample {
    posegsa_real dt;
    posegsa_measurement seen;
} sample;

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int argc, char **argv)
{
    const int count = argc > 1 ? atoi(argv[1]) : 0, passes = argc > 2 ? atoi(argv[2]) : 0;
    sample *const samples = malloc((size_t)count * sizeof *samples);
    posegsa_real attitude[4];
    posegsa_state state;
    int pass, k, failed = 0;
    if (!samples || fread(attitude, sizeof attitude, 1, stdin) != 1) {
        return 1;
    }
#ifdef ATTITUDE_ONLY
    posegsa_init(&state, attitude);
#else
    posegsa_real position[3];
    if (fread(position, sizeof position, 1, stdin) != 1) {
        return 1;
    }
    posegsa_init(&state, attitude, position);
#endif
    if (fread(samples, sizeof *samples, (size_t)count, stdin) != (size_t)count) {
        return 1;
    }
    for (pass = 0; pass < passes; ++pass) {
        const double begin = seconds();
        for (k = 0; k < count; ++k) {
            failed |= posegsa_step(&state, &samples[k].seen, samples[k].dt) != POSEGSA_OK;
        }
        printf("%.2f\n", 1e9 * (seconds() - begin) / count);
    }
    printf("%zu %zu %.0f\n", sizeof(posegsa_state), sizeof(posegsa_measurement),
           1e6 * (double)(state.attitude[0] < 0 ? -state.attitude[0] : state.attitude[0]));
    free(samples);
    return failed;
}
