"""The usual mistakes in recordings, found by undoing each of them on trial.

Each hypothesis (`hypotheses`) undoes one mistake. The misfits of all relations (`relations`) are
computed for the quantities as recorded and as the hypothesis changes them. A hypothesis that lowers
them by far, on the whole, is named; nothing is corrected.
"""

import math
import re

from posegsa.recordings.hypotheses import MAX_MISFIT, Hypothesis, hypotheses
from posegsa.recordings.relations import AXES, Quantities, misfits

MIN_RATIO = 2.5
"""Ratio of misfits, of the relation that improves most, above which a hypothesis is named."""
MAX_SHOWN_RATIO = 100.0
"""Ratio that is not told more precisely."""
MAX_MISTAKES = 6
"""Mistakes that are looked for, one after the other."""
SUSPICIOUS_MISFIT = 0.06
"""Misfit with the truth up to which no mistake is looked for; for other relations, whose noise is
not averaged, twice that."""
AS_GOOD_SHARE = 0.85
"""Share of the largest improvement above which a simpler hypothesis is preferred."""


def mistakes(q: Quantities) -> list[str]:
    """The mistakes that quantities seem to have, in words, the clearest first.

    Once one is found, the search continues on the corrected quantities.
    """
    found: list[str] = []
    for _ in range(MAX_MISTAKES):
        best = _clearest(q)
        if best is None:
            break
        hypothesis, ratio = best
        times = f"{ratio:.2g}" if ratio < 10 else f"{ratio:.0f}"
        times = times if ratio < MAX_SHOWN_RATIO else f"over {MAX_SHOWN_RATIO:g}"
        found.append(f"{hypothesis.words} (fits {times} times better)")
        q = hypothesis.mended(q)
    return found


def _clearest(q: Quantities) -> tuple[Hypothesis, float] | None:
    """The mistake, and the ratio by which the misfit of the most improved relation falls."""
    before = misfits(q)
    tried: list[tuple[float, float, float, Hypothesis]] = []
    suspicious = [name for name, misfit in before.items() if misfit > _usual(name)]
    for hypothesis in hypotheses(q):
        if not any(re.search(hypothesis.of, name) for name in suspicious):
            continue
        after = misfits(hypothesis.mended(q))
        gains = {
            name: math.log(before[name] / after[name])
            for name in before
            if name in after and math.isfinite(before[name]) and after[name] > 0
        }
        if not gains:
            continue
        name = max(gains, key=gains.__getitem__)
        tried.append((sum(gains.values()), gains[name], after[name], hypothesis))
    least = math.log(MIN_RATIO)
    tried = [one for one in tried if min(one[0], one[1]) > least and one[2] < one[3].fits]
    if not tried:
        return None
    most = max(total for total, *_ in tried)
    near = [one for one in tried if one[0] >= AS_GOOD_SHARE * most]
    _, largest, _, hypothesis = min(near, key=lambda one: (one[3].complexity, -one[0]))
    return hypothesis, math.exp(largest)


def _usual(relation: str) -> float:
    """Misfit of a relation up to which no mistake is looked for."""
    if re.search(f", [{AXES}], ", relation):
        return MIN_RATIO * MAX_MISFIT  # of one axis, relative to its changes, which may be small
    return SUSPICIOUS_MISFIT if "truth" in relation else 2 * SUSPICIOUS_MISFIT
