/* Counts the instructions of an attitude filter's step on an emulated Cortex-M4F. */

#include "attitude_filter.h"
#include "samples.h" /* SAMPLES, time_step, and gyr, acc and mag of each sample */
#include "board.h"

enum { PASSES = 4 };

/* Apart, so that the compiler can't take anything out of the loop that calls it. */
__attribute__((noinline)) static int one_step(filter_state *filter, const real *sample)
{
    return step(filter, sample, sample + 3, sample + 6);
}

__attribute__((noinline)) static int no_step(filter_state *filter, const real *sample)
{
    __asm__ volatile("" : : "r"(filter), "r"(sample) : "memory");
    return 0;
}

static void count(void)
{
    static filter_state filter;
    unsigned of_steps = 0, of_nothing = 0, failed = 0;
    real q[4];
    int pass, k;
    start_counting();
    failed |= (unsigned)begin(&filter, time_step, samples[0] + 3, samples[0] + 6);
    for (pass = 0; pass < PASSES; ++pass) {
        ticks();
        for (k = 0; k < SAMPLES; ++k) {
            failed |= (unsigned)one_step(&filter, samples[k]);
        }
        of_steps += ticks();
        for (k = 0; k < SAMPLES; ++k) {
            failed |= (unsigned)no_step(&filter, samples[k]);
        }
        of_nothing += ticks();
    }
    attitude(&filter, q);
    write_number("ticks of the steps ", of_steps);
    write_number("ticks without them ", of_nothing);
    write_number("steps ", (unsigned)PASSES * SAMPLES);
    write_number("failed ", failed);
    write_number("attitude ", (unsigned)((q[0] < 0 ? -q[0] : q[0]) * 1000000));
}
