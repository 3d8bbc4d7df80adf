/* Runs an exported filter. Standard input: the initial attitude (and position), then dt and the
 * measurement of each sample. Standard output, for each sample: the return code of the step and the
 * state before it. */

#include "posegsa.h"
#include <stdio.h>

static int take(void *to, size_t size)
{
    return fread(to, size, 1, stdin) == 1;
}

int main(void)
{
    posegsa_state state;
    posegsa_measurement sample;
    posegsa_real attitude[4], dt;
#ifdef ATTITUDE_ONLY
    if (!take(attitude, sizeof attitude) || posegsa_init(&state, attitude) != POSEGSA_OK) {
        return 1;
    }
#else
    posegsa_real position[3];
    if (!take(attitude, sizeof attitude) || !take(position, sizeof position) ||
        posegsa_init(&state, attitude, position) != POSEGSA_OK) {
        return 1;
    }
#endif
    while (take(&dt, sizeof dt) && take(&sample, sizeof sample)) {
        const posegsa_state before = state;
        const posegsa_real code = POSEGSA_C(posegsa_step(&state, &sample, dt));
        if (fwrite(&code, sizeof code, 1, stdout) != 1 ||
            fwrite(&before, sizeof before, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
