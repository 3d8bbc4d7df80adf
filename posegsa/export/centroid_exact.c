/* Adds `sign` times the area and first moment of the intersection of output terms i <= j, clipped
 * at a height h, or where they cross: F(h) = D h - (u + v) h^2/2 and
 * M(h) = 1/2 [(c_i^2 - a_j^2) h - (c_i v + a_j u) h^2 + (v^2 - u^2) h^3/3]
 * with u = b_j - a_j, v = c_i - b_i, D = c_i - a_j. */
static inline void posegsa_add_overlap(int i, int j, posegsa_real height, posegsa_real sign,
                                       posegsa_real *area, posegsa_real *moment)
{
    const posegsa_real a = posegsa_output_terms[j][0];
    const posegsa_real c = posegsa_output_terms[i][2];
    const posegsa_real u = posegsa_output_terms[j][1] - a;
    const posegsa_real v = c - posegsa_output_terms[i][1];
    const posegsa_real width = c - a;
    const posegsa_real slope = u + v;
    const posegsa_real half = POSEGSA_C(0.5);
    posegsa_real h = posegsa_min(height, 1);
    if (!(width > 0) || !(height > 0)) { /* nothing to add */
        return;
    }
    if (slope > 0) {
        h = posegsa_min(h, width / slope);
    }
    *area += sign * (h * (width - h * (half * slope)));
    *moment += sign * (h * (half * width * (c + a) -
                            h * (half * (c * v + a * u) - h * (slope * (v - u) / 6))));
}

/* Area and first moment under the union of the clipped output terms, by inclusion and exclusion:
 * the overlap of terms i < j is subtracted only above the tallest term between them. */
static inline void posegsa_integrals(const posegsa_real heights[POSEGSA_OUTPUTS],
                                     posegsa_real *area, posegsa_real *moment)
{
    int i, j;
    *area = 0;
    *moment = 0;
    for (i = 0; i < POSEGSA_OUTPUTS; ++i) {
        posegsa_real between = 0;
        if (!(heights[i] > 0)) { /* most terms do not fire */
            continue;
        }
        posegsa_add_overlap(i, i, heights[i], 1, area, moment);
        for (j = i + 1; j < POSEGSA_OUTPUTS; ++j) {
            if (heights[j] > 0) {
                const posegsa_real both = posegsa_min(heights[i], heights[j]);
                posegsa_add_overlap(i, j, both, -1, area, moment);
                posegsa_add_overlap(i, j, posegsa_min(both, between), 1, area, moment);
                between = posegsa_max(between, heights[j]);
            }
        }
    }
}
