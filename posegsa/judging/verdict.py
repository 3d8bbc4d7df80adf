"""What ends a comparison: which filter is best, by how much, by chance or not, what to do."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

TAKE_THIS = (
    "Take this filter: `posegsa export RUN --format c{options}` or "
    "`posegsa replay RUN FILE{options}`."
)
"""What to do if no other filter is better."""


class Loss(NamedTuple):
    """By how much another filter is better than the judged one, with its 95 % interval.

    The interval is NaN where there are too few data.
    """

    mean: float
    low: float
    high: float
    unit: str

    @property
    def known(self) -> bool:
        """Whether it has an interval."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def sure(self) -> bool:
        """Whether the other filter is better and the interval excludes 0."""
        return self.low > 0

    def words(self, label: str) -> str:
        """How much less or more the other filter errs; `label` is put before the interval."""
        more = f"{abs(self.mean):.3g} {self.unit} {'less' if self.mean > 0 else 'more'}"
        low, high = (self.low, self.high) if self.mean > 0 else (-self.high, -self.low)
        ends = f"{label}{low:.3g} to {high:.3g}" if self.known else "too few data for an interval"
        return f"{more} ({ends})"


def verdict(
    where: str,
    own: str,
    better: Mapping[str, Sequence[Loss]],
    others: Mapping[str, Sequence[Loss]],
    advice: Mapping[str, str],
    options: str = "",
) -> str:
    """A few sentences.

    Args:
        where: What the filters were judged on, such as "what was held out".
        own: The errors of the judged filter, such as "0.2 deg and 3 cm".
        better: The losses of the judged filter against each better one, the largest first.
        others: The same of the rest, the nearest first; of both at least one.
        advice: How to get a filter, by name.
        options: What the commands that take the judged filter need, such as " --frame NED".
    """
    if not better:
        (name, losses), *rest = others.items()
        even = all(loss.mean > 0 for loss in losses)  # by too little to matter
        also = f" Also compared: {', '.join(name for name, _ in rest)}." if rest else ""
        return (
            f"{'As good as any' if even else 'Best'} on {where}: this filter, {own}. The next, "
            f"{name}, errs {_listed(losses)}.{also} {TAKE_THIS.format(options=options)}"
        )
    (first, losses), *rest = better.items()
    then = "".join(f"; then {name}, {_listed(each)}" for name, each in rest)
    known = all(loss.known for loss in losses)
    if known and not any(loss.sure for loss in losses):
        return (
            f"On {where} no filter is surely better than this one, {own}. {_upper(first)} errs "
            f"{_listed(losses)}{then}. Judge on more data (`posegsa evaluate`) before you change."
        )
    todo = f"Take {'the first' if rest else 'it'}"
    todo += f": {advice[first]}." if first in advice else "."
    if not known:
        todo = "That may be chance: judge on more data (`posegsa evaluate`) before you change."
    return (
        f"Best on {where}: {first}, which errs {_listed(losses)} than this filter, {own}{then}. "
        f"{todo}"
    )


def _listed(losses: Sequence[Loss]) -> str:
    """The losses of one filter; the first interval says what it is."""
    first = next((loss for loss in losses if loss.known), None)
    *words, last = (loss.words("95 % interval " if loss is first else "") for loss in losses)
    return f"{', '.join(words)} and {last}" if words else last


def _upper(name: str) -> str:
    return name[0].upper() + name[1:]
