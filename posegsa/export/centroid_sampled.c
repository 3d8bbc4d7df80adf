/* Number of samples of the output, ends included, and the weight of the two end samples. */
enum { POSEGSA_POINTS = {{ points }} };
static const posegsa_real posegsa_end_weight = POSEGSA_C({{ end_weight }});
static const posegsa_real posegsa_low = POSEGSA_C({{ low }});   /* [1/s] */
static const posegsa_real posegsa_high = POSEGSA_C({{ high }}); /* [1/s] */

/* Adds to a sum and keeps the rounding error for the next addition (Kahan). */
static inline void posegsa_add(posegsa_real x, posegsa_real *sum, posegsa_real *excess)
{
    const posegsa_real wanted = x - *excess;
    const posegsa_real next = *sum + wanted;
    *excess = (next - *sum) - wanted;
    *sum = next;
}

/* Area and first moment under the clipped output terms from samples, in units of their spacing. */
static inline void posegsa_integrals(const posegsa_real heights[POSEGSA_OUTPUTS],
                                     posegsa_real *area, posegsa_real *moment)
{
    const posegsa_real range = posegsa_high - posegsa_low;
    posegsa_real area_excess = 0, moment_excess = 0;
    int k, j;
    *area = 0;
    *moment = 0;
    for (k = 0; k < POSEGSA_POINTS; ++k) {
        const posegsa_real x = posegsa_low + range * (posegsa_real)k / (POSEGSA_POINTS - 1);
        posegsa_real level = 0;
        for (j = 0; j < POSEGSA_OUTPUTS; ++j) {
            const posegsa_real inside = posegsa_membership(x, posegsa_output_terms[j]);
            level = posegsa_max(level, posegsa_min(heights[j], inside));
        }
        if (k == 0 || k == POSEGSA_POINTS - 1) {
            level *= posegsa_end_weight;
        }
        posegsa_add(level, area, &area_excess);
        posegsa_add(level * x, moment, &moment_excess);
    }
}
