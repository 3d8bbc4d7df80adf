"""The signed rank test against its definition, and Holm's correction by hand."""

import numpy as np
import pytest
from scipy.stats import rankdata

from posegsa.judging.statistics import holm, signed_rank

pytestmark = pytest.mark.quick


def exact(differences: np.ndarray) -> float:
    """The p-value by counting all choices of signs, rank by rank; ranks are doubled integers."""
    d = differences[differences != 0]
    ranks = (2 * rankdata(np.abs(d))).astype(int)
    share = np.ones(1)  # number of choices whose positive ranks add up to 0, 1, ...
    for rank in ranks:
        share = 0.5 * (np.append(share, np.zeros(rank)) + np.append(np.zeros(rank), share))
    observed = ranks[d > 0].sum()
    return min(1.0, 2 * min(share[: observed + 1].sum(), share[observed:].sum()))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 12, 20, 50])
def test_p_is_exact_without_ties(count: int) -> None:
    rng = np.random.default_rng(count)
    for shift in (0, 0.3, 2):
        d = rng.normal(shift, size=count)
        assert signed_rank(d) == pytest.approx(exact(d), rel=1e-10)
        assert signed_rank(np.append(d, [0, 0])) == signed_rank(d), "zeros are left out"


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6, 9, 13])
def test_p_is_exact_with_ties_among_few(count: int) -> None:
    rng = np.random.default_rng(count)
    for shift in (0, 0.6, 2) if count < 13 else (0.6,):  # all choices of 13 signs take a while
        d = np.round(rng.normal(shift, size=count), 1)
        d[rng.random(count) < 0.2] = rng.choice([-np.inf, np.inf])
        assert signed_rank(d) == pytest.approx(exact(d), rel=1e-10)


def test_p_with_ties_among_many_errs_little_and_never_claims_too_much() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        d = np.round(rng.normal(rng.uniform(-1, 1), size=20), 1)
        assert signed_rank(d) == pytest.approx(exact(d), abs=0.02)
        assert signed_rank(d) > 0.9 * exact(d)


def test_infinite_differences_rank_last_and_nan_is_refused() -> None:
    assert signed_rank([1, -2, np.inf]) == signed_rank([1, -2, 3])
    assert signed_rank([0, 0]) == 1
    with pytest.raises(ValueError, match="NaN"):
        signed_rank([1, np.nan])


def test_holm_by_hand() -> None:
    # 4 x 0.01, 3 x 0.02, 2 x 0.03; each at least the one before.
    assert holm([0.03, 0.01, 0.9, 0.02]) == pytest.approx([0.06, 0.04, 0.9, 0.06])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    assert holm([]) == []
