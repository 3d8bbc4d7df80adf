"""Whether paired differences are more than chance: Wilcoxon's test, and Holm's correction.

Sources: F. Wilcoxon, "Individual Comparisons by Ranking Methods", Biometrics Bulletin 1 (1945)
80-83; S. Holm, "A Simple Sequentially Rejective Multiple Test Procedure", Scandinavian Journal of
Statistics 6 (1979) 65-70.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def signed_rank(differences: ArrayLike) -> float:
    """Two-sided p-value of Wilcoxon's signed rank test that paired differences centre on 0.

    It is exact, for tied ranks too: the distribution of the rank sum over all 2^n choices of signs
    is counted up rank by rank. Differences of 0 are left out, as in the source; without any other,
    p is 1.

    Args:
        differences: (n,); infinite ones rank above all finite ones, NaN is refused.

    Raises:
        ValueError: If a difference is NaN.
    """
    values = np.asarray(differences, np.float64)
    if np.isnan(values).any():
        raise ValueError("differences: NaN; allowed: numbers, or infinities")
    values = values[values != 0]
    doubled = _doubled_ranks(np.abs(values))
    ways = np.ones(1)
    for rank in doubled:  # ways[s]: share of the sign choices whose positive ranks add up to s
        ways = 0.5 * (np.append(ways, np.zeros(rank)) + np.append(np.zeros(rank), ways))
    observed = int(doubled[values > 0].sum())
    tail = min(ways[: observed + 1].sum(), ways[observed:].sum())
    return float(min(1.0, 2 * tail))


def _doubled_ranks(values: np.ndarray) -> np.ndarray:
    """Twice the ranks from 1, the mean rank where values are equal; integers (n,)."""
    _, group, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return (2 * last - counts + 1)[group]


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number: below 0.05, each may be believed at that level."""
    order = np.argsort(p_values, kind="stable")
    count, corrected, largest = len(p_values), [1.0] * len(p_values), 0.0
    for place, i in enumerate(order):
        largest = max(largest, min(1.0, (count - place) * float(p_values[i])))
        corrected[i] = largest
    return corrected
