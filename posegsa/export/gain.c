/*
 * Fuzzy gain schedule of a pose filter on SE(3), as C99; also valid C++.
$origin
 *
$costs
 *
 * WHAT IT COMPUTES
 * posegsa_gain(error, rate, last_gain) is the gain K [1/s] that the filter multiplies its
 * innovation with, before a limit of its own. error and rate have no unit and are clipped to
 * [0, 1]; last_gain [1/s] is what the last call returned, posegsa_initial_gain() before the first.
$inference
 *
 * HOW error AND rate ARE FORMED, once a sample, with the estimate before its update
$signal
 *
 * USE
 *     gain = posegsa_initial_gain();
 *     for each sample: gain = posegsa_gain(error, rate, gain);
 *
 * INPUTS OUT OF THE ORDINARY
 * Never NaN. error or rate NaN: last_gain, whatever the rule where
 * no rule fires. last_gain NaN: posegsa_initial_gain() in its place. Infinite error or rate:
 * clipped. With -ffast-math a compiler may take the checks for NaN away.
 *
 * PRECISION
 * POSEGSA_REAL is double; compile with -DPOSEGSA_REAL=float for single precision. No headers, no
 * allocation, no state: it may be called from threads and interrupts.
 *
 * THE FILTER IT WAS TUNED IN; in another one the gains may not fit
$filter
 *
 * PARAMETERS
$parameters
 */

#ifndef POSEGSA_REAL
#define POSEGSA_REAL double
#endif

/* Gain K [1/s] of the scaled error and its scaled rate; last_gain is the one before [1/s]. */
POSEGSA_REAL posegsa_gain(POSEGSA_REAL error, POSEGSA_REAL rate, POSEGSA_REAL last_gain);

/* What last_gain is at the first sample [1/s]: the offset + the middle of the output range. */
POSEGSA_REAL posegsa_initial_gain(void);

#define POSEGSA_C(number) ((POSEGSA_REAL)(number))

enum { POSEGSA_INPUTS = $inputs, POSEGSA_OUTPUTS = $outputs };

/* Input terms, shared by error and rate: left foot, peak, right foot [no unit]. */
static const POSEGSA_REAL posegsa_input_terms[POSEGSA_INPUTS][3] = {
$input_terms
};

/* Output terms: left foot, peak, right foot [1/s]. */
static const POSEGSA_REAL posegsa_output_terms[POSEGSA_OUTPUTS][3] = {
$output_terms
};

/* Output term (0 is VS) of each rule: rows are the rate, columns the error, both VS to VL. */
static const unsigned char posegsa_rules[POSEGSA_INPUTS][POSEGSA_INPUTS] = {
$rules
};

static const POSEGSA_REAL posegsa_middle_gain = POSEGSA_C($initial_gain); /* [1/s] */

/* Areas up to this count as none: the square root of the least normal number. */
static const POSEGSA_REAL posegsa_minimum_area =
    POSEGSA_C(sizeof(POSEGSA_REAL) < sizeof(double) ? 1.0842021724855044e-19
                                                    : 1.4916681462400413e-154);

static POSEGSA_REAL posegsa_min(POSEGSA_REAL x, POSEGSA_REAL y)
{
    return x < y ? x : y;
}

static POSEGSA_REAL posegsa_max(POSEGSA_REAL x, POSEGSA_REAL y)
{
    return x > y ? x : y;
}

/* Degree in [0, 1] to which x belongs to a term; an edge may be vertical. */
static POSEGSA_REAL posegsa_membership(POSEGSA_REAL x, const POSEGSA_REAL term[3])
{
    const POSEGSA_REAL peak = term[1];
    const POSEGSA_REAL width = x < peak ? peak - term[0] : term[2] - peak;
    const POSEGSA_REAL distance = x < peak ? peak - x : x - peak;
    if (!(distance > 0)) {
        return 1;
    }
    /* min before the difference: a fused multiply-add would leave a little of 0 at the foot. */
    return width > 0 ? 1 - posegsa_min(distance * (1 / width), 1) : 0;
}

$centroid
POSEGSA_REAL posegsa_initial_gain(void)
{
    return posegsa_middle_gain;
}

POSEGSA_REAL posegsa_gain(POSEGSA_REAL error, POSEGSA_REAL rate, POSEGSA_REAL last_gain)
{
    POSEGSA_REAL of_error[POSEGSA_INPUTS], of_rate[POSEGSA_INPUTS];
    POSEGSA_REAL heights[POSEGSA_OUTPUTS] = {0};
    POSEGSA_REAL tallest = 0, area, moment;
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
        for (e = 0; e < POSEGSA_INPUTS; ++e) {
            const int output = posegsa_rules[r][e];
            const POSEGSA_REAL fired = posegsa_min(of_rate[r], of_error[e]);
            heights[output] = posegsa_max(heights[output], fired);
            tallest = posegsa_max(tallest, fired);
        }
    }
    if (!(tallest > 0)) { /* no rule fires */
        return $no_rule;
    }

    posegsa_integrals(heights, &area, &moment);
    if (!(area > posegsa_minimum_area)) {
        /* Rules fire, but under no area: terms of no width, or heights near underflow. The limit
         * is that of equally narrow terms, each at the middle of its support. */
        area = 0;
        moment = 0;
        for (i = 0; i < POSEGSA_OUTPUTS; ++i) {
            const POSEGSA_REAL *term = posegsa_output_terms[i];
            const POSEGSA_REAL spike = heights[i] / tallest * (2 - heights[i]);
            area += spike;
            moment += spike * (POSEGSA_C(0.5) * (term[0] + term[2]));
        }
    }
    return POSEGSA_C($offset) + moment / area;
}
