/* QEMU's board mps2-an386, a Cortex-M4F, run with `-icount shift=0`: every instruction then takes one
 * nanosecond of its clock, and SysTick, which counts that clock, counts instructions. How many of
 * them a tick is comes from a loop of known length. Writes by semihosting.
 *
 * A program includes this file once and defines count(), which is called after the reset. */

#define SYSTICK_CONTROL (*(volatile unsigned *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile unsigned *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile unsigned *)0xE000E018u)
#define COPROCESSORS (*(volatile unsigned *)0xE000ED88u)

enum { WRITE0 = 4, EXIT = 0x18, EXITED = 0x20026, LOOPS = 1000000 };

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

/* Starts SysTick, and writes how many instructions a tick is. */
static void start_counting(void)
{
    unsigned loops = LOOPS, of_loop;
    SYSTICK_RELOAD = 0xFFFFFFu;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5; /* on, the processor's clock */
    ticks();
    __asm__ volatile("1: subs %0, #1\n bne 1b" : "+r"(loops) : : "cc");
    of_loop = ticks();
    write_number("instructions of the loop ", 2u * LOOPS);
    write_number("ticks of the loop ", of_loop);
}

static void count(void);
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
