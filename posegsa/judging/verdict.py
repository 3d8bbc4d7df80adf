"""The sentence that ends a comparison: what is best, by how much, by chance or not, what to do."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

TAKE_THIS = (
    "take this filter, `posegsa export RUN --format c{options}` or "
    "`posegsa replay RUN FILE{options}`"
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
    def sure(self) -> bool:
        """Whether the interval excludes 0."""
        return self.low > 0 or self.high < 0

    @property
    def size(self) -> str:
        """How much less or more the other filter errs."""
        return f"{abs(self.mean):.3g} {self.unit} {'less' if self.mean > 0 else 'more'}"

    @property
    def interval(self) -> str:
        """Its ends, of the size."""
        low, high = (self.low, self.high) if self.mean > 0 else (-self.high, -self.low)
        return f"{low:.3g} to {high:.3g}"

    def __str__(self) -> str:
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            return f"{self.size} (too few data for an interval)"
        return f"{self.size} ({self.interval}, {'excludes' if self.sure else 'includes'} 0)"


def verdict(
    where: str,
    own: str,
    better: Mapping[str, Sequence[Loss]],
    others: Mapping[str, Sequence[Loss]],
    advice: Mapping[str, str],
    options: str = "",
) -> str:
    """The sentence.

    Args:
        where: What the filters were judged on, such as "what was held out".
        own: The errors of the judged filter, such as "0.2 deg and 3 cm".
        better: The losses of the judged filter against each better one, the largest first.
        others: The same of the rest, the nearest first; of both at least one.
        advice: How to get a filter, by name.
        options: What the commands that take the judged filter need, such as " --frame NED".
    """
    if not better:
        name, losses = next(iter(others.items()))
        beside = f", beside {', '.join(list(others)[1:])}" if len(others) > 1 else ""
        even = all(loss.mean > 0 for loss in losses)  # by too little to matter
        return (
            f"{'As good as any' if even else 'Best'} on {where}: this filter, {own}; the next, "
            f"{name}{beside}, errs {_listed(losses)}{_intervals(losses)}: "
            f"{TAKE_THIS.format(options=options)}."
        )
    (first, losses), *rest = better.items()
    then = "".join(f"; then {name}, {_listed(each)}" for name, each in rest)
    known = all(math.isfinite(loss.low) for loss in losses)
    if known and not any(loss.sure and loss.mean > 0 for loss in losses):
        ends = [loss.interval for loss in losses]
        return (
            f"On {where} no filter is surely better than this one, {own}. {_upper(first)} errs "
            f"{_joined([loss.size for loss in losses])} (95 % interval{'s' * (len(ends) > 1)}: "
            f"{', '.join(ends)}){then}. Judge on more data "
            "(`posegsa evaluate`) before you change."
        )
    how = f", {advice[first]}" if first in advice else ""
    todo = f"take the first{how}" if rest else f"take it{how}"
    if not known:
        todo = "that may be chance, so judge on more data (`posegsa evaluate`) before you change"
    return (
        f"Best on {where}: {first}, which errs {_listed(losses)} than this filter, {own}{then}"
        f"{_intervals(losses)}: {todo}."
    )


def _intervals(losses: Sequence[Loss]) -> str:
    return ", with 95 % intervals" if any(math.isfinite(loss.low) for loss in losses) else ""


def _listed(losses: Sequence[Loss]) -> str:
    return _joined(list(map(str, losses)))


def _joined(words: Sequence[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def _upper(name: str) -> str:
    return name[0].upper() + name[1:]
