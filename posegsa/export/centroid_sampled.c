/* Samples of the output, ends included, and the weight of the two at the ends. */
enum { POSEGSA_POINTS = $points };
static const POSEGSA_REAL posegsa_end_weight = POSEGSA_C($end_weight);
static const POSEGSA_REAL posegsa_low = POSEGSA_C($low);   /* [1/s] */
static const POSEGSA_REAL posegsa_high = POSEGSA_C($high); /* [1/s] */

/* Adds to a sum and keeps the rounding error for the next time (Kahan): sums of many samples. */
static void posegsa_add(POSEGSA_REAL x, POSEGSA_REAL *sum, POSEGSA_REAL *excess)
{
    const POSEGSA_REAL wanted = x - *excess;
    const POSEGSA_REAL next = *sum + wanted;
    *excess = (next - *sum) - wanted;
    *sum = next;
}

/* Area and first moment under the clipped output terms by samples, the spacing being 1. */
static void posegsa_integrals(const POSEGSA_REAL heights[POSEGSA_OUTPUTS], POSEGSA_REAL *area,
                              POSEGSA_REAL *moment)
{
    const POSEGSA_REAL range = posegsa_high - posegsa_low;
    POSEGSA_REAL area_excess = 0, moment_excess = 0;
    int k, j;
    *area = 0;
    *moment = 0;
    for (k = 0; k < POSEGSA_POINTS; ++k) {
        const POSEGSA_REAL x = posegsa_low + range * (POSEGSA_REAL)k / (POSEGSA_POINTS - 1);
        POSEGSA_REAL level = 0;
        for (j = 0; j < POSEGSA_OUTPUTS; ++j) {
            const POSEGSA_REAL inside = posegsa_membership(x, posegsa_output_terms[j]);
            level = posegsa_max(level, posegsa_min(heights[j], inside));
        }
        if (k == 0 || k == POSEGSA_POINTS - 1) {
            level *= posegsa_end_weight;
        }
        posegsa_add(level, area, &area_excess);
        posegsa_add(level * x, moment, &moment_excess);
    }
}
