"""Defaults of the jobs that the command line's help states too; apart, as help imports no job."""

SCENARIOS = 1000
"""Held-out scenarios of `evaluate`."""
REPEATS = 20
"""Searches of each optimiser of `compare`."""
EVALUATIONS = 25000
"""Evaluations of each of these searches."""
TOGETHER = 16
"""Searches of one batch of `sweep`, at most: what is lost where a sweep is stopped."""
