{% extends 'filter.h' %}

{% block missing %}
 * A weight of 0 marks a vector or a landmark as missing: its numbers are then ignored, and may be
 * NaN. So does a vector of length 0. A part of the error that is not measured keeps
 * its last value. Any other number that is NaN, or beyond the limits below, is refused with
 * POSEGSA_INVALID_INPUT: no sensor gives it. An estimate that would not be finite, or whose
 * quaternion would not have length 1, is refused with POSEGSA_NOT_FINITE. A refused sample leaves
 * the state as it was: let the next dt cover its time too. Pointers must be valid.
{% endblock %}
{% block more_counts %}
    POSEGSA_SUBSTEPS = {{ substeps }}
{% endblock %}
{% block memory %}
    /* The memory of the gain schedule, and its gain at the last sample. */
{% if vectors %}
    posegsa_real attitude_error;  /* the last measured one, 0 to 1 */
{% endif %}
{% if landmarks %}
    posegsa_real position_error;  /* the last measured one [m] */
{% endif %}
    posegsa_real error;           /* the schedule's input, smoothed, before it is scaled */
    posegsa_real since_last;      /* dt of the last sample [s]; infinite before the first */
{% if unknown %}
    posegsa_real unknown;         /* unknown share of the biases, 0 to 1 */
{% endif %}
{% if uses_time %}
    posegsa_real time;            /* since the first sample [s] */
{% endif %}
    posegsa_real gain;            /* K from the schedule [1/s] */
    posegsa_real gain_used;       /* K after the gain limit [1/s] */
{% endblock %}
{% block init_about %}
/* Starts a filter. attitude: quaternion of any length but 0{{ "" if attitude_only else "; position [m], inertial frame" }}. Biases
 * start at 0. Returns POSEGSA_OK, or POSEGSA_INVALID_INPUT and does not change the state. */
{% endblock %}
{% block parts_about %}
{% if fuzzy %}
/* ---- The gain: a fuzzy controller ------------------------------------------------------------ */

{{ controller }}
{% endif %}
/* ---- The step's parts, generated from the functions of posegsa.filters and model ------------- */

{% endblock %}
{% block work %}
{% if knots %}
{{ knots }}
{% endif %}
/* Intermediate results of one step. */
typedef struct posegsa_work {
{% if vectors %}
    posegsa_real profile[3][3]; /* B = sum_i s_i u_i v_i^T */
    posegsa_real power;         /* sum_i s_i (|u_i|^2 + |v_i|^2) */
    posegsa_real curvature;     /* the part of L from the vectors */
    posegsa_real scale;         /* 3 / (8 sum_i s_i), 0 without vectors */
{% endif %}
{% if learns %}
    posegsa_real freed[POSEGSA_VECTORS][3]; /* d_i = v_i - c_i */
{% endif %}
{% if landmarks %}
    posegsa_real landmark_weights[POSEGSA_LANDMARKS]; /* s_i, 0 where one is missing */
{% endif %}
    posegsa_real reach;          /* square of the distance to the farthest landmark [m^2] */
    posegsa_real error;          /* scaled, 0 to 1 */
    posegsa_real rate;           /* scaled, 0 to 1 */
    posegsa_real gain;           /* K [1/s] */
    posegsa_real learning;       /* factor on the gain of the vectors' bias law */
{% if waits %}
    posegsa_real share;          /* factor on the gains of all bias laws */
{% endif %}
    posegsa_real used;           /* K after the gain limit [1/s] */
    posegsa_real omega[3];       /* a sub-step's rotation [rad], body frame */
    posegsa_real v[3];           /* a sub-step's displacement [m], body frame */
    posegsa_real angle_squared;  /* |omega|^2 [rad^2] */
    posegsa_real exponential[4]; /* coefficients of the exponential of SE(3) */
} posegsa_work;

{% endblock %}
{% block memory_is_fine %}
           state->error - state->error == 0 && state->gain_used - state->gain_used == 0;
{% endblock %}
{% block init_variables %}
    posegsa_state first;
    posegsa_real largest = 0, square = 0;
    int i{{ ", k" if learns }};
{% endblock %}
{% block init_state %}
    for (i = 0; i < 3; ++i) {
        first.bias_angular[i] = 0;
{% if not attitude_only %}
        first.position[i] = position[i];
        first.bias_linear[i] = 0;
{% endif %}
{% if learns %}
        first.turning[i] = 0;
        for (k = 0; k < POSEGSA_VECTORS; ++k) {
            first.vector_bias[k][i] = 0;
        }
{% endif %}
    }
{% if vectors %}
    first.attitude_error = 0;
{% endif %}
{% if landmarks %}
    first.position_error = 0;
{% endif %}
    first.error = 0;
    first.since_last = POSEGSA_C(INFINITY);
{% if unknown %}
    first.unknown = POSEGSA_C({{ unknown }});
{% endif %}
{% if uses_time %}
    first.time = 0;
{% endif %}
    first.gain = POSEGSA_C({{ initial_gain }});
    first.gain_used = 0;
    *state = first;
{% endblock %}
{% block step_variables %}
    posegsa_work work, *const w = &work;
    posegsa_real used = 0;
    int i;
{% endblock %}
{% block advance %}
    w->reach = 0;
{% if landmarks %}
    for (i = 0; i < POSEGSA_LANDMARKS; ++i) {
        const posegsa_real *const y = seen->landmarks[i];
        w->reach = posegsa_max(w->reach, y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    }
{% endif %}

    {{ calls.see }}
    {{ calls.signal }}
{% if fuzzy %}
    w->gain = posegsa_gain(w->error, w->rate, now->gain);
    w->learning = 1;
{% elif knots %}
    w->gain = posegsa_gain_at(now->time);
    w->learning = 1;
{% else %}
    {{ calls.schedule }}
{% endif %}
    next->gain = w->gain;
    if (!(w->gain >= 0)) {
        return POSEGSA_NOT_FINITE;
    }

    /* All sub-steps use the same measurement; the last one adds the motion of the whole dt. */
    for (i = 0; i < POSEGSA_SUBSTEPS; ++i) {
        const posegsa_real h = dt / POSEGSA_C(POSEGSA_SUBSTEPS);
        const posegsa_real moving = i == POSEGSA_SUBSTEPS - 1 ? dt : 0;
        {{ calls.correct }}
        {{ calls.exponential }}
        {{ calls.move }}
        used += w->used;
    }
    w->used = used / POSEGSA_C(POSEGSA_SUBSTEPS);
    next->gain_used = w->used;
{% if learns %}
    {{ calls.learn }}
{% endif %}
{% if unknown %}
    {{ calls.know }}
{% endif %}
{% if uses_time %}
    next->time = now->time + dt;
{% endif %}

{% endblock %}
