"""The C code of an export, as templates; `$name` is filled in by `c`.

Every name begins with posegsa, so that the file may be compiled by itself or included in another.
"""

NAN_POLICY = """\
Never NaN. error or rate NaN (a measurement that is missing): last_gain, whatever the rule where no
rule fires. last_gain NaN: posegsa_initial_gain() in its place. Infinite error or rate: clipped.
With -ffast-math a compiler may take the checks for NaN away."""

DECLARATIONS = """\
#ifndef POSEGSA_REAL
#define POSEGSA_REAL double
#endif

/* Gain K [1/s] of the scaled error and its scaled rate; last_gain is the one before [1/s]. */
POSEGSA_REAL posegsa_gain(POSEGSA_REAL error, POSEGSA_REAL rate, POSEGSA_REAL last_gain);

/* What last_gain is at the first sample [1/s]: 1 + the middle of the output range. */
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
static const POSEGSA_REAL posegsa_least_area =
    POSEGSA_C(sizeof(POSEGSA_REAL) < sizeof(double) ? 1.0842021724855044e-19
                                                    : 1.4916681462400413e-154);
"""

SAMPLED_CONSTANTS = """\
/* Samples of the output, ends included, and the weight of the two at the ends. */
enum { POSEGSA_POINTS = $points };
static const POSEGSA_REAL posegsa_end_weight = POSEGSA_C($end_weight);
static const POSEGSA_REAL posegsa_low = POSEGSA_C($low);   /* [1/s] */
static const POSEGSA_REAL posegsa_high = POSEGSA_C($high); /* [1/s] */
"""

MEMBERSHIP = """\
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
"""

_EXACT = """\
/* Adds `sign` times area and first moment under both of the output terms i <= j, clipped at one
 * height: F(h) = D h - (u + v) h^2/2 and M(h) = 1/2 [(c_i^2 - a_j^2) h - (c_i v + a_j u) h^2 +
 * (v^2 - u^2) h^3/3] with u = b_j - a_j, v = c_i - b_i, D = c_i - a_j, up to where they cross. */
static void posegsa_add_overlap(int i, int j, POSEGSA_REAL height, POSEGSA_REAL sign,
                                POSEGSA_REAL *area, POSEGSA_REAL *moment)
{
    const POSEGSA_REAL a = posegsa_output_terms[j][0];
    const POSEGSA_REAL c = posegsa_output_terms[i][2];
    const POSEGSA_REAL u = posegsa_output_terms[j][1] - a;
    const POSEGSA_REAL v = c - posegsa_output_terms[i][1];
    const POSEGSA_REAL width = c - a;
    const POSEGSA_REAL slope = u + v;
    const POSEGSA_REAL half = POSEGSA_C(0.5);
    POSEGSA_REAL h = posegsa_min(height, 1);
    if (!(width > 0)) {
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
 * terms i < j overlap above the tallest one between them. */
static void posegsa_integrals(const POSEGSA_REAL heights[POSEGSA_OUTPUTS], POSEGSA_REAL *area,
                              POSEGSA_REAL *moment)
{
    int i, j;
    *area = 0;
    *moment = 0;
    for (i = 0; i < POSEGSA_OUTPUTS; ++i) {
        POSEGSA_REAL between = 0;
        posegsa_add_overlap(i, i, heights[i], 1, area, moment);
        for (j = i + 1; j < POSEGSA_OUTPUTS; ++j) {
            const POSEGSA_REAL both = posegsa_min(heights[i], heights[j]);
            posegsa_add_overlap(i, j, both, -1, area, moment);
            posegsa_add_overlap(i, j, posegsa_min(both, between), 1, area, moment);
            between = posegsa_max(between, heights[j]);
        }
    }
}
"""

_SAMPLED = """\
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
"""

CENTROIDS = {"exact": _EXACT, "sampled": _SAMPLED}

NO_RULE = {"hold": "last_gain", "midrange": "posegsa_initial_gain()"}

GAIN = """\
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
    if (!(area > posegsa_least_area)) {
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
    return 1 + moment / area;
}
"""
