/* Counts the instructions of an attitude filter's step on an emulated Cortex-M4F.
 *
 * For QEMU's board mps2-an386 with `-icount shift=0`: every instruction then takes one nanosecond of
 * its clock, and SysTick, which counts that clock, counts instructions. How many of them a tick is
 * comes from a loop of known length. Writes by semihosting. */

#include "attitude_filter.h"
#include "samples.h" /* SAMPLES, time_step, and gyr, acc and mag of each sample */

#define SYSTICK_CONTROL (*(volatile unsigned *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile unsigned *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile unsigned *)0xE000E018u)
#define COPROCESSORS (*(volatile unsigned *)0xE000ED88u)

enum { WRITE0 = 4, EXIT = 0x18, EXITED = 0x20026, LOOPS = 1000000, PASSES = 4 };

static void host(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

static void write_number(const char *name, unsigned number)
{
    char text[12], *at = text + sizeof text;
    *--at = 0;
    *--at = '\n';
    do {
        *--at = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    host(WRITE0, name);
    host(WRITE0, at);
}

/* Ticks since the last call; SysTick counts down, 24 bits. */
static unsigned ticks(void)
{
    static unsigned before;
    const unsigned now = SYSTICK_VALUE, passed = (before - now) & 0xFFFFFFu;
    before = now;
    return passed;
}

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
    unsigned loops = LOOPS, of_loop, of_steps = 0, of_nothing = 0, failed = 0;
    real q[4];
    int pass, k;
    SYSTICK_RELOAD = 0xFFFFFFu;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5; /* on, the processor's clock */
    ticks();
    __asm__ volatile("1: subs %0, #1\n bne 1b" : "+r"(loops) : : "cc");
    of_loop = ticks();
    failed |= (unsigned)begin(&filter, time_step);
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
    write_number("instructions of the loop ", 2u * LOOPS);
    write_number("ticks of the loop ", of_loop);
    write_number("ticks of the steps ", of_steps);
    write_number("ticks without them ", of_nothing);
    write_number("steps ", (unsigned)PASSES * SAMPLES);
    write_number("failed ", failed);
    write_number("attitude ", (unsigned)((q[0] < 0 ? -q[0] : q[0]) * 1000000));
}

void reset(void);
void reset(void)
{
    COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n isb");
    count();
    host(EXIT, (const void *)EXITED);
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    (const void *)0x20400000, /* the stack's top */
    (const void *)reset,
};
