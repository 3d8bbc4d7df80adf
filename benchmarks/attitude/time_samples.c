/* Times an attitude filter on this machine: all samples of a trial, several times over.
 *
 * Arguments: number of samples, passes, and a file for the attitudes of the first pass. Standard
 * input: dt, then gyr, acc and mag of each sample, in the filter's type. Standard output: nanoseconds
 * of CPU a sample of each pass, a line each, and the size of its state in bytes. */

#define _POSIX_C_SOURCE 199309L
#include "attitude_filter.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int argc, char **argv)
{
    const size_t count = argc > 1 ? (size_t)atol(argv[1]) : 0;
    const int passes = argc > 2 ? atoi(argv[2]) : 0;
    FILE *const out = argc > 3 ? fopen(argv[3], "wb") : 0;
    real(*const samples)[9] = (real(*)[9])malloc(count * sizeof *samples);
    static filter_state filter;
    real dt, q[4];
    int pass, failed = 0;
    size_t k;
    if (!out || !samples || fread(&dt, sizeof dt, 1, stdin) != 1 ||
        fread(samples, sizeof *samples, count, stdin) != count) {
        return 1;
    }
    failed |= begin(&filter, dt, samples[0] + 3, samples[0] + 6);
    for (k = 0; k < count; ++k) {
        failed |= step(&filter, samples[k], samples[k] + 3, samples[k] + 6);
        attitude(&filter, q);
        fwrite(q, sizeof q, 1, out);
    }
    fclose(out);
    for (pass = 0; pass < passes; ++pass) {
        const double start = seconds();
        for (k = 0; k < count; ++k) {
            failed |= step(&filter, samples[k], samples[k] + 3, samples[k] + 6);
        }
        printf("%.2f\n", 1e9 * (seconds() - start) / (double)count);
    }
    printf("%zu\n", sizeof filter);
    free(samples);
    return failed;
}
