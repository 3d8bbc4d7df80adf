"""Significance of paired differences: Wilcoxon's test and Holm's correction.

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

    The test is exact for up to 50 differences without ties, and for up to 13 with ties. Above that
    it uses the normal approximation, corrected for ties. Differences of 0 are left out, as in the
    source; if no others remain, p is 1. Infinite differences rank above all finite ones.

    Raises:
        ValueError: If a difference is NaN.
    """
    values = np.asarray(differences, np.float64)
    if np.isnan(values).any():
        raise ValueError("differences: NaN; allowed: numbers, or infinities")
    values = values[values != 0]
    if len(values) == 0:
        return 1.0
    from scipy.stats import wilcoxon  # imported here: it takes a second to load

    test: Any = wilcoxon(values)
    return float(test.pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for multiple tests: below 0.05, each is significant at that level."""
    p = np.asarray(p_values, np.float64)
    order, corrected = np.argsort(p, kind="stable"), np.empty(len(p))
    scaled = p[order] * np.arange(len(p), 0, -1)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return corrected.tolist()
