/* Counts the instructions of an exported filter's step on an emulated Cortex-M4F. */

#include "posegsa.h"
#include "samples.h" /* SAMPLES of a posegsa_measurement each, first_attitude, first_position */
#include "board.h"

enum { PASSES = 20 };

/* Apart, so that the compiler can't take anything out of the loop that calls it. */
__attribute__((noinline)) static int one_step(posegsa_state *state, const posegsa_measurement *seen)
{
    return posegsa_step(state, seen, POSEGSA_C(0.01));
}

__attribute__((noinline)) static int no_step(posegsa_state *state, const posegsa_measurement *seen)
{
    __asm__ volatile("" : : "r"(state), "r"(seen) : "memory");
    return POSEGSA_OK;
}

static void count(void)
{
    static posegsa_state state;
    unsigned of_steps = 0, of_nothing = 0, failed = 0;
    int pass, k;
    start_counting();
#ifdef ATTITUDE_ONLY
    failed |= posegsa_init(&state, first_attitude) != POSEGSA_OK;
#else
    failed |= posegsa_init(&state, first_attitude, first_position) != POSEGSA_OK;
#endif
    for (pass = 0; pass < PASSES; ++pass) {
        ticks();
        for (k = 0; k < SAMPLES; ++k) {
            failed |= one_step(&state, &samples[k]) != POSEGSA_OK;
        }
        of_steps += ticks();
        for (k = 0; k < SAMPLES; ++k) {
            failed |= no_step(&state, &samples[k]) != POSEGSA_OK;
        }
        of_nothing += ticks();
    }
    write_number("ticks of the steps ", of_steps);
    write_number("ticks without them ", of_nothing);
    write_number("steps ", (unsigned)PASSES * SAMPLES);
    write_number("failed ", failed);
    write_number("attitude ",
                 (unsigned)((state.attitude[0] < 0 ? -state.attitude[0] : state.attitude[0]) *
                            POSEGSA_C(1e6)));
}
