"""Defaults that the command line's help shows too; in a file of their own, quick to import."""

SCENARIOS = 1000
"""Held-out scenarios of `evaluate`."""
REPEATS = 20
"""Searches of each optimiser of `compare`."""
EVALUATIONS = 25000
"""Evaluations of each of these searches."""
TOGETHER = 16
"""Maximum number of searches in a batch of `sweep`; stopping a sweep loses one batch."""
