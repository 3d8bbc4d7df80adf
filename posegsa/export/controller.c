enum { POSEGSA_INPUTS = {{ inputs }}, POSEGSA_OUTPUTS = {{ outputs }} };

/* Input terms, shared by error and rate: left foot, peak, right foot [no unit]. */
static const posegsa_real posegsa_input_terms[POSEGSA_INPUTS][3] = {
{{ input_terms }}
};

/* Output terms: left foot, peak, right foot [1/s]. */
static const posegsa_real posegsa_output_terms[POSEGSA_OUTPUTS][3] = {
{{ output_terms }}
};

/* Output term of each rule (0 is VS): rows are the rate, columns the error, both from VS to VL. */
static const unsigned char posegsa_rules[POSEGSA_INPUTS][POSEGSA_INPUTS] = {
{{ rules }}
};

static const posegsa_real posegsa_middle_gain = POSEGSA_C({{ initial_gain }}); /* [1/s] */

/* Areas up to this count as 0: the square root of the smallest normal number. */
static const posegsa_real posegsa_minimum_area =
    POSEGSA_C(sizeof(posegsa_real) < sizeof(double) ? 1.0842021724855044e-19
                                                    : 1.4916681462400413e-154);

/* Degree in [0, 1] to which x belongs to a term; an edge may be vertical. */
static inline posegsa_real posegsa_membership(posegsa_real x, const posegsa_real term[3])
{
    const posegsa_real peak = term[1];
    const posegsa_real width = x < peak ? peak - term[0] : term[2] - peak;
    const posegsa_real distance = x < peak ? peak - x : x - peak;
    if (!(distance > 0)) {
        return 1;
    }
    /* min before the difference: a fused multiply-add would give nearly 0, not 0, at the foot. */
    return width > 0 ? 1 - posegsa_min(distance * (1 / width), 1) : 0;
}

{% include centroid %}

{{ linkage }}posegsa_real posegsa_initial_gain(void)
{
    return posegsa_middle_gain;
}

{{ linkage }}posegsa_real posegsa_gain(posegsa_real error, posegsa_real rate,
                                       posegsa_real last_gain)
{
    posegsa_real of_error[POSEGSA_INPUTS], of_rate[POSEGSA_INPUTS];
    posegsa_real heights[POSEGSA_OUTPUTS] = {0};
    posegsa_real tallest = 0, area, moment;
    int i, r, e;

    if (last_gain != last_gain) { /* NaN */
        last_gain = posegsa_initial_gain();
    }
    if (error != error || rate != rate) { /* NaN */
        return last_gain;
    }
    error = posegsa_min(posegsa_max(error, 0), 1);
    rate = posegsa_min(posegsa_max(rate, 0), 1);

    for (i = 0; i < POSEGSA_INPUTS; ++i) {
        of_error[i] = posegsa_membership(error, posegsa_input_terms[i]);
        of_rate[i] = posegsa_membership(rate, posegsa_input_terms[i]);
    }
    for (r = 0; r < POSEGSA_INPUTS; ++r) {
        for (e = 0; of_rate[r] > 0 && e < POSEGSA_INPUTS; ++e) { /* few rows fire */
            const int output = posegsa_rules[r][e];
            const posegsa_real fired = posegsa_min(of_rate[r], of_error[e]);
            heights[output] = posegsa_max(heights[output], fired);
            tallest = posegsa_max(tallest, fired);
        }
    }
    if (!(tallest > 0)) { /* no rule fires */
        return {{ no_rule }};
    }

    posegsa_integrals(heights, &area, &moment);
    if (!(area > posegsa_minimum_area)) {
        /* Rules fire, but the area is 0: terms of zero width, or heights near underflow. The result
         * is the limit for equally narrow terms, each at the middle of its support. */
        area = 0;
        moment = 0;
        for (i = 0; i < POSEGSA_OUTPUTS; ++i) {
            const posegsa_real *term = posegsa_output_terms[i];
            const posegsa_real spike = heights[i] / tallest * (2 - heights[i]);
            area += spike;
            moment += spike * (POSEGSA_C(0.5) * (term[0] + term[2]));
        }
    }
    return POSEGSA_C({{ offset }}) + moment / area;
}
