/*
 * posegsa.h: a pose filter with a scheduled gain, as C99; also valid C++17.
 * Written by posegsa 0.16.0. Tuned with posegsa 0.16.0 in float32: de, 32 agents x 40 iterations,
 * seed 1.
 * The vectors and landmarks that it knows are those of the configuration's [scenario], NOT of your
 * sensors: `posegsa export RUN --recording FILE` takes those of a recording.
 *
 * WHAT IT DOES
 * The filter estimates attitude and position, and also the biases of both velocities and of the
 * vectors. It uses the measured angular and linear velocity, and 2 vectors and 1 landmark of known
 * direction or position. Law: gradient; 2 sub-steps per sample. The equations are in
 * posegsa/filters/observer.py.
 *
 * USE
 *     #include "posegsa.h"
 *     #include <stdio.h>
 *     static posegsa_measurement now; // all zeros: nothing is measured
 *     int main(void) {
 *         const posegsa_real turned[4] = {2, 1, 0, 0}, origin[3] = {0, 0, 0};
 *         posegsa_state filter;
 *         if (posegsa_init(&filter, turned, origin) != POSEGSA_OK) return 1; // 53 deg off
 *         for (int k = 0; k < 1000; ++k) { // 10 s at 100 Hz, the body at rest and upright
 *             for (int i = 0; i < 3 * POSEGSA_VECTORS; ++i)
 *                 now.vectors[i / 3][i % 3] = posegsa_vectors[i / 3][i % 3];
 *             for (int i = 0; i < POSEGSA_VECTORS; ++i) now.vector_weights[i] = 1; // not missing
 *             if (posegsa_step(&filter, &now, POSEGSA_C(0.01)) != POSEGSA_OK) return 1;
 *         }
 *         printf("%.3f\n", (double)filter.attitude[0]);
 *     }
 *
 * CONVENTIONS
 * Frames: I inertial, B body. A rotation takes body to inertial coordinates; quaternions are w, x,
 * y, z (Hamilton) of length 1. A state holds the estimate at the time of the next sample:
 * posegsa_step(state, measurement, dt) processes that sample and propagates the estimate by dt.
 *
 * WHAT IS MISSING AND WHAT IS WRONG
 * A weight of 0 marks a vector or a landmark as missing: its numbers are then ignored, and may be
 * NaN. So does a vector of length 0. A part of the error that is not measured keeps
 * its last value. Any other number that is NaN, or beyond the limits below, is refused with
 * POSEGSA_INVALID_INPUT: no sensor gives it. An estimate that would not be finite, or whose
 * quaternion would not have length 1, is refused with POSEGSA_NOT_FINITE. A refused sample leaves
 * the state as it was: let the next dt cover its time too. Pointers must be valid.
 *
 * PRECISION, MEMORY, THREADS
 * posegsa_real is double; compile with -DPOSEGSA_REAL=float for single precision. No heap, no
 * global state, no header except <math.h>: filters with different states are independent and may
 * run in any thread or interrupt. Do not use -ffast-math, which removes the checks for NaN.
 *
 * WHAT IT IS WORTH
 * Cost                          training  held out    95 % interval   worst
 *   tuned filter                  12.751     17.91  [13.441, 22.38]   39.01
 *   best constant gains 47.5/s    27.721    24.219   [22.138, 26.3]  34.203
 * Means over 4 training scenarios and over 16 held-out ones, which the search did not use; the
 * worst is over the held-out ones.
 *
 * SETTINGS OF THE RUN, which the numbers below come from
 *   kind = "observer". Which filter: "observer", "kalman", "imu", or "own", one that the user
 *       passes.
 *   schedule = "fuzzy". What sets the gain K: "fuzzy", the controller of k1..k22; "constant", one
 *       gain; "smooth", a gain K(e) = low + (high - low) e^2 / (e^2 + half^2).
 *   law = "gradient". Innovation and bias law: "gradient", for which the Lyapunov argument holds,
 *       or "printed" as in the paper, which can diverge.
 *   gamma = 9.486512184143066. Gain of the bias law [1/s^2]: one for both biases, or one for
 *       b_Omega and one for b_V.
 *   substeps = 2. Number of inner steps per sample, with the measurement held.
 *   gamma_law = "quadratic". How gamma depends on the gain K after its limit: constant, or
 *       proportional to K or K^2. `gamma` is its value at K = 10/s.
 *   bias_bound = "off". Maximum lengths of the estimated biases of angular and linear velocity
 *       [rad/s, m/s], such as from data sheets, or "off" for none. They keep the estimate from
 *       diverging if measurements stop before it has converged; an estimate far beyond its bound
 *       is reset to 0.
 *   length = 2.788655996322632. Unit of length [m], which weighs attitude against position in the
 *       gain. About the distance of the landmarks from the origin lets both converge equally fast.
 *   length_growth = "off". By how much the square of the unit of length grows with the square of
 *       the distance from the body to the farthest landmark, no unit; "off" means not at all.
 *   landmark_unit = "metre". What the weight of a landmark is per square of: a "metre", or the
 *       unit of "length". With the latter and `length_growth` the same gains suit landmarks at any
 *       distance.
 *   bias_wait = "off". The error signal, before it is smoothed and scaled, at which the gains of
 *       all bias laws are half; above it they vanish with the fourth power. While the pose is far
 *       off, they would take its error for a bias. "off" means that they do not depend on it.
 *   gain_limit = 1.5. Maximum step of the innovation, K L dt / substeps with L the curvature of
 *       its cost, no unit; steps above 2 are unstable. "off" means no limit.
 *   normalise_vectors = true. Whether all vectors, measured (less their estimated biases) and
 *       known, are normalised to length one.
 *   cross_vector = true. Whether v_1 x v_2, of the first two vectors as measured, is used as a
 *       further vector.
 *   cross_vector_weight = 0.5. Weight s^R of that vector, no unit.
 *   vector_bias = "estimated". Whether the constant biases of the vectors are estimated.
 *   vector_bias_gain = 0.6490911245346069. Gain gamma_c of their bias law [1/s].
 *   vector_bias_law = "linear". How gamma_c depends on the gain K after its limit;
 *       vector_bias_gain is its value at K = 10/s.
 *   vector_bias_leak = 0.0. Rate at which an estimate decays [1/s].
 *   vector_bias_bound = 0.5. Maximum length of an estimated bias, in the vector's unit.
 *   excitation = 0.3. Angular velocity [rad/s] above which vector_bias_gain is used in full. Below
 *       it the gain falls with the fourth power, because at rest a bias is indistinguishable from
 *       an attitude error.
 *   excitation_time = 1.0. Time constant of the low-pass filter of that angular velocity [s].
 *   signal = "measured". How e is computed: "measured", from the vectors and landmarks, as a
 *       vehicle can do it, or "pose", from the true errors of attitude and position (an oracle,
 *       for simulation only).
 *   position_weight = 0.08066730201244354. Weight of the position part [m] relative to the
 *       attitude part (0 to 1) in e [1/m].
 *   smoothing = 0.70799720287323. Time constant of the first-order low-pass filter of e [s]; 0
 *       means none.
 *   error_scale = 0.7832983732223511. Divisor of e before it is clipped to [0, 1], in the unit of
 *       e.
 *   rate = "per_sample". The controller's second input: `|e_k - e_(k-1)|`, or this divided by the
 *       time between the samples.
 *   rate_scale = 1.0. Factor on the rate (no unit, or [s]) before it is clipped to [0, 1].
 *   unknown = "off". Unknown share of the biases at the start, on the scale of the controller's
 *       input e. e is at least this share, so that the gain stays high until the biases are
 *       learnt. "off": e is the error alone.
 *   unknown_fall = 0.01. How fast the unknown share falls while vectors and landmarks are
 *       measured: its rate is this times the gain K [1/s] and the factor of `filter.bias_wait`.
 *   unknown_rise = 0.5. Lower limit of the unknown share, as a factor on the scaled error.
 */

#ifndef POSEGSA_H
#define POSEGSA_H

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "posegsa.h: -ffast-math or -ffinite-math-only would remove the checks for NaN"
#endif

#include <math.h>

#ifndef POSEGSA_REAL
#define POSEGSA_REAL double
#endif

typedef POSEGSA_REAL posegsa_real;

#define POSEGSA_C(number) ((posegsa_real)(number))

static inline posegsa_real posegsa_min(posegsa_real x, posegsa_real y)
{
    return x < y ? x : y;
}

static inline posegsa_real posegsa_max(posegsa_real x, posegsa_real y)
{
    return x > y ? x : y;
}

/* ---- Limits ---------------------------------------------------------------------------------- */

/* The largest accepted magnitude of each component. No sensor gives larger numbers. To change a
 * limit, define it before this line or with -D. */
#ifndef POSEGSA_MIN_TIME_STEP
#define POSEGSA_MIN_TIME_STEP 1e-09 /* [s] */
#endif
#ifndef POSEGSA_MAX_TIME_STEP
#define POSEGSA_MAX_TIME_STEP 60 /* [s]; after a longer pause start a new filter */
#endif
#ifndef POSEGSA_MAX_ANGULAR_VELOCITY
#define POSEGSA_MAX_ANGULAR_VELOCITY 1000 /* [rad/s] */
#endif
#ifndef POSEGSA_MAX_VECTOR
#define POSEGSA_MAX_VECTOR 1e+06 /* in the unit of the sensor */
#endif
#ifndef POSEGSA_MAX_VELOCITY
#define POSEGSA_MAX_VELOCITY 10000 /* [m/s] */
#endif
#ifndef POSEGSA_MAX_LANDMARK
#define POSEGSA_MAX_LANDMARK 1e+06 /* relative to the body [m] */
#endif
#ifndef POSEGSA_MAX_POSITION
#define POSEGSA_MAX_POSITION 1e+09 /* initial position [m] */
#endif
#ifndef POSEGSA_MAX_WEIGHT
#define POSEGSA_MAX_WEIGHT 1e+06 /* factors on s_i */
#endif

/* ---- Types --------------------------------------------------------------------------------- */

enum {
    POSEGSA_VECTORS = 2,
    POSEGSA_LANDMARKS = 1,
    POSEGSA_SUBSTEPS = 2
};

/* What posegsa_init and posegsa_step return. */
enum {
    POSEGSA_OK = 0,
    POSEGSA_INVALID_INPUT = 1, /* NaN, or outside the limits */
    POSEGSA_NOT_FINITE = 2     /* the estimate would be invalid: NaN, infinite, or |q| not 1 */
};

/* The measurements of one sample. In a record of all zeros nothing is measured. */
typedef struct posegsa_measurement {
    posegsa_real angular_velocity[3]; /* [rad/s], body frame */
    posegsa_real velocity[3];         /* [m/s], body frame */
    posegsa_real vectors[POSEGSA_VECTORS][3];     /* v_i, body frame, unit of their sensor */
    posegsa_real vector_weights[POSEGSA_VECTORS]; /* 1 measured, 0 missing; factors on s_i */
    posegsa_real landmarks[POSEGSA_LANDMARKS][3];     /* y_i [m], body frame */
    posegsa_real landmark_weights[POSEGSA_LANDMARKS]; /* 1 measured, 0 missing; factors on s_i */
} posegsa_measurement;

/* The state of a filter, set by posegsa_init. The estimates may be read at any time, and set. */
typedef struct posegsa_state {
    posegsa_real attitude[4];     /* quaternion w, x, y, z, body to inertial */
    posegsa_real position[3];     /* [m], inertial frame */
    posegsa_real bias_angular[3]; /* of the angular velocity [rad/s], body frame */
    posegsa_real bias_linear[3];  /* of the velocity [m/s], body frame */
    posegsa_real vector_bias[POSEGSA_VECTORS][3]; /* c_i, body frame, the vectors' units */
    posegsa_real turning[3];      /* low-passed angular velocity [rad/s], body frame */
    /* The memory of the gain schedule, and its gain at the last sample. */
    posegsa_real attitude_error;  /* the last measured one, 0 to 1 */
    posegsa_real position_error;  /* the last measured one [m] */
    posegsa_real error;           /* the schedule's input, smoothed, before it is scaled */
    posegsa_real since_last;      /* dt of the last sample [s]; infinite before the first */
    posegsa_real gain;            /* K from the schedule [1/s] */
    posegsa_real gain_used;       /* K after the gain limit [1/s] */
} posegsa_state;

/* ---- Functions ----------------------------------------------------------------------------- */

/* Starts a filter. attitude: quaternion of any length but 0; position [m], inertial frame. Biases
 * start at 0. Returns POSEGSA_OK, or POSEGSA_INVALID_INPUT and does not change the state. */
static inline int posegsa_init(posegsa_state *state, const posegsa_real attitude[4],
                               const posegsa_real position[3]);

/* Processes one sample and propagates the estimate to the next one, dt [s] later. Returns
 * POSEGSA_OK, or an error code and does not change the state. */
static inline int posegsa_step(posegsa_state *state, const posegsa_measurement *measurement,
                               posegsa_real dt);

/* The attitude as a matrix by rows, body to inertial. */
static inline void posegsa_rotation(const posegsa_state *state, posegsa_real rotation[3][3]);

/* ---- Numbers, tuned and chosen --------------------------------------------------------------- */

/* gain of the bias law of the angular velocity at K = 10/s [1/s^2] */
static const posegsa_real posegsa_gamma_angular = POSEGSA_C(9.486512184143066);
/* gain of the bias law of the velocity at K = 10/s [1/s^2] */
static const posegsa_real posegsa_gamma_linear = POSEGSA_C(9.486512184143066);
/* largest step of the innovation, K h L */
static const posegsa_real posegsa_gain_limit = POSEGSA_C(1.5);
/* s_i of v_1 x v_2 */
static const posegsa_real posegsa_cross_vector_weight = POSEGSA_C(0.5);
/* gamma_c, gain of the vectors' bias law at K = 10/s [1/s] */
static const posegsa_real posegsa_vector_bias_gain = POSEGSA_C(0.6490911245346069);
/* rate at which a vector's bias is forgotten [1/s] */
static const posegsa_real posegsa_vector_bias_leak = 0;
/* 1 / bound^2; bound: maximum length of a vector's bias */
static const posegsa_real posegsa_vector_bias_per_bound = 4;
/* 1 / w_0^4, w_0 [rad/s]: above it gamma_c is full */
static const posegsa_real posegsa_vector_bias_per_turning = POSEGSA_C(123.4567901234568);
/* time constant of that rate's low-pass filter [s] */
static const posegsa_real posegsa_vector_bias_excitation_time = 1;
/* l [m], unit of length in which attitude and position share the gain */
static const posegsa_real posegsa_length = POSEGSA_C(2.788655996322632);
/* weight of the position part of the error [1/m] */
static const posegsa_real posegsa_position_weight = POSEGSA_C(0.08066730201244354);
/* time constant of the error's low-pass filter [s] */
static const posegsa_real posegsa_smoothing = POSEGSA_C(0.70799720287323);
/* the error at which the scaled error is 1 */
static const posegsa_real posegsa_error_scale = POSEGSA_C(0.7832983732223511);
/* factor on the change of the error */
static const posegsa_real posegsa_rate_scale = 1;
/* s_i of each vector */
static const posegsa_real posegsa_weight_of_vector[2] = {1, 1};
/* s_i of each landmark [1/m^2] */
static const posegsa_real posegsa_weight_of_landmark[1] = {POSEGSA_C(0.3643244504928589)};
/* v_i, inertial frame, in the unit of their sensor */
static const posegsa_real posegsa_vectors[2][3] = {
    {POSEGSA_C(0.5773502691896258), POSEGSA_C(-0.5773502691896258), POSEGSA_C(0.5773502691896258)},
    {0, 0, 1}
};
/* v_i as the innovation uses them, then v_1 x v_2 */
static const posegsa_real posegsa_directions[3][3] = {
    {POSEGSA_C(0.5773502691896258), POSEGSA_C(-0.5773502691896258), POSEGSA_C(0.5773502691896258)},
    {0, 0, 1},
    {POSEGSA_C(-0.7071067811865476), POSEGSA_C(-0.7071067811865476), 0}
};
/* p_i [m], inertial frame */
static const posegsa_real posegsa_landmarks[1][3] = {
    {POSEGSA_C(0.5), POSEGSA_C(1.4142135623730951), 1}
};

/* ---- The gain: a fuzzy controller ------------------------------------------------------------ */

enum { POSEGSA_INPUTS = 5, POSEGSA_OUTPUTS = 5 };

/* Input terms, shared by error and rate: left foot, peak, right foot [no unit]. */
static const posegsa_real posegsa_input_terms[POSEGSA_INPUTS][3] = {
    {POSEGSA_C(0.0), POSEGSA_C(0.0), POSEGSA_C(0.12671928107738495)}, /* VS */
    {POSEGSA_C(0.0347747877240181), POSEGSA_C(0.13542243838310242), POSEGSA_C(0.15540646016597748)}, /* S */
    {POSEGSA_C(0.14540645480155945), POSEGSA_C(0.15124277770519257), POSEGSA_C(0.32127609848976135)}, /* M */
    {POSEGSA_C(0.16126351058483124), POSEGSA_C(0.5621954798698425), POSEGSA_C(0.7277784943580627)}, /* L */
    {POSEGSA_C(0.6152166128158569), POSEGSA_C(1.0), POSEGSA_C(1.0)}, /* VL */
};

/* Output terms: left foot, peak, right foot [1/s]. */
static const posegsa_real posegsa_output_terms[POSEGSA_OUTPUTS][3] = {
    {POSEGSA_C(0.0), POSEGSA_C(0.0), POSEGSA_C(4.18243408203125)}, /* VS */
    {POSEGSA_C(5.713845252990723), POSEGSA_C(6.868880271911621), POSEGSA_C(22.203203201293945)}, /* S */
    {POSEGSA_C(11.177486419677734), POSEGSA_C(24.682390213012695), POSEGSA_C(32.3657341003418)}, /* M */
    {POSEGSA_C(41.61765670776367), POSEGSA_C(52.61375045776367), POSEGSA_C(55.07769012451172)}, /* L */
    {POSEGSA_C(46.51777648925781), POSEGSA_C(100.0), POSEGSA_C(100.0)}, /* VL */
};

/* Output term of each rule (0 is VS): rows are the rate, columns the error, both from VS to VL. */
static const unsigned char posegsa_rules[POSEGSA_INPUTS][POSEGSA_INPUTS] = {
    {0, 1, 2, 4, 4}, /* rate VS */
    {1, 2, 2, 4, 4}, /* rate S */
    {2, 2, 3, 4, 4}, /* rate M */
    {2, 3, 4, 4, 4}, /* rate L */
    {3, 3, 4, 4, 4}, /* rate VL */
};

static const posegsa_real posegsa_middle_gain = POSEGSA_C(51.0); /* [1/s] */

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

static inline posegsa_real posegsa_initial_gain(void)
{
    return posegsa_middle_gain;
}

static inline posegsa_real posegsa_gain(posegsa_real error, posegsa_real rate,
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
        return last_gain;
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
    return POSEGSA_C(1.0) + moment / area;
}

/* ---- The step's parts, generated from the functions of posegsa.filters and model ------------- */

static inline posegsa_real posegsa_fabs(posegsa_real x)
{
    /* The compiler evaluates the comparison. */
    return sizeof(posegsa_real) < sizeof(double) ? (posegsa_real)fabsf((float)x)
                                                 : (posegsa_real)fabs((double)x);
}

static inline posegsa_real posegsa_rint(posegsa_real x)
{
    /* The compiler evaluates the comparison. */
    return sizeof(posegsa_real) < sizeof(double) ? (posegsa_real)rintf((float)x)
                                                 : (posegsa_real)rint((double)x);
}

static inline posegsa_real posegsa_sqrt(posegsa_real x)
{
    /* The compiler evaluates the comparison. */
    return sizeof(posegsa_real) < sizeof(double) ? (posegsa_real)sqrtf((float)x)
                                                 : (posegsa_real)sqrt((double)x);
}

/* Intermediate results of one step. */
typedef struct posegsa_work {
    posegsa_real profile[3][3]; /* B = sum_i s_i u_i v_i^T */
    posegsa_real power;         /* sum_i s_i (|u_i|^2 + |v_i|^2) */
    posegsa_real curvature;     /* the part of L from the vectors */
    posegsa_real scale;         /* 3 / (8 sum_i s_i), 0 without vectors */
    posegsa_real freed[POSEGSA_VECTORS][3]; /* d_i = v_i - c_i */
    posegsa_real landmark_weights[POSEGSA_LANDMARKS]; /* s_i, 0 where one is missing */
    posegsa_real reach;          /* square of the distance to the farthest landmark [m^2] */
    posegsa_real error;          /* scaled, 0 to 1 */
    posegsa_real rate;           /* scaled, 0 to 1 */
    posegsa_real gain;           /* K [1/s] */
    posegsa_real learning;       /* factor on the gain of the vectors' bias law */
    posegsa_real used;           /* K after the gain limit [1/s] */
    posegsa_real omega[3];       /* a sub-step's rotation [rad], body frame */
    posegsa_real v[3];           /* a sub-step's displacement [m], body frame */
    posegsa_real angle_squared;  /* |omega|^2 [rad^2] */
    posegsa_real exponential[4]; /* coefficients of the exponential of SE(3) */
} posegsa_work;

/* The vectors without their biases, Wahba's sums, and the weights. */
static inline void posegsa_see(const posegsa_state *now, const posegsa_measurement *seen,
                               posegsa_work *w)
{
    const posegsa_real corrected_1 = posegsa_weight_of_vector[0] * seen->vector_weights[0];
    const posegsa_real corrected_2 = corrected_1 * posegsa_directions[0][0];
    const posegsa_real subtract_1 = seen->vectors[0][0] - now->vector_bias[0][0];
    const posegsa_real subtract_2 = seen->vectors[0][1] - now->vector_bias[0][1];
    const posegsa_real subtract_3 = seen->vectors[0][2] - now->vector_bias[0][2];
    const posegsa_real dot_1 = subtract_1 * subtract_1 + subtract_2 * subtract_2 + subtract_3 *
        subtract_3;
    const int unit_1 = dot_1 > 0;
    const posegsa_real choose_1 = unit_1 ? 1 / posegsa_sqrt(unit_1 ? dot_1 : 1) : 0;
    const posegsa_real scale_1 = choose_1 * subtract_1;
    const posegsa_real corrected_3 = posegsa_weight_of_vector[1] * seen->vector_weights[1];
    const posegsa_real corrected_4 = corrected_3 * posegsa_directions[1][0];
    const posegsa_real subtract_4 = seen->vectors[1][0] - now->vector_bias[1][0];
    const posegsa_real subtract_5 = seen->vectors[1][1] - now->vector_bias[1][1];
    const posegsa_real subtract_6 = seen->vectors[1][2] - now->vector_bias[1][2];
    const posegsa_real dot_2 = subtract_4 * subtract_4 + subtract_5 * subtract_5 + subtract_6 *
        subtract_6;
    const int unit_2 = dot_2 > 0;
    const posegsa_real choose_2 = unit_2 ? 1 / posegsa_sqrt(unit_2 ? dot_2 : 1) : 0;
    const posegsa_real scale_2 = choose_2 * subtract_4;
    const posegsa_real corrected_5 = posegsa_cross_vector_weight *
        posegsa_min(seen->vector_weights[0], seen->vector_weights[1]);
    const posegsa_real corrected_6 = corrected_5 * posegsa_directions[2][0];
    const posegsa_real cross_1 = subtract_2 * subtract_6 - subtract_3 * subtract_5;
    const posegsa_real cross_2 = subtract_3 * subtract_4 - subtract_1 * subtract_6;
    const posegsa_real cross_3 = subtract_1 * subtract_5 - subtract_2 * subtract_4;
    const posegsa_real dot_3 = cross_1 * cross_1 + cross_2 * cross_2 + cross_3 * cross_3;
    const int unit_3 = dot_3 > 0;
    const posegsa_real choose_3 = unit_3 ? 1 / posegsa_sqrt(unit_3 ? dot_3 : 1) : 0;
    const posegsa_real scale_3 = choose_3 * cross_1;
    const posegsa_real corrected_7 = corrected_1 * posegsa_directions[0][1];
    const posegsa_real corrected_8 = corrected_3 * posegsa_directions[1][1];
    const posegsa_real corrected_9 = corrected_5 * posegsa_directions[2][1];
    const posegsa_real corrected_10 = corrected_1 * posegsa_directions[0][2];
    const posegsa_real corrected_11 = corrected_3 * posegsa_directions[1][2];
    const posegsa_real corrected_12 = corrected_5 * posegsa_directions[2][2];
    const posegsa_real scale_4 = choose_1 * subtract_2;
    const posegsa_real scale_5 = choose_2 * subtract_5;
    const posegsa_real scale_6 = choose_3 * cross_2;
    const posegsa_real scale_7 = choose_1 * subtract_3;
    const posegsa_real scale_8 = choose_2 * subtract_6;
    const posegsa_real scale_9 = choose_3 * cross_3;
    const posegsa_real total_1 = corrected_1 + corrected_3 + corrected_5;
    const int corrected_13 = total_1 > 0;
    w->profile[0][0] = corrected_2 * scale_1 + corrected_4 * scale_2 + corrected_6 * scale_3;
    w->profile[0][1] = corrected_7 * scale_1 + corrected_8 * scale_2 + corrected_9 * scale_3;
    w->profile[0][2] = corrected_10 * scale_1 + corrected_11 * scale_2 + corrected_12 * scale_3;
    w->profile[1][0] = corrected_2 * scale_4 + corrected_4 * scale_5 + corrected_6 * scale_6;
    w->profile[1][1] = corrected_7 * scale_4 + corrected_8 * scale_5 + corrected_9 * scale_6;
    w->profile[1][2] = corrected_10 * scale_4 + corrected_11 * scale_5 + corrected_12 * scale_6;
    w->profile[2][0] = corrected_2 * scale_7 + corrected_4 * scale_8 + corrected_6 * scale_9;
    w->profile[2][1] = corrected_7 * scale_7 + corrected_8 * scale_8 + corrected_9 * scale_9;
    w->profile[2][2] = corrected_10 * scale_7 + corrected_11 * scale_8 + corrected_12 * scale_9;
    w->power = 2 * total_1;
    w->curvature = POSEGSA_C(0.5) * total_1;
    w->scale = POSEGSA_C(0.375) * (corrected_13 ? 1 / (corrected_13 ? total_1 : 1) : 0);
    w->freed[0][0] = subtract_1;
    w->freed[0][1] = subtract_2;
    w->freed[0][2] = subtract_3;
    w->freed[1][0] = subtract_4;
    w->freed[1][1] = subtract_5;
    w->freed[1][2] = subtract_6;
    w->landmark_weights[0] = posegsa_weight_of_landmark[0] * seen->landmark_weights[0];
}

/* The error signal: the low-passed misfit of the estimate and the sample. */
static inline void posegsa_signal(const posegsa_state *now, const posegsa_measurement *seen,
                                  posegsa_real dt, posegsa_work *w, posegsa_state *next)
{
    const posegsa_real rows_1 = now->attitude[2] * now->attitude[2];
    const posegsa_real rows_2 = now->attitude[3] * now->attitude[3];
    const posegsa_real rows_3 = 1 - 2 * (rows_1 + rows_2);
    const posegsa_real rows_4 = now->attitude[1] * now->attitude[2];
    const posegsa_real rows_5 = now->attitude[0] * now->attitude[3];
    const posegsa_real rows_6 = 2 * (rows_4 - rows_5);
    const posegsa_real rows_7 = now->attitude[1] * now->attitude[3];
    const posegsa_real rows_8 = now->attitude[0] * now->attitude[2];
    const posegsa_real rows_9 = 2 * (rows_7 + rows_8);
    const posegsa_real dot_1 = rows_3 * w->profile[0][0] + rows_6 * w->profile[1][0] + rows_9 *
        w->profile[2][0];
    const posegsa_real rows_10 = 2 * (rows_4 + rows_5);
    const posegsa_real rows_11 = now->attitude[1] * now->attitude[1];
    const posegsa_real rows_12 = 1 - 2 * (rows_11 + rows_2);
    const posegsa_real rows_13 = now->attitude[2] * now->attitude[3];
    const posegsa_real rows_14 = now->attitude[0] * now->attitude[1];
    const posegsa_real rows_15 = 2 * (rows_13 - rows_14);
    const posegsa_real dot_2 = rows_10 * w->profile[0][1] + rows_12 * w->profile[1][1] + rows_15
        * w->profile[2][1];
    const posegsa_real rows_16 = 2 * (rows_7 - rows_8);
    const posegsa_real rows_17 = 2 * (rows_13 + rows_14);
    const posegsa_real rows_18 = 1 - 2 * (rows_11 + rows_1);
    const posegsa_real dot_3 = rows_16 * w->profile[0][2] + rows_17 * w->profile[1][2] + rows_18
        * w->profile[2][2];
    const posegsa_real measured_errors_1 = w->scale * posegsa_max(w->power - 2 * (dot_1 + dot_2
        + dot_3), 0);
    const posegsa_real choose_1 = w->scale > 0 ? measured_errors_1 : now->attitude_error;
    const int measured_errors_2 = w->landmark_weights[0] > 0;
    const posegsa_real dot_4 = rows_3 * seen->landmarks[0][0] + rows_6 * seen->landmarks[0][1] +
        rows_9 * seen->landmarks[0][2];
    const posegsa_real subtract_1 = dot_4 + now->position[0] - posegsa_landmarks[0][0];
    const posegsa_real dot_5 = rows_10 * seen->landmarks[0][0] + rows_12 *
        seen->landmarks[0][1];
    const posegsa_real subtract_2 = dot_5 + rows_15 * seen->landmarks[0][2] + now->position[1] -
        posegsa_landmarks[0][1];
    const posegsa_real dot_6 = rows_16 * seen->landmarks[0][0] + rows_17 *
        seen->landmarks[0][1];
    const posegsa_real subtract_3 = dot_6 + rows_18 * seen->landmarks[0][2] + now->position[2] -
        posegsa_landmarks[0][2];
    const posegsa_real dot_7 = subtract_1 * subtract_1 + subtract_2 * subtract_2 + subtract_3 *
        subtract_3;
    const int safe_sqrt_1 = dot_7 > 0;
    const posegsa_real measured_errors_3 = w->landmark_weights[0] * (safe_sqrt_1 ?
        posegsa_sqrt(safe_sqrt_1 ? dot_7 : 1) : 0);
    const posegsa_real measured_errors_4 = measured_errors_3 / (measured_errors_2 ?
        w->landmark_weights[0] : 1);
    const posegsa_real choose_2 = measured_errors_2 ? measured_errors_4 : now->position_error;
    const posegsa_real scheduled_gain_1 = choose_1 + posegsa_position_weight * choose_2;
    const posegsa_real choose_3 = posegsa_fabs(now->since_last) == POSEGSA_C(INFINITY) ?
        scheduled_gain_1 : now->error;
    const posegsa_real scheduled_gain_2 = posegsa_smoothing / (posegsa_smoothing +
        now->since_last) * (choose_3 - scheduled_gain_1);
    const posegsa_real scheduled_gain_3 = scheduled_gain_1 + scheduled_gain_2;
    w->error = posegsa_min(posegsa_max(scheduled_gain_3 * (1 / posegsa_error_scale), 0), 1);
    w->rate = posegsa_min(posegsa_fabs(scheduled_gain_3 - choose_3) * posegsa_rate_scale, 1);
    next->attitude_error = choose_1;
    next->position_error = choose_2;
    next->error = scheduled_gain_3;
    next->since_last = dt;
}

/* The innovation U, its gain after the limit, and the bias laws. */
static inline void posegsa_correct(const posegsa_measurement *seen, posegsa_real dt,
                                   posegsa_real h, posegsa_real moving, posegsa_work *w,
                                   posegsa_state *next)
{
    const posegsa_real unit_1 = posegsa_length * posegsa_length;
    const posegsa_real rows_1 = next->attitude[2] * next->attitude[2];
    const posegsa_real rows_2 = next->attitude[3] * next->attitude[3];
    const posegsa_real rows_3 = 1 - 2 * (rows_1 + rows_2);
    const posegsa_real rows_4 = next->attitude[1] * next->attitude[2];
    const posegsa_real rows_5 = next->attitude[0] * next->attitude[3];
    const posegsa_real rows_6 = 2 * (rows_4 - rows_5);
    const posegsa_real rows_7 = next->attitude[1] * next->attitude[3];
    const posegsa_real rows_8 = next->attitude[0] * next->attitude[2];
    const posegsa_real rows_9 = 2 * (rows_7 + rows_8);
    const posegsa_real dot_1 = rows_3 * seen->landmarks[0][0] + rows_6 * seen->landmarks[0][1] +
        rows_9 * seen->landmarks[0][2];
    const posegsa_real add_1 = dot_1 + next->position[0];
    const posegsa_real rows_10 = 2 * (rows_4 + rows_5);
    const posegsa_real rows_11 = next->attitude[1] * next->attitude[1];
    const posegsa_real rows_12 = 1 - 2 * (rows_11 + rows_2);
    const posegsa_real dot_2 = rows_10 * seen->landmarks[0][0] + rows_12 *
        seen->landmarks[0][1];
    const posegsa_real rows_13 = next->attitude[2] * next->attitude[3];
    const posegsa_real rows_14 = next->attitude[0] * next->attitude[1];
    const posegsa_real rows_15 = 2 * (rows_13 - rows_14);
    const posegsa_real add_2 = dot_2 + rows_15 * seen->landmarks[0][2] + next->position[1];
    const posegsa_real rows_16 = 2 * (rows_7 - rows_8);
    const posegsa_real rows_17 = 2 * (rows_13 + rows_14);
    const posegsa_real dot_3 = rows_16 * seen->landmarks[0][0] + rows_17 *
        seen->landmarks[0][1];
    const posegsa_real rows_18 = 1 - 2 * (rows_11 + rows_1);
    const posegsa_real add_3 = dot_3 + rows_18 * seen->landmarks[0][2] + next->position[2];
    const posegsa_real dot_4 = add_1 * add_1 + add_2 * add_2 + add_3 * add_3;
    const posegsa_real dot_5 = posegsa_landmarks[0][0] * posegsa_landmarks[0][0] +
        posegsa_landmarks[0][1] * posegsa_landmarks[0][1];
    const posegsa_real dot_6 = dot_5 + posegsa_landmarks[0][2] * posegsa_landmarks[0][2];
    const posegsa_real innovation_1 = dot_4 * dot_6;
    const int safe_sqrt_1 = innovation_1 > 0;
    const posegsa_real innovation_2 = (safe_sqrt_1 ? posegsa_sqrt(safe_sqrt_1 ? innovation_1 :
        1) : 0) + posegsa_sqrt((unit_1 + dot_4) * (unit_1 + dot_6));
    const posegsa_real innovation_3 = POSEGSA_C(0.25) * w->landmark_weights[0] * (unit_1 +
        innovation_2);
    const posegsa_real limited_correction_1 = h * (w->curvature + innovation_3);
    const int limited_correction_2 = limited_correction_1 > 0;
    const posegsa_real limited_correction_3 = (limited_correction_2 ? posegsa_gain_limit : 1) /
        (limited_correction_2 ? limited_correction_1 : 1);
    const posegsa_real choose_1 = limited_correction_2 ? posegsa_min(limited_correction_3,
        w->gain) : w->gain;
    const posegsa_real displacement_1 = choose_1 * h;
    const posegsa_real dot_7 = rows_10 * w->profile[0][2] + rows_12 * w->profile[1][2] + rows_15
        * w->profile[2][2];
    const posegsa_real dot_8 = rows_16 * w->profile[0][1] + rows_17 * w->profile[1][1] + rows_18
        * w->profile[2][1];
    const posegsa_real cross_1 = add_2 * posegsa_landmarks[0][2] - add_3 *
        posegsa_landmarks[0][1];
    const posegsa_real scale_1 = POSEGSA_C(0.5) * (dot_7 - dot_8 + w->landmark_weights[0] *
        cross_1);
    const posegsa_real dot_9 = rows_16 * w->profile[0][0] + rows_17 * w->profile[1][0] + rows_18
        * w->profile[2][0];
    const posegsa_real dot_10 = rows_3 * w->profile[0][2] + rows_6 * w->profile[1][2] + rows_9 *
        w->profile[2][2];
    const posegsa_real cross_2 = add_3 * posegsa_landmarks[0][0] - add_1 *
        posegsa_landmarks[0][2];
    const posegsa_real scale_2 = POSEGSA_C(0.5) * (dot_9 - dot_10 + w->landmark_weights[0] *
        cross_2);
    const posegsa_real dot_11 = rows_3 * w->profile[0][1] + rows_6 * w->profile[1][1] + rows_9 *
        w->profile[2][1];
    const posegsa_real dot_12 = rows_10 * w->profile[0][0] + rows_12 * w->profile[1][0] +
        rows_15 * w->profile[2][0];
    const posegsa_real cross_3 = add_1 * posegsa_landmarks[0][1] - add_2 *
        posegsa_landmarks[0][0];
    const posegsa_real scale_3 = POSEGSA_C(0.5) * (dot_11 - dot_12 + w->landmark_weights[0] *
        cross_3);
    const posegsa_real add_4 = scale_1 * rows_3 + scale_2 * rows_10 + scale_3 * rows_16;
    const posegsa_real add_5 = displacement_1 * add_4 + moving * (seen->angular_velocity[0] -
        next->bias_angular[0]);
    const posegsa_real add_6 = scale_1 * rows_6 + scale_2 * rows_12 + scale_3 * rows_17;
    const posegsa_real add_7 = displacement_1 * add_6 + moving * (seen->angular_velocity[1] -
        next->bias_angular[1]);
    const posegsa_real add_8 = scale_1 * rows_9 + scale_2 * rows_15 + scale_3 * rows_18;
    const posegsa_real add_9 = displacement_1 * add_8 + moving * (seen->angular_velocity[2] -
        next->bias_angular[2]);
    const posegsa_real scale_4 = POSEGSA_C(0.5) * (w->landmark_weights[0] *
        (posegsa_landmarks[0][0] - add_1));
    const posegsa_real scale_5 = POSEGSA_C(0.5) * (w->landmark_weights[0] *
        (posegsa_landmarks[0][1] - add_2));
    const posegsa_real scale_6 = POSEGSA_C(0.5) * (w->landmark_weights[0] *
        (posegsa_landmarks[0][2] - add_3));
    const posegsa_real add_10 = scale_4 * rows_3 + scale_5 * rows_10 + scale_6 * rows_16;
    const posegsa_real scale_7 = unit_1 * add_10;
    const posegsa_real add_11 = next->position[0] * rows_6 + next->position[1] * rows_12 +
        next->position[2] * rows_17;
    const posegsa_real add_12 = next->position[0] * rows_9 + next->position[1] * rows_15 +
        next->position[2] * rows_18;
    const posegsa_real add_13 = displacement_1 * (scale_7 - (add_11 * add_8 - add_12 * add_6)) +
        moving * (seen->velocity[0] - next->bias_linear[0]);
    const posegsa_real add_14 = scale_4 * rows_6 + scale_5 * rows_12 + scale_6 * rows_17;
    const posegsa_real scale_8 = unit_1 * add_14;
    const posegsa_real add_15 = next->position[0] * rows_3 + next->position[1] * rows_10 +
        next->position[2] * rows_16;
    const posegsa_real add_16 = displacement_1 * (scale_8 - (add_12 * add_4 - add_15 * add_8)) +
        moving * (seen->velocity[1] - next->bias_linear[1]);
    const posegsa_real add_17 = scale_4 * rows_9 + scale_5 * rows_15 + scale_6 * rows_18;
    const posegsa_real scale_9 = unit_1 * add_17;
    const posegsa_real add_18 = displacement_1 * (scale_9 - (add_15 * add_6 - add_11 * add_4)) +
        moving * (seen->velocity[2] - next->bias_linear[2]);
    const posegsa_real dot_13 = add_5 * add_5 + add_7 * add_7 + add_9 * add_9;
    const posegsa_real following_1 = choose_1 * POSEGSA_C(0.1);
    const posegsa_real following_2 = following_1 * following_1;
    const posegsa_real bias_gains_1 = POSEGSA_C(0.5) / dt;
    const posegsa_real choose_2 = posegsa_min(posegsa_gamma_angular * following_2, choose_1 *
        (bias_gains_1 / (1 + w->reach / unit_1)));
    const posegsa_real learnt_biases_1 = -choose_2;
    const posegsa_real scale_10 = h * (learnt_biases_1 * (add_4 - (add_11 * add_17 - add_12 *
        add_14)));
    const posegsa_real add_19 = next->bias_angular[0] + scale_10;
    const posegsa_real scale_11 = h * (learnt_biases_1 * (add_6 - (add_12 * add_10 - add_15 *
        add_17)));
    const posegsa_real add_20 = next->bias_angular[1] + scale_11;
    const posegsa_real scale_12 = h * (learnt_biases_1 * (add_8 - (add_15 * add_14 - add_11 *
        add_10)));
    const posegsa_real add_21 = next->bias_angular[2] + scale_12;
    const posegsa_real choose_3 = posegsa_min(posegsa_gamma_linear * following_2, choose_1 *
        bias_gains_1);
    const posegsa_real learnt_biases_2 = -choose_3;
    const posegsa_real add_22 = next->bias_linear[0] + h * (learnt_biases_2 * scale_7);
    const posegsa_real add_23 = next->bias_linear[1] + h * (learnt_biases_2 * scale_8);
    const posegsa_real add_24 = next->bias_linear[2] + h * (learnt_biases_2 * scale_9);
    w->used = choose_1;
    w->omega[0] = add_5;
    w->omega[1] = add_7;
    w->omega[2] = add_9;
    w->v[0] = add_13;
    w->v[1] = add_16;
    w->v[2] = add_18;
    w->angle_squared = dot_13;
    next->bias_angular[0] = add_19;
    next->bias_angular[1] = add_20;
    next->bias_angular[2] = add_21;
    next->bias_linear[0] = add_22;
    next->bias_linear[1] = add_23;
    next->bias_linear[2] = add_24;
}

/* Coefficients of the exponential of SE(3); the type sets the number of terms. */
static inline void posegsa_exponential(posegsa_work *w)
{
    if (sizeof(posegsa_real) < sizeof(double)) {
        const int exp_coefficients_1 = w->angle_squared > POSEGSA_C(9.869604);
        const posegsa_real exp_coefficients_2 = posegsa_sqrt(posegsa_max(w->angle_squared,
            POSEGSA_C(9.869604)));
        const posegsa_real round_1 = posegsa_rint(exp_coefficients_2 * POSEGSA_C(0.15915494));
        const posegsa_real exp_coefficients_3 = posegsa_fabs(round_1 - 2 *
            posegsa_rint(POSEGSA_C(0.5) * round_1));
        const posegsa_real exp_coefficients_4 = 1 - 2 * exp_coefficients_3;
        const posegsa_real exp_coefficients_5 = exp_coefficients_2 - round_1 *
            POSEGSA_C(6.28125) - round_1 * POSEGSA_C(0.0019353072);
        const posegsa_real choose_1 = exp_coefficients_1 ? exp_coefficients_5 *
            exp_coefficients_5 : w->angle_squared;
        const posegsa_real exp_coefficients_6 = POSEGSA_C(0.25) * choose_1;
        const posegsa_real series_1 = POSEGSA_C(2.755732e-07) - exp_coefficients_6 *
            POSEGSA_C(2.0876756e-09);
        const posegsa_real series_2 = exp_coefficients_6 * (POSEGSA_C(2.4801588e-05) -
            exp_coefficients_6 * series_1);
        const posegsa_real series_3 = POSEGSA_C(0.041666668) - exp_coefficients_6 *
            (POSEGSA_C(0.0013888889) - series_2);
        const posegsa_real series_4 = exp_coefficients_6 * (POSEGSA_C(0.5) - exp_coefficients_6
            * series_3);
        const posegsa_real exp_coefficients_7 = (exp_coefficients_1 ? exp_coefficients_4 : 1) *
            (1 - series_4);
        const posegsa_real series_5 = POSEGSA_C(2.5052108e-08) - exp_coefficients_6 *
            POSEGSA_C(1.6059044e-10);
        const posegsa_real series_6 = exp_coefficients_6 * (POSEGSA_C(2.7557319e-06) -
            exp_coefficients_6 * series_5);
        const posegsa_real series_7 = POSEGSA_C(0.008333334) - exp_coefficients_6 *
            (POSEGSA_C(0.0001984127) - series_6);
        const posegsa_real series_8 = exp_coefficients_6 * (POSEGSA_C(0.16666667) -
            exp_coefficients_6 * series_7);
        const int exp_coefficients_8 = w->angle_squared < 1;
        const posegsa_real exp_coefficients_9 = 1 / (exp_coefficients_8 ? 1 : w->angle_squared);
        const posegsa_real exp_coefficients_10 = POSEGSA_C(0.5) * exp_coefficients_4 *
            exp_coefficients_5 * (exp_coefficients_2 * exp_coefficients_9);
        const posegsa_real exp_coefficients_11 = (1 - series_8) * (exp_coefficients_1 ?
            exp_coefficients_10 : POSEGSA_C(0.5));
        const posegsa_real exp_coefficients_12 = 2 * exp_coefficients_11;
        const posegsa_real exp_coefficients_13 = (1 - exp_coefficients_12 * exp_coefficients_7)
            * exp_coefficients_9;
        const posegsa_real choose_2 = exp_coefficients_8 ? w->angle_squared : 0;
        const posegsa_real series_9 = choose_2 * (POSEGSA_C(2.5052108e-08) - choose_2 *
            POSEGSA_C(1.6059044e-10));
        const posegsa_real series_10 = POSEGSA_C(0.0001984127) - choose_2 *
            (POSEGSA_C(2.7557319e-06) - series_9);
        const posegsa_real series_11 = POSEGSA_C(0.16666667) - choose_2 *
            (POSEGSA_C(0.008333334) - choose_2 * series_10);
        w->exponential[0] = exp_coefficients_7;
        w->exponential[1] = exp_coefficients_11;
        w->exponential[2] = exp_coefficients_12 * exp_coefficients_11;
        w->exponential[3] = exp_coefficients_8 ? series_11 : exp_coefficients_13;
    } else {
        const int exp_coefficients_1 = w->angle_squared > POSEGSA_C(9.869604401089358);
        const posegsa_real exp_coefficients_2 = posegsa_sqrt(posegsa_max(w->angle_squared,
            POSEGSA_C(9.869604401089358)));
        const posegsa_real round_1 = posegsa_rint(exp_coefficients_2 *
            POSEGSA_C(0.15915494309189535));
        const posegsa_real exp_coefficients_3 = posegsa_fabs(round_1 - 2 *
            posegsa_rint(POSEGSA_C(0.5) * round_1));
        const posegsa_real exp_coefficients_4 = 1 - 2 * exp_coefficients_3;
        const posegsa_real exp_coefficients_5 = exp_coefficients_2 - round_1 *
            POSEGSA_C(6.28125) - round_1 * POSEGSA_C(0.001935307179586232);
        const posegsa_real choose_1 = exp_coefficients_1 ? exp_coefficients_5 *
            exp_coefficients_5 : w->angle_squared;
        const posegsa_real exp_coefficients_6 = POSEGSA_C(0.25) * choose_1;
        const posegsa_real series_1 = POSEGSA_C(1.5619206968586225e-16) - exp_coefficients_6 *
            POSEGSA_C(4.110317623312165e-19);
        const posegsa_real series_2 = exp_coefficients_6 * (POSEGSA_C(4.779477332387385e-14) -
            exp_coefficients_6 * series_1);
        const posegsa_real series_3 = exp_coefficients_6 * (POSEGSA_C(1.1470745597729725e-11) -
            series_2);
        const posegsa_real series_4 = exp_coefficients_6 * (POSEGSA_C(2.08767569878681e-09) -
            series_3);
        const posegsa_real series_5 = exp_coefficients_6 * (POSEGSA_C(2.755731922398589e-07) -
            series_4);
        const posegsa_real series_6 = exp_coefficients_6 * (POSEGSA_C(2.48015873015873e-05) -
            series_5);
        const posegsa_real series_7 = exp_coefficients_6 * (POSEGSA_C(0.001388888888888889) -
            series_6);
        const posegsa_real series_8 = exp_coefficients_6 * (POSEGSA_C(0.041666666666666664) -
            series_7);
        const posegsa_real exp_coefficients_7 = (exp_coefficients_1 ? exp_coefficients_4 : 1) *
            (1 - exp_coefficients_6 * (POSEGSA_C(0.5) - series_8));
        const posegsa_real series_9 = POSEGSA_C(8.22063524662433e-18) - exp_coefficients_6 *
            POSEGSA_C(1.9572941063391263e-20);
        const posegsa_real series_10 = POSEGSA_C(2.8114572543455206e-15) - exp_coefficients_6 *
            series_9;
        const posegsa_real series_11 = POSEGSA_C(7.647163731819816e-13) - exp_coefficients_6 *
            series_10;
        const posegsa_real series_12 = POSEGSA_C(1.6059043836821613e-10) - exp_coefficients_6 *
            series_11;
        const posegsa_real series_13 = POSEGSA_C(2.505210838544172e-08) - exp_coefficients_6 *
            series_12;
        const posegsa_real series_14 = POSEGSA_C(2.7557319223985893e-06) - exp_coefficients_6 *
            series_13;
        const posegsa_real series_15 = POSEGSA_C(0.0001984126984126984) - exp_coefficients_6 *
            series_14;
        const posegsa_real series_16 = exp_coefficients_6 * (POSEGSA_C(0.008333333333333333) -
            exp_coefficients_6 * series_15);
        const posegsa_real series_17 = exp_coefficients_6 * (POSEGSA_C(0.16666666666666666) -
            series_16);
        const int exp_coefficients_8 = w->angle_squared < 1;
        const posegsa_real exp_coefficients_9 = 1 / (exp_coefficients_8 ? 1 : w->angle_squared);
        const posegsa_real exp_coefficients_10 = POSEGSA_C(0.5) * exp_coefficients_4 *
            exp_coefficients_5 * (exp_coefficients_2 * exp_coefficients_9);
        const posegsa_real exp_coefficients_11 = (1 - series_17) * (exp_coefficients_1 ?
            exp_coefficients_10 : POSEGSA_C(0.5));
        const posegsa_real exp_coefficients_12 = 2 * exp_coefficients_11;
        const posegsa_real exp_coefficients_13 = (1 - exp_coefficients_12 * exp_coefficients_7)
            * exp_coefficients_9;
        const posegsa_real choose_2 = exp_coefficients_8 ? w->angle_squared : 0;
        const posegsa_real series_18 = POSEGSA_C(8.22063524662433e-18) - choose_2 *
            POSEGSA_C(1.9572941063391263e-20);
        const posegsa_real series_19 = choose_2 * (POSEGSA_C(2.8114572543455206e-15) - choose_2
            * series_18);
        const posegsa_real series_20 = POSEGSA_C(1.6059043836821613e-10) - choose_2 *
            (POSEGSA_C(7.647163731819816e-13) - series_19);
        const posegsa_real series_21 = choose_2 * (POSEGSA_C(2.505210838544172e-08) - choose_2 *
            series_20);
        const posegsa_real series_22 = POSEGSA_C(0.0001984126984126984) - choose_2 *
            (POSEGSA_C(2.7557319223985893e-06) - series_21);
        const posegsa_real series_23 = choose_2 * (POSEGSA_C(0.008333333333333333) - choose_2 *
            series_22);
        w->exponential[0] = exp_coefficients_7;
        w->exponential[1] = exp_coefficients_11;
        w->exponential[2] = exp_coefficients_12 * exp_coefficients_11;
        w->exponential[3] = exp_coefficients_8 ? POSEGSA_C(0.16666666666666666) - series_23 :
            exp_coefficients_13;
    }
}

/* Moves the estimate by w->omega and w->v. */
static inline void posegsa_move(posegsa_work *w, posegsa_state *next)
{
    const posegsa_real scale_1 = w->exponential[1] * w->omega[0];
    const posegsa_real product_1 = next->attitude[0] * w->exponential[0] - next->attitude[1] *
        scale_1;
    const posegsa_real scale_2 = w->exponential[1] * w->omega[1];
    const posegsa_real scale_3 = w->exponential[1] * w->omega[2];
    const posegsa_real product_2 = product_1 - next->attitude[2] * scale_2 - next->attitude[3] *
        scale_3;
    const posegsa_real product_3 = next->attitude[0] * scale_1 + next->attitude[1] *
        w->exponential[0];
    const posegsa_real product_4 = product_3 + next->attitude[2] * scale_3 - next->attitude[3] *
        scale_2;
    const posegsa_real product_5 = next->attitude[0] * scale_2 - next->attitude[1] * scale_3 +
        next->attitude[2] * w->exponential[0];
    const posegsa_real product_6 = product_5 + next->attitude[3] * scale_1;
    const posegsa_real compose_1 = product_2 * product_2 + product_4 * product_4 + product_6 *
        product_6;
    const posegsa_real product_7 = next->attitude[0] * scale_3 + next->attitude[1] * scale_2 -
        next->attitude[2] * scale_1;
    const posegsa_real product_8 = product_7 + next->attitude[3] * w->exponential[0];
    const posegsa_real compose_2 = POSEGSA_C(1.5) - POSEGSA_C(0.5) * (compose_1 + product_8 *
        product_8);
    const posegsa_real compose_3 = product_2 * compose_2;
    const posegsa_real compose_4 = product_4 * compose_2;
    const posegsa_real compose_5 = product_6 * compose_2;
    const posegsa_real compose_6 = product_8 * compose_2;
    const posegsa_real rows_1 = next->attitude[2] * next->attitude[2];
    const posegsa_real rows_2 = next->attitude[3] * next->attitude[3];
    const posegsa_real cross_1 = w->omega[1] * w->v[2] - w->omega[2] * w->v[1];
    const posegsa_real cross_2 = w->omega[0] * w->v[1] - w->omega[1] * w->v[0];
    const posegsa_real cross_3 = w->omega[2] * w->v[0] - w->omega[0] * w->v[2];
    const posegsa_real scale_4 = w->exponential[3] * (w->omega[1] * cross_2 - w->omega[2] *
        cross_3);
    const posegsa_real add_1 = w->v[0] + (w->exponential[2] * cross_1 + scale_4);
    const posegsa_real rows_3 = next->attitude[1] * next->attitude[2];
    const posegsa_real rows_4 = next->attitude[0] * next->attitude[3];
    const posegsa_real scale_5 = w->exponential[3] * (w->omega[2] * cross_1 - w->omega[0] *
        cross_2);
    const posegsa_real add_2 = w->v[1] + (w->exponential[2] * cross_3 + scale_5);
    const posegsa_real dot_1 = (1 - 2 * (rows_1 + rows_2)) * add_1 + 2 * (rows_3 - rows_4) *
        add_2;
    const posegsa_real rows_5 = next->attitude[1] * next->attitude[3];
    const posegsa_real rows_6 = next->attitude[0] * next->attitude[2];
    const posegsa_real scale_6 = w->exponential[3] * (w->omega[0] * cross_3 - w->omega[1] *
        cross_1);
    const posegsa_real add_3 = w->v[2] + (w->exponential[2] * cross_2 + scale_6);
    const posegsa_real add_4 = next->position[0] + (dot_1 + 2 * (rows_5 + rows_6) * add_3);
    const posegsa_real rows_7 = next->attitude[1] * next->attitude[1];
    const posegsa_real dot_2 = 2 * (rows_3 + rows_4) * add_1 + (1 - 2 * (rows_7 + rows_2)) *
        add_2;
    const posegsa_real rows_8 = next->attitude[2] * next->attitude[3];
    const posegsa_real rows_9 = next->attitude[0] * next->attitude[1];
    const posegsa_real add_5 = next->position[1] + (dot_2 + 2 * (rows_8 - rows_9) * add_3);
    const posegsa_real dot_3 = 2 * (rows_5 - rows_6) * add_1 + 2 * (rows_8 + rows_9) * add_2 +
        (1 - 2 * (rows_7 + rows_1)) * add_3;
    const posegsa_real add_6 = next->position[2] + dot_3;
    next->attitude[0] = compose_3;
    next->attitude[1] = compose_4;
    next->attitude[2] = compose_5;
    next->attitude[3] = compose_6;
    next->position[0] = add_4;
    next->position[1] = add_5;
    next->position[2] = add_6;
}

/* The vectors' biases, from the residuals at the sample. */
static inline void posegsa_learn(const posegsa_state *now, const posegsa_measurement *seen,
                                 posegsa_real dt, posegsa_work *w, posegsa_state *next)
{
    const int learnt_vector_biases_1 = seen->vector_weights[0] > 0;
    const posegsa_real learnt_vector_biases_2 = 1 - dt * posegsa_vector_bias_leak;
    const posegsa_real choose_1 = learnt_vector_biases_1 ? learnt_vector_biases_2 : 1;
    const posegsa_real learnt_vector_biases_3 = dt / (posegsa_vector_bias_excitation_time + dt);
    const posegsa_real scale_1 = learnt_vector_biases_3 * (seen->angular_velocity[0] -
        now->turning[0]);
    const posegsa_real add_1 = now->turning[0] + scale_1;
    const posegsa_real subtract_1 = add_1 - now->bias_angular[0];
    const posegsa_real scale_2 = learnt_vector_biases_3 * (seen->angular_velocity[1] -
        now->turning[1]);
    const posegsa_real add_2 = now->turning[1] + scale_2;
    const posegsa_real subtract_2 = add_2 - now->bias_angular[1];
    const posegsa_real scale_3 = learnt_vector_biases_3 * (seen->angular_velocity[2] -
        now->turning[2]);
    const posegsa_real add_3 = now->turning[2] + scale_3;
    const posegsa_real subtract_3 = add_3 - now->bias_angular[2];
    const posegsa_real dot_1 = subtract_1 * subtract_1 + subtract_2 * subtract_2 + subtract_3 *
        subtract_3;
    const posegsa_real learnt_vector_biases_4 = dt * (posegsa_vector_bias_gain * (w->used *
        POSEGSA_C(0.1))) * posegsa_min(posegsa_vector_bias_per_turning * dot_1 * dot_1, 1);
    const posegsa_real choose_2 = posegsa_min(learnt_vector_biases_4, 1);
    const posegsa_real choose_3 = learnt_vector_biases_1 ? choose_2 : 0;
    const posegsa_real rows_1 = now->attitude[2] * now->attitude[2];
    const posegsa_real rows_2 = now->attitude[3] * now->attitude[3];
    const posegsa_real rows_3 = 1 - 2 * (rows_1 + rows_2);
    const posegsa_real rows_4 = now->attitude[1] * now->attitude[2];
    const posegsa_real rows_5 = now->attitude[0] * now->attitude[3];
    const posegsa_real rows_6 = 2 * (rows_4 + rows_5);
    const posegsa_real rows_7 = now->attitude[1] * now->attitude[3];
    const posegsa_real rows_8 = now->attitude[0] * now->attitude[2];
    const posegsa_real rows_9 = 2 * (rows_7 - rows_8);
    const posegsa_real add_4 = posegsa_vectors[0][0] * rows_3 + posegsa_vectors[0][1] * rows_6 +
        posegsa_vectors[0][2] * rows_9;
    const posegsa_real add_5 = choose_1 * now->vector_bias[0][0] + choose_3 * (w->freed[0][0] -
        add_4);
    const posegsa_real rows_10 = 2 * (rows_4 - rows_5);
    const posegsa_real rows_11 = now->attitude[1] * now->attitude[1];
    const posegsa_real rows_12 = 1 - 2 * (rows_11 + rows_2);
    const posegsa_real add_6 = posegsa_vectors[0][0] * rows_10 + posegsa_vectors[0][1] *
        rows_12;
    const posegsa_real rows_13 = now->attitude[2] * now->attitude[3];
    const posegsa_real rows_14 = now->attitude[0] * now->attitude[1];
    const posegsa_real rows_15 = 2 * (rows_13 + rows_14);
    const posegsa_real scale_4 = choose_3 * (w->freed[0][1] - (add_6 + posegsa_vectors[0][2] *
        rows_15));
    const posegsa_real add_7 = choose_1 * now->vector_bias[0][1] + scale_4;
    const posegsa_real rows_16 = 2 * (rows_7 + rows_8);
    const posegsa_real rows_17 = 2 * (rows_13 - rows_14);
    const posegsa_real add_8 = posegsa_vectors[0][0] * rows_16 + posegsa_vectors[0][1] *
        rows_17;
    const posegsa_real rows_18 = 1 - 2 * (rows_11 + rows_1);
    const posegsa_real scale_5 = choose_3 * (w->freed[0][2] - (add_8 + posegsa_vectors[0][2] *
        rows_18));
    const posegsa_real add_9 = choose_1 * now->vector_bias[0][2] + scale_5;
    const posegsa_real bounded_1 = posegsa_vector_bias_per_bound * (add_5 * add_5 + add_7 *
        add_7 + add_9 * add_9);
    const posegsa_real choose_4 = bounded_1 > 1 ? posegsa_max(POSEGSA_C(1.5) - POSEGSA_C(0.5) *
        bounded_1, 0) : 1;
    const int learnt_vector_biases_5 = seen->vector_weights[1] > 0;
    const posegsa_real choose_5 = learnt_vector_biases_5 ? learnt_vector_biases_2 : 1;
    const posegsa_real choose_6 = learnt_vector_biases_5 ? choose_2 : 0;
    const posegsa_real add_10 = posegsa_vectors[1][0] * rows_3 + posegsa_vectors[1][1] * rows_6
        + posegsa_vectors[1][2] * rows_9;
    const posegsa_real add_11 = choose_5 * now->vector_bias[1][0] + choose_6 * (w->freed[1][0] -
        add_10);
    const posegsa_real add_12 = posegsa_vectors[1][0] * rows_10 + posegsa_vectors[1][1] *
        rows_12;
    const posegsa_real scale_6 = choose_6 * (w->freed[1][1] - (add_12 + posegsa_vectors[1][2] *
        rows_15));
    const posegsa_real add_13 = choose_5 * now->vector_bias[1][1] + scale_6;
    const posegsa_real add_14 = posegsa_vectors[1][0] * rows_16 + posegsa_vectors[1][1] *
        rows_17;
    const posegsa_real scale_7 = choose_6 * (w->freed[1][2] - (add_14 + posegsa_vectors[1][2] *
        rows_18));
    const posegsa_real add_15 = choose_5 * now->vector_bias[1][2] + scale_7;
    const posegsa_real bounded_2 = posegsa_vector_bias_per_bound * (add_11 * add_11 + add_13 *
        add_13 + add_15 * add_15);
    const posegsa_real choose_7 = bounded_2 > 1 ? posegsa_max(POSEGSA_C(1.5) - POSEGSA_C(0.5) *
        bounded_2, 0) : 1;
    next->vector_bias[0][0] = choose_4 * add_5;
    next->vector_bias[0][1] = choose_4 * add_7;
    next->vector_bias[0][2] = choose_4 * add_9;
    next->vector_bias[1][0] = choose_7 * add_11;
    next->vector_bias[1][1] = choose_7 * add_13;
    next->vector_bias[1][2] = choose_7 * add_15;
    next->turning[0] = add_1;
    next->turning[1] = add_2;
    next->turning[2] = add_3;
}

/* The attitude as a matrix. */
static inline void posegsa_rows(const posegsa_state *now, posegsa_real rotation[3][3])
{
    const posegsa_real rows_1 = now->attitude[2] * now->attitude[2];
    const posegsa_real rows_2 = now->attitude[3] * now->attitude[3];
    const posegsa_real rows_3 = now->attitude[1] * now->attitude[2];
    const posegsa_real rows_4 = now->attitude[0] * now->attitude[3];
    const posegsa_real rows_5 = now->attitude[1] * now->attitude[3];
    const posegsa_real rows_6 = now->attitude[0] * now->attitude[2];
    const posegsa_real rows_7 = now->attitude[1] * now->attitude[1];
    const posegsa_real rows_8 = now->attitude[2] * now->attitude[3];
    const posegsa_real rows_9 = now->attitude[0] * now->attitude[1];
    rotation[0][0] = 1 - 2 * (rows_1 + rows_2);
    rotation[0][1] = 2 * (rows_3 - rows_4);
    rotation[0][2] = 2 * (rows_5 + rows_6);
    rotation[1][0] = 2 * (rows_3 + rows_4);
    rotation[1][1] = 1 - 2 * (rows_7 + rows_2);
    rotation[1][2] = 2 * (rows_8 - rows_9);
    rotation[2][0] = 2 * (rows_5 - rows_6);
    rotation[2][1] = 2 * (rows_8 + rows_9);
    rotation[2][2] = 1 - 2 * (rows_7 + rows_1);
}

/* ---- The step -------------------------------------------------------------------------------- */

/* Whether all n numbers are between -limit and limit; NaN is not. */
static inline int posegsa_are_within(const posegsa_real *x, int n, posegsa_real limit)
{
    int i;
    for (i = 0; i < n; ++i) {
        if (!(x[i] >= -limit && x[i] <= limit)) {
            return 0;
        }
    }
    return 1;
}

/* Copies n vectors or landmarks with their weights; missing ones become 0. Returns 0 if a number is
 * refused. A direction of length 0 counts as missing; a landmark may be at the body's position. */
static inline int posegsa_copy_seen(posegsa_real (*to)[3], posegsa_real *weights_to,
                                    const posegsa_real (*from)[3], const posegsa_real *weights,
                                    int n, posegsa_real limit, int directions)
{
    int i, k;
    for (i = 0; i < n; ++i) {
        if (!(weights[i] >= 0 && weights[i] <= POSEGSA_C(POSEGSA_MAX_WEIGHT))) {
            return 0;
        }
        weights_to[i] = weights[i];
        if (weights[i] > 0 && !posegsa_are_within(from[i], 3, limit)) {
            return 0;
        }
        if (directions && weights[i] > 0 && from[i][0] == 0 && from[i][1] == 0 && from[i][2] == 0) {
            weights_to[i] = 0;
        }
        for (k = 0; k < 3; ++k) {
            to[i][k] = weights_to[i] > 0 ? from[i][k] : 0;
        }
    }
    return 1;
}

/* Whether all n numbers are finite. */
static inline int posegsa_are_finite(const posegsa_real *x, int n)
{
    int i;
    for (i = 0; i < n; ++i) {
        if (!(x[i] - x[i] == 0)) {
            return 0;
        }
    }
    return 1;
}

/* Whether an estimate is valid: all numbers finite, and a quaternion of length 1. */
static inline int posegsa_is_estimate(const posegsa_state *state)
{
    const posegsa_real *const q = state->attitude;
    const posegsa_real excess = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1;
    int i;
    for (i = 0; i < POSEGSA_VECTORS; ++i) {
        if (!posegsa_are_finite(state->vector_bias[i], 3)) {
            return 0;
        }
    }
    return posegsa_are_within(&excess, 1, POSEGSA_C(1e-05)) &&
           posegsa_are_finite(state->bias_angular, 3) &&
           posegsa_are_finite(state->position, 3) && posegsa_are_finite(state->bias_linear, 3) &&
           posegsa_are_finite(state->turning, 3) &&
           state->error - state->error == 0 && state->gain_used - state->gain_used == 0;
}

static inline int posegsa_init(posegsa_state *state, const posegsa_real attitude[4],
                               const posegsa_real position[3])
{
    posegsa_state first;
    posegsa_real largest = 0, square = 0;
    int i, k;
    if (!posegsa_are_within(position, 3, POSEGSA_C(POSEGSA_MAX_POSITION))) {
        return POSEGSA_INVALID_INPUT;
    }
    for (i = 0; i < 4; ++i) {
        if (!(attitude[i] - attitude[i] == 0)) { /* NaN or infinite */
            return POSEGSA_INVALID_INPUT;
        }
    }
    for (i = 0; i < 4; ++i) {
        largest = posegsa_max(largest, posegsa_max(attitude[i], -attitude[i]));
    }
    if (!(largest > 0)) {
        return POSEGSA_INVALID_INPUT;
    }
    for (i = 0; i < 4; ++i) { /* divided by the largest first, so that no square overflows */
        first.attitude[i] = attitude[i] / largest;
        square += first.attitude[i] * first.attitude[i];
    }
    for (i = 0; i < 4; ++i) {
        first.attitude[i] /= posegsa_sqrt(square);
    }
    for (i = 0; i < 3; ++i) {
        first.bias_angular[i] = 0;
        first.position[i] = position[i];
        first.bias_linear[i] = 0;
        first.turning[i] = 0;
        for (k = 0; k < POSEGSA_VECTORS; ++k) {
            first.vector_bias[k][i] = 0;
        }
    }
    first.attitude_error = 0;
    first.position_error = 0;
    first.error = 0;
    first.since_last = POSEGSA_C(INFINITY);
    first.gain = POSEGSA_C(51.0);
    first.gain_used = 0;
    *state = first;
    return POSEGSA_OK;
}

static inline int posegsa_step(posegsa_state *state, const posegsa_measurement *measurement,
                               posegsa_real dt)
{
    const posegsa_state *const now = state; /* the estimate at the sample */
    posegsa_state after = *state, *const next = &after;
    posegsa_measurement taken, *const seen = &taken; /* 0 where something is missing */
    posegsa_work work, *const w = &work;
    posegsa_real used = 0;
    int i;

    if (!(dt >= POSEGSA_C(POSEGSA_MIN_TIME_STEP) && dt <= POSEGSA_C(POSEGSA_MAX_TIME_STEP)) ||
        !posegsa_are_within(measurement->velocity, 3, POSEGSA_C(POSEGSA_MAX_VELOCITY)) ||
        !posegsa_copy_seen(seen->vectors, seen->vector_weights, measurement->vectors,
                           measurement->vector_weights, POSEGSA_VECTORS,
                           POSEGSA_C(POSEGSA_MAX_VECTOR), 1) ||
        !posegsa_copy_seen(seen->landmarks, seen->landmark_weights, measurement->landmarks,
                           measurement->landmark_weights, POSEGSA_LANDMARKS,
                           POSEGSA_C(POSEGSA_MAX_LANDMARK), 0) ||
        !posegsa_are_within(measurement->angular_velocity, 3,
                           POSEGSA_C(POSEGSA_MAX_ANGULAR_VELOCITY))) {
        return POSEGSA_INVALID_INPUT;
    }
    for (i = 0; i < 3; ++i) {
        seen->angular_velocity[i] = measurement->angular_velocity[i];
        seen->velocity[i] = measurement->velocity[i];
    }
    w->reach = 0;
    for (i = 0; i < POSEGSA_LANDMARKS; ++i) {
        const posegsa_real *const y = seen->landmarks[i];
        w->reach = posegsa_max(w->reach, y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    }

    posegsa_see(now, seen, w);
    posegsa_signal(now, seen, dt, w, next);
    w->gain = posegsa_gain(w->error, w->rate, now->gain);
    w->learning = 1;
    next->gain = w->gain;
    if (!(w->gain >= 0)) {
        return POSEGSA_NOT_FINITE;
    }

    /* All sub-steps use the same measurement; the last one adds the motion of the whole dt. */
    for (i = 0; i < POSEGSA_SUBSTEPS; ++i) {
        const posegsa_real h = dt / POSEGSA_C(POSEGSA_SUBSTEPS);
        const posegsa_real moving = i == POSEGSA_SUBSTEPS - 1 ? dt : 0;
        posegsa_correct(seen, dt, h, moving, w, next);
        posegsa_exponential(w);
        posegsa_move(w, next);
        used += w->used;
    }
    w->used = used / POSEGSA_C(POSEGSA_SUBSTEPS);
    next->gain_used = w->used;
    posegsa_learn(now, seen, dt, w, next);

    if (!posegsa_is_estimate(next)) {
        return POSEGSA_NOT_FINITE;
    }
    *state = after;
    return POSEGSA_OK;
}

static inline void posegsa_rotation(const posegsa_state *state, posegsa_real rotation[3][3])
{
    const posegsa_state *const now = state;
    posegsa_rows(now, rotation);
}

#endif /* POSEGSA_H */
