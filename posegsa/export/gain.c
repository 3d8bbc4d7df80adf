/*
 * Fuzzy gain schedule of a pose filter on SE(3), as C99; also valid C++.
{{ origin }}
 *
{{ costs }}
 *
 * WHAT IT COMPUTES
 * posegsa_gain(error, rate, last_gain) is the gain K [1/s] that the filter multiplies its
 * innovation with, before a limit of its own. error and rate have no unit and are clipped to
 * [0, 1]; last_gain [1/s] is what the last call returned, posegsa_initial_gain() before the first.
{{ inference }}
 *
 * HOW error AND rate ARE FORMED, once a sample, with the estimate before its update
{{ signal }}
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
{{ filter }}
 *
 * PARAMETERS
{{ parameters }}
 */

{% include 'numbers.c' %}
/* Gain K [1/s] of the scaled error and its scaled rate; last_gain is the one before [1/s]. */
posegsa_real posegsa_gain(posegsa_real error, posegsa_real rate, posegsa_real last_gain);

/* What last_gain is at the first sample [1/s]: the offset + the middle of the output range. */
posegsa_real posegsa_initial_gain(void);

{% include 'controller.c' %}
