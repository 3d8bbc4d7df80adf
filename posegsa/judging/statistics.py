"""Whether paired differences are more than chance: Wilcoxon's test, and Holm's correction.

Sources: F. Wilcoxon, "Individual Comparisons by Ranking Methods", Biometrics Bulletin 1 (1945)
80-83; S. Holm, "A Simple Sequentially Rejective Multiple Test Procedure", Scandinavian Journal of
Statistics 6 (1979) 65-70.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def signed_rank(differences: ArrayLike) -> float:
    """Two-sided p-value of Wilcoxon's signed rank test that paired differences centre on 0.

    Exact for up to 50 differences of unequal size, and for up to 13 where some are equal; by the
    normal approximation, corrected for ties, for more. Differences of 0 are left out, as in the
    source; without any other, p is 1. Infinite ones rank above all finite ones.

    Raises:
        ValueError: If a difference is NaN.
    """
    values = np.asarray(differences, np.float64)
    if np.isnan(values).any():
        raise ValueError("differences: NaN; allowed: numbers, or infinities")
    values = values[values != 0]
    if len(values) == 0:
        return 1.0
    from scipy.stats import wilcoxon  # takes a second to load, which nothing else needs

    test: Any = wilcoxon(values)
    return float(test.pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number: below 0.05, each may be believed at that level."""
    p = np.asarray(p_values, np.float64)
    order, corrected = np.argsort(p, kind="stable"), np.empty(len(p))
    scaled = p[order] * np.arange(len(p), 0, -1)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return corrected.tolist()
