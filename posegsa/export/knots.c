/* ---- The gain as a function of time ---------------------------------------------------------- */

/* Times of the knots since the first sample [s], and the logarithm of the gain [1/s] there. */
enum { POSEGSA_KNOTS = {{ count }} };
static const posegsa_real posegsa_knot_times[POSEGSA_KNOTS] = {
{{ times }}
};
static const posegsa_real posegsa_knot_log_gains[POSEGSA_KNOTS] = {
{{ log_gains }}
};

/* The gain [1/s] at a time: its logarithm is linear between knots and constant outside them. */
static inline posegsa_real posegsa_gain_at(posegsa_real time)
{
    const posegsa_real *const t = posegsa_knot_times, *const log_gain = posegsa_knot_log_gains;
    int low = 0, high = POSEGSA_KNOTS - 1;
    if (!(time > t[low])) {
        return posegsa_exp(log_gain[low]);
    }
    if (!(time < t[high])) {
        return posegsa_exp(log_gain[high]);
    }
    while (high - low > 1) {
        const int middle = low + (high - low) / 2;
        if (time < t[middle]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return posegsa_exp(log_gain[low] + (time - t[low]) / (t[high] - t[low]) *
                                           (log_gain[high] - log_gain[low]));
}
