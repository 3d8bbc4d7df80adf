{% extends 'filter.h' %}
{% block memory %}
{% for field in memory %}
    posegsa_real {{ field.declared }}; /* {{ field.about }} */
{% endfor %}
{% if uses_time %}
    posegsa_real time; /* since the first sample [s] */
{% endif %}
{% endblock %}
{% block checks %}

/* Whether none of n numbers is NaN. */
static inline int posegsa_are_numbers(const posegsa_real *x, int n)
{
    int i, nan = 0;
    for (i = 0; i < n; ++i) { /* no branches, so that compilers use vectors */
        nan |= x[i] != x[i];
    }
    return !nan;
}
{% endblock %}
{% block memory_is_fine %}
{% for field in memory %}
           posegsa_are_numbers({{ "" if field.size else "&" }}state->{{ field.name }}, {{ field.size or 1 }}) &&
{% endfor %}
           posegsa_are_finite(state->{{ "bias_angular" if attitude_only else "bias_linear" }}, 3);
{% endblock %}
{% block init_about %}
{% if start %}
/* Starts a filter. attitude: quaternion of any length but 0; position [m], inertial frame. The
 * covariance begins with standard deviations of {{ start.degrees }} deg about and {{ start.metres }} m along each axis: give a
 * pose whose error is at most a few of these{{ ", as posegsa_init_from does with good sensors" if "show" in calls }}. Returns
 * POSEGSA_OK, or an error code and does not change the state. */
{% else %}
{{ super() -}}
{% endif %}
{% endblock %}
{% block init_variables %}
    posegsa_state first, begun, *const next = &begun;
    const posegsa_state *const now = &first;
    posegsa_real largest = 0, square = 0;
    int i;
{% endblock %}
{% block init_state %}
{% if not attitude_only %}
    for (i = 0; i < 3; ++i) {
        first.position[i] = position[i];
    }
{% endif %}
{% if uses_time %}
    begun.time = 0;
{% endif %}
    {{ calls.start }}
    if (!posegsa_is_estimate(next)) {
        return POSEGSA_NOT_FINITE;
    }
    *state = begun;
{% endblock %}
{% block after %}
    posegsa_state after, *const next = &after; /* a step sets all of it */
{% endblock %}
{% block advance %}
{% if uses_reach %}
    for (i = 0; i < POSEGSA_LANDMARKS; ++i) {
        const posegsa_real *const y = seen->landmarks[i];
        farthest = posegsa_max(farthest, y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    }
{% endif %}

    {{ calls.advance }}
{% if uses_time %}
    next->time = now->time + dt;
{% endif %}

{% endblock %}
{% block step_variables %}
{% if uses_reach %}
    posegsa_real farthest = 0; /* square of the distance to the farthest landmark [m^2] */
    int i;
{% endif %}
{% endblock %}
{% block more_functions %}
{% if states %}

/* The variance of an error state of the Kalman filter, in its unit squared: of the attitude (i from
 * 0 to 2), the position (3 to 5), the biases of the angular velocity (6 to 8) and of the velocity (9
 * to 11){{ ", and then of the vectors' biases" if learns }}. */
static inline posegsa_real posegsa_variance(const posegsa_state *state, int i)
{
    return state->covariance[i * POSEGSA_ERROR_STATES - i * (i - 1) / 2];
}
{% endif %}
{% endblock %}
{% block more_counts %}
{% if states %}
    POSEGSA_ERROR_STATES = {{ states }},
{% endif %}
{% endblock %}
