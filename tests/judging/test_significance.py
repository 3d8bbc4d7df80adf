"""The signed rank test against scipy's, and Holm's correction by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from posegsa.judging.statistics import holm, signed_rank


@pytest.mark.parametrize("count", [1, 2, 5, 12, 20])
def test_p_against_scipys_exact_one(count: int) -> None:
    rng = np.random.default_rng(count)
    for shift in (0, 0.3, 2):
        d = rng.normal(shift, size=count)
        assert signed_rank(d) == pytest.approx(stats.wilcoxon(d, method="exact").pvalue, rel=1e-12)


@given(st.lists(st.integers(-4, 4), min_size=1, max_size=9))
def test_p_with_ties_against_all_sign_choices(values: list[int]) -> None:
    d = np.array([v for v in values if v])
    ranks = stats.rankdata(np.abs(d))
    signs = np.array(np.meshgrid(*[[0, 1]] * len(d))).reshape(len(d), -1) if len(d) else None
    expected = 1.0
    if signs is not None:
        sums, observed = ranks @ signs, ranks[d > 0].sum()
        tails = np.mean(sums <= observed), np.mean(sums >= observed)
        expected = min(1.0, 2 * min(tails))
    assert signed_rank(values) == pytest.approx(expected, rel=1e-12)


def test_infinite_differences_rank_last_and_nan_is_refused() -> None:
    assert signed_rank([1, -2, np.inf]) == signed_rank([1, -2, 3])
    assert signed_rank([0, 0]) == 1
    with pytest.raises(ValueError, match="NaN"):
        signed_rank([1, np.nan])


def test_holm_by_hand() -> None:
    # 4 x 0.01, 3 x 0.02, 2 x 0.03, then never less than the one before.
    assert holm([0.03, 0.01, 0.9, 0.02]) == pytest.approx([0.06, 0.04, 0.9, 0.06])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    assert holm([]) == []
