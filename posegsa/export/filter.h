/*
 * {{ file }}: {{ title }}, as C99; also valid C++17.
{{ origin }}
 *
 * WHAT IT DOES
{{ purpose }}
 *
 * USE
 *     #include "{{ file }}"
 *     #include <stdio.h>
 *     static posegsa_measurement now; // all zeros: nothing is measured
 *     int main(void) {
 *         const posegsa_real turned[4] = {20, 1, 0, 0}{{ "" if attitude_only else ", origin[3] = {0, 0, 0}" }};
 *         posegsa_state filter;
 *         if (posegsa_init(&filter, turned{{ "" if attitude_only else ", origin" }}) != POSEGSA_OK) return 1; // 6 deg off
 *         for (int k = 0; k < 1000; ++k) { // 10 s at 100 Hz, the body at rest and upright
{% if vectors %}
 *             for (int i = 0; i < 3 * POSEGSA_VECTORS; ++i)
 *                 now.vectors[i / 3][i % 3] = posegsa_vectors[i / 3][i % 3];
 *             for (int i = 0; i < POSEGSA_VECTORS; ++i) now.vector_weights[i] = 1; // not missing
{% else %}
 *             for (int i = 0; i < 3 * POSEGSA_LANDMARKS; ++i)
 *                 now.landmarks[i / 3][i % 3] = posegsa_landmarks[i / 3][i % 3];
 *             for (int i = 0; i < POSEGSA_LANDMARKS; ++i) now.landmark_weights[i] = 1; // seen
{% endif %}
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
{% block missing %}
 * A weight of 0 marks a vector or a landmark as missing: its numbers are then ignored, and may be
 * NaN. So does a vector of length 0. Any other number that is NaN, or beyond the
 * limits below, is refused with POSEGSA_INVALID_INPUT: no sensor gives it. An estimate that would
 * not be finite, or whose quaternion would not have length 1, is refused with POSEGSA_NOT_FINITE. A
 * refused sample leaves the state as it was: let the next dt cover its time too. If good samples
 * are refused again and again, start anew. Pointers must be valid.
{% endblock %}
 *
 * PRECISION, MEMORY, THREADS
 * posegsa_real is double; compile with -DPOSEGSA_REAL=float for single precision. No heap, no
 * global state, no header except <math.h>: filters with different states are independent and may
 * run in any thread or interrupt. Do not use -ffast-math, which removes the checks for NaN.
 *
 * WHAT IT IS WORTH
{{ worth }}
{% if settings %}
 *
 * SETTINGS OF THE RUN, which the numbers below come from
{{ settings }}
{% endif %}
 */

#ifndef POSEGSA_H
#define POSEGSA_H

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "{{ file }}: -ffast-math or -ffinite-math-only would remove the checks for NaN"
#endif

#include <math.h>

{% include 'numbers.c' %}

/* ---- Limits ---------------------------------------------------------------------------------- */

/* The largest accepted magnitude of each component. No sensor gives larger numbers. To change a
 * limit, define it before this line or with -D. */
{% for limit in limits %}
#ifndef {{ limit.name }}
#define {{ limit.name }} {{ limit.value }} /* {{ limit.about }} */
#endif
{% endfor %}

/* ---- Types --------------------------------------------------------------------------------- */

enum {
{% if vectors %}
    POSEGSA_VECTORS = {{ vectors }},
{% endif %}
{% if landmarks %}
    POSEGSA_LANDMARKS = {{ landmarks }},
{% endif %}
{% block more_counts %}
{% endblock %}
};

/* What the functions that start and step a filter return. */
enum {
    POSEGSA_OK = 0,
    POSEGSA_INVALID_INPUT = 1, /* NaN, or outside the limits */
    POSEGSA_NOT_FINITE = 2{{ ",   " if "show" in calls else "    " }} /* the estimate would be invalid: NaN, infinite, or |q| not 1 */
{% if "show" in calls %}
    POSEGSA_NO_POSE = 3        /* only of posegsa_init_from: the measurement does not fix a pose */
{% endif %}
};

/* The measurements of one sample. In a record of all zeros nothing is measured. */
typedef struct posegsa_measurement {
    posegsa_real angular_velocity[3]; /* [rad/s], body frame */
{% if not attitude_only %}
    posegsa_real velocity[3];         /* [m/s], body frame */
{% endif %}
{% if vectors %}
    posegsa_real vectors[POSEGSA_VECTORS][3];     /* v_i, body frame, unit of their sensor */
    posegsa_real vector_weights[POSEGSA_VECTORS]; /* 1 measured, 0 missing; factors on s_i */
{% endif %}
{% if landmarks %}
    posegsa_real landmarks[POSEGSA_LANDMARKS][3];     /* y_i [m], body frame */
    posegsa_real landmark_weights[POSEGSA_LANDMARKS]; /* 1 measured, 0 missing; factors on s_i */
{% endif %}
} posegsa_measurement;

/* The state of a filter, set when it starts. The estimates may be read at any time{{ may_be_set }}. */
typedef struct posegsa_state {
    posegsa_real attitude[4];     /* quaternion w, x, y, z, body to inertial */
{% if not attitude_only %}
    posegsa_real position[3];     /* [m], inertial frame */
{% endif %}
    posegsa_real bias_angular[3]; /* of the angular velocity [rad/s], body frame */
{% if not attitude_only %}
    posegsa_real bias_linear[3];  /* of the velocity [m/s], body frame */
{% endif %}
{% if learns %}
    posegsa_real vector_bias[POSEGSA_VECTORS][3]; /* c_i, body frame, the vectors' units */
{% endif %}
{% if turning %}
    posegsa_real turning[3];      /* low-passed angular velocity [rad/s], body frame */
{% endif %}
{% block memory %}
{% endblock %}
} posegsa_state;

/* ---- Functions ----------------------------------------------------------------------------- */

{% block init_about %}
/* Starts a filter. attitude: quaternion of any length but 0; position [m], inertial frame. Returns
 * POSEGSA_OK, or an error code and does not change the state. */
{% endblock %}
static inline int posegsa_init(posegsa_state *state, const posegsa_real attitude[4]{{ "" if attitude_only else ",
                               const posegsa_real position[3]" }});

{% if "show" in calls %}
/* Starts a filter at the {{ "attitude" if attitude_only else "pose" }} that one measurement shows; give the same one to posegsa_step next.
{% if landmarks %}
 * It needs a landmark and two directions that are not parallel: of vectors, and of the landmarks
 * about their centre.
{% else %}
 * It needs two vectors that are not parallel{{ "" if attitude_only else "; the position starts at 0" }}.
{% endif %}
 * Returns POSEGSA_OK; POSEGSA_NO_POSE if these are not measured; or an error code. In both other
 * cases it does not change the state. */
static inline int posegsa_init_from(posegsa_state *state, const posegsa_measurement *measurement);

{% endif %}
/* Processes one sample and propagates the estimate to the next one, dt [s] later. Returns
 * POSEGSA_OK, or an error code and does not change the state. */
static inline int posegsa_step(posegsa_state *state, const posegsa_measurement *measurement,
                               posegsa_real dt);

/* The attitude as a matrix by rows, body to inertial. */
static inline void posegsa_rotation(const posegsa_state *state, posegsa_real rotation[3][3]);

/* ---- Numbers, tuned and chosen --------------------------------------------------------------- */

{{ constants }}

{% block parts_about %}
/* ---- The step, generated from the filter's own functions ------------------------------------- */

{% endblock %}
{% for function in functions %}
{% if function in ("atan2", "pow") %}
static inline posegsa_real posegsa_{{ function }}(posegsa_real x, posegsa_real y)
{
    /* The compiler evaluates the comparison. */
    return sizeof(posegsa_real) < sizeof(double) ? (posegsa_real){{ function }}f((float)x, (float)y)
                                                 : (posegsa_real){{ function }}((double)x, (double)y);
}
{% else %}
static inline posegsa_real posegsa_{{ function }}(posegsa_real x)
{
    /* The compiler evaluates the comparison. */
    return sizeof(posegsa_real) < sizeof(double) ? (posegsa_real){{ function }}f((float)x)
                                                 : (posegsa_real){{ function }}((double)x);
}
{% endif %}

{% endfor %}
{% block work %}
{% endblock %}
{% for piece in pieces %}
/* {{ piece.about }} */
static inline void posegsa_{{ piece.name }}({{ piece.signature }})
{
{{ piece.body }}
}

{% endfor %}
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

{% if vectors or landmarks %}
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

{% endif %}
/* Copies a measurement, with 0 where something is missing. Returns 0 if a number is refused. */
static inline int posegsa_take(posegsa_measurement *seen, const posegsa_measurement *measurement)
{
    int i;
    if ({% if not attitude_only %}!posegsa_are_within(measurement->velocity, 3, POSEGSA_C(POSEGSA_MAX_VELOCITY)) ||
        {% endif %}{% if vectors %}!posegsa_copy_seen(seen->vectors, seen->vector_weights, measurement->vectors,
                           measurement->vector_weights, POSEGSA_VECTORS,
                           POSEGSA_C(POSEGSA_MAX_VECTOR), 1) ||
        {% endif %}{% if landmarks %}!posegsa_copy_seen(seen->landmarks, seen->landmark_weights, measurement->landmarks,
                           measurement->landmark_weights, POSEGSA_LANDMARKS,
                           POSEGSA_C(POSEGSA_MAX_LANDMARK), 0) ||
        {% endif %}!posegsa_are_within(measurement->angular_velocity, 3,
                            POSEGSA_C(POSEGSA_MAX_ANGULAR_VELOCITY))) {
        return 0;
    }
    for (i = 0; i < 3; ++i) {
        seen->angular_velocity[i] = measurement->angular_velocity[i];
{% if not attitude_only %}
        seen->velocity[i] = measurement->velocity[i];
{% endif %}
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
{% block checks %}
{% endblock %}

/* Whether an estimate is valid: all numbers finite, and a quaternion of length 1. */
static inline int posegsa_is_estimate(const posegsa_state *state)
{
    const posegsa_real *const q = state->attitude;
    const posegsa_real excess = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1;
{% if learns %}
    int i;
    for (i = 0; i < POSEGSA_VECTORS; ++i) {
        if (!posegsa_are_finite(state->vector_bias[i], 3)) {
            return 0;
        }
    }
{% endif %}
    return posegsa_are_within(&excess, 1, POSEGSA_C({{ unit_tolerance }})) &&
           posegsa_are_finite(state->bias_angular, 3) &&
{% if not attitude_only %}
           posegsa_are_finite(state->position, 3) && posegsa_are_finite(state->bias_linear, 3) &&
{% endif %}
{% if turning %}
           posegsa_are_finite(state->turning, 3) &&
{% endif %}
{% block memory_is_fine %}
{% endblock %}
}

static inline int posegsa_init(posegsa_state *state, const posegsa_real attitude[4]{{ "" if attitude_only else ",
                               const posegsa_real position[3]" }})
{
{% block init_variables %}
{% endblock %}
{% if not attitude_only %}
    if (!posegsa_are_within(position, 3, POSEGSA_C(POSEGSA_MAX_POSITION))) {
        return POSEGSA_INVALID_INPUT;
    }
{% endif %}
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
{% block init_state %}
{% endblock %}
    return POSEGSA_OK;
}

{% if "show" in calls %}
static inline int posegsa_init_from(posegsa_state *state, const posegsa_measurement *measurement)
{
    posegsa_measurement taken, *const seen = &taken;
    posegsa_real pose[8]; /* whether there is one, its quaternion{{ "" if attitude_only else " and position" }} */
    if (!posegsa_take(seen, measurement)) {
        return POSEGSA_INVALID_INPUT;
    }
    {{ calls.show }}
    return pose[0] > 0 ? posegsa_init(state, &pose[1]{{ "" if attitude_only else ", &pose[5]" }}) : POSEGSA_NO_POSE;
}

{% endif %}
static inline int posegsa_step(posegsa_state *state, const posegsa_measurement *measurement,
                               posegsa_real dt)
{
    const posegsa_state *const now = state; /* the estimate at the sample */
{% block after %}
    posegsa_state after = *state, *const next = &after;
{% endblock %}
    posegsa_measurement taken, *const seen = &taken; /* 0 where something is missing */
{% block step_variables %}
    int i;
{% endblock %}

    if (!(dt >= POSEGSA_C(POSEGSA_MIN_TIME_STEP) && dt <= POSEGSA_C(POSEGSA_MAX_TIME_STEP)) ||
        !posegsa_take(seen, measurement)) {
        return POSEGSA_INVALID_INPUT;
    }
{% block advance %}
{% endblock %}
    if (!posegsa_is_estimate(next)) {
        return POSEGSA_NOT_FINITE;
    }
    *state = after;
    return POSEGSA_OK;
}

static inline void posegsa_rotation(const posegsa_state *state, posegsa_real rotation[3][3])
{
    const posegsa_state *const now = state;
    {{ calls.rows }}
}
{% block more_functions %}
{% endblock %}

#endif /* POSEGSA_H */
