/*
 * Fuzzy gain schedule of a pose filter on SE(3), as C99; also valid C++.
{{ origin }}
 *
{{ costs }}
 *
 * DESCRIPTION
 * posegsa_gain(error, rate, last_gain) is the gain K [1/s] of the filter's innovation, before the
 * filter's gain limit. error and rate have no unit and are clipped to [0, 1]. last_gain [1/s] is
 * the result of the last call; for the first call it is posegsa_initial_gain().
{{ inference }}
 *
 * HOW error AND rate ARE COMPUTED, once per sample, from the estimate before its update
{{ signal }}
 *
 * USE
 *     gain = posegsa_initial_gain();
 *     for each sample: gain = posegsa_gain(error, rate, gain);
 *
 * NaN AND INFINITE INPUT
 * The result is never NaN. If error or rate is NaN, it is last_gain. If last_gain is NaN,
 * posegsa_initial_gain() replaces it. Infinite error or rate is clipped. With -ffast-math a
 * compiler may remove the checks for NaN.
 *
 * PRECISION
 * POSEGSA_REAL is double; compile with -DPOSEGSA_REAL=float for single precision. No headers, no
 * allocation, no state: it may be called from threads and interrupts.
 *
 * THE FILTER THAT IT WAS TUNED WITH; the gains may not suit another one
{{ filter }}
 *
 * PARAMETERS
{{ parameters }}
 */

{% include 'numbers.c' %}
/* Gain K [1/s] from the scaled error and its scaled rate; last_gain: the previous gain [1/s]. */
posegsa_real posegsa_gain(posegsa_real error, posegsa_real rate, posegsa_real last_gain);

/* last_gain for the first sample [1/s]: the offset + the middle of the output range. */
posegsa_real posegsa_initial_gain(void);

{% include 'controller.c' %}
