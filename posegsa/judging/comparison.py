"""Comparison of optimisers at equal budgets."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, JsonValue

from posegsa.judging.statistics import holm, signed_rank
from posegsa.settings.arrays import Cost
from posegsa.settings.fields import NonNegative
from posegsa.words import counted, text_table

DIGITS = 7
"""Significant digits that are kept of the costs over a search."""

_Positive = Annotated[int, Field(ge=1)]


class Repeat(NamedTuple):
    """One search of one optimiser."""

    cost: Cost
    """Best cost on the problem that was searched."""
    held_out: Cost | None
    """Cost of the same candidate on held-out scenarios; None if there are none."""
    position: list[float]
    seconds: NonNegative
    """Time of the search, without compilation."""
    compile_seconds: NonNegative
    non_finite: Annotated[int, Field(ge=0)]
    evaluations: Annotated[list[_Positive], Field(min_length=1)]
    """(n,) evaluations after some or all iterations; a gradient counts at its price."""
    best: list[Cost]
    """(n,) best cost so far after these evaluations."""
    times: list[NonNegative]
    """(n,) seconds since the start of the search, after these evaluations."""


class Gradients(NamedTuple):
    """How an optimiser uses gradients."""

    price: _Positive
    """Number of evaluations that one cost with its gradient counts as."""
    begin: Annotated[int, Field(ge=0)]
    """Evaluations before the first gradient."""


class Versus(NamedTuple):
    """A paired comparison of an optimiser with the first one, over repeats."""

    difference: float
    """Median of first minus this; below 0 the first is better."""
    p: float
    """p-value of the signed rank test, corrected for the number of optimisers (Holm)."""

    def __str__(self) -> str:
        return f"{self.difference:+.3g} ({'<0.001' if self.p < 0.001 else f'{self.p:.3f}'})"


@dataclass(frozen=True)
class OptimiserComparison:
    """Searches of the same problem with several optimisers, at the same number of evaluations."""

    subject: str
    """What was minimised, in words."""
    budget: _Positive
    """Evaluations per search."""
    settings: dict[str, JsonValue]
    """The settings that searches depend on; repeats are added to a file only if these are the
    same."""
    repeats: Annotated[dict[str, Annotated[list[Repeat], Field(min_length=1)]], Field(min_length=1)]
    """Repeats by optimiser; the others are compared with the first one."""
    gradients: dict[str, Gradients] = field(default_factory=dict)
    """For each optimiser that uses gradients."""
    environment: dict[str, str] = field(default_factory=dict)

    def only(self, names: Iterable[str]) -> "OptimiserComparison":
        """The same comparison with only some of the optimisers, in this order."""
        repeats = {name: self.repeats[name] for name in names}
        gradients = {name: self.gradients[name] for name in repeats if name in self.gradients}
        return replace(self, repeats=repeats, gradients=gradients)

    def disagreements(self) -> list[str]:
        """Fields that are valid one by one but don't fit together, as messages."""
        found = []
        for name, repeats in self.repeats.items():
            spent = repeats[0].evaluations
            if any(r.evaluations != spent for r in repeats):
                found.append(f"repeats.{name}: evaluations differ between repeats")
            if any({len(r.best), len(r.times)} != {len(spent)} for r in repeats):
                found.append(f"repeats.{name}: needs {len(spent)} of each of best and times")
            if name in self.gradients and self.gradients[name].begin >= spent[-1]:
                found.append(f"gradients.{name}.begin: must be below {spent[-1]} evaluations")
        return found

    def costs(self, name: str, *, held_out: bool = False) -> np.ndarray:
        """Final costs (repeats,) of an optimiser."""
        found = self.repeats[name]
        return np.array([r.held_out if held_out else r.cost for r in found], np.float64)

    @property
    def has_held_out(self) -> bool:
        """Whether every repeat was judged on held-out scenarios."""
        return all(r.held_out is not None for each in self.repeats.values() for r in each)

    def versus_first(self, *, held_out: bool = False) -> dict[str, Versus]:
        """Each other optimiser against the first, over the repeats that both have."""
        first, *others = self.repeats
        ours, found = self.costs(first, held_out=held_out), {}
        for name in others:
            theirs = self.costs(name, held_out=held_out)
            both = min(len(ours), len(theirs))
            with np.errstate(invalid="ignore"):
                difference = ours[:both] - theirs[:both]
            found[name] = np.nan_to_num(difference, nan=0.0, posinf=np.inf, neginf=-np.inf)
        corrected = holm([signed_rank(d) for d in found.values()])
        return {
            name: Versus(float(np.median(d)), p)
            for (name, d), p in zip(found.items(), corrected, strict=True)
        }

    def levels(self) -> list[float]:
        """Target costs: the largest, middle and lowest of the optimisers' median costs."""
        medians = sorted(float(np.median(self.costs(name))) for name in self.repeats)
        chosen = (medians[-1], medians[len(medians) // 2], medians[0])
        return sorted({m for m in chosen if math.isfinite(m)}, reverse=True)

    def reached(self, name: str, level: float) -> tuple[float, float, float]:
        """Median evaluations and seconds to a cost of at most `level`, and the share of repeats.

        Both medians are infinite if fewer than half of the repeats reached it.
        """
        evaluations, seconds = [], []
        rounding = 10.0 ** (1 - DIGITS) * abs(level)
        for repeat in self.repeats[name]:
            there = np.flatnonzero(np.asarray(repeat.best) <= level + rounding)
            evaluations.append(repeat.evaluations[there[0]] if there.size else math.inf)
            seconds.append(repeat.times[there[0]] if there.size else math.inf)
        # The lower of the two middle values: the mean of a number and infinity is infinite.
        median = partial(np.quantile, q=0.5, method="lower")
        share = float(np.mean(np.isfinite(evaluations)))
        return float(median(evaluations)), float(median(seconds)), share

    def bands(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Evaluations (n,) and quartiles (3, n) over repeats of the best cost so far."""
        found = self.repeats[name]
        best = np.array([r.best for r in found], np.float64)
        return np.array(found[0].evaluations), quantiles(best)

    def rows(self, levels: Sequence[float] | None = None) -> list[list[str]]:
        """The table, header first: a row for each optimiser, a column for each target cost."""
        levels = self.levels() if levels is None else levels
        minus = f"{next(iter(self.repeats))} minus this (p)"
        rows = [["optimiser", "repeats", "cost, median [quartiles]", "best", minus]]
        if self.has_held_out:
            rows[0] += ["held out", minus]
        rows[0] += [*(f"to {level:.5g}" for level in levels), "s"]
        training = self.versus_first()
        unseen = self.versus_first(held_out=True) if self.has_held_out else {}
        for name, repeats in self.repeats.items():
            costs = self.costs(name)
            row = [name, str(len(repeats)), _quartiles(costs), f"{costs.min():.5g}"]
            row.append(str(training.get(name, "-")))
            if self.has_held_out:
                row += [_quartiles(self.costs(name, held_out=True)), str(unseen.get(name, "-"))]
            row += [_reached(*self.reached(name, level)) for level in levels]
            rows.append([*row, f"{np.median([r.seconds for r in repeats]):.3g}"])
        return rows

    def table(self, levels: Sequence[float] | None = None) -> str:
        """The comparison as text."""
        return "\n\n".join([self.heading(), text_table(self.rows(levels)), self.notes()])

    def markdown(self, levels: Sequence[float] | None = None) -> str:
        """The comparison as a Markdown table."""
        head, *rows = self.rows(levels)
        lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
        return "\n\n".join([self.heading(), "\n".join(lines), self.notes()])

    def heading(self) -> str:
        """What was compared, in one line."""
        made = [len(repeats) for repeats in self.repeats.values()]
        few, many = min(made), max(made)
        count = counted(few, "repeat") if few == many else f"{few} to {many} repeats"
        return f"{self.subject}: {count} of {counted(self.budget, 'evaluation')} each."

    def notes(self) -> str:
        """How to read the table."""
        first = next(iter(self.repeats))
        lines = [
            f"In the columns '{first} minus this', below 0 {first} is better: median over the "
            "repeats, and p of Wilcoxon's signed rank test, corrected for the number of optimisers "
            "(Holm). 'to C': median evaluations (and seconds) until the cost is at most C; '-' "
            "where fewer than half of the repeats got there.",
        ]
        # Time of one evaluation, from the fastest optimiser without gradients.
        plain = [repeats for name, repeats in self.repeats.items() if name not in self.gradients]
        each = ([r.seconds / r.evaluations[-1] for r in repeats] for repeats in plain)
        quickest = float(min(map(np.median, each), default=0))
        for name in filter(self.gradients.get, self.repeats):
            price, measured = self.gradients[name].price, self.gradient_seconds(name)
            lines.append(
                f"{name}: a cost with its gradient counts as {counted(price, 'evaluation')}; it "
                f"took {1000 * measured:.3g} ms"
                + (f", as long as {measured / quickest:.3g}." if quickest else ".")
            )
        return "\n".join(lines)

    def gradient_seconds(self, name: str) -> float:
        """Time of one cost with its gradient [s], for an optimiser that uses gradients."""
        price, begin = self.gradients[name]
        per = []
        for r in self.repeats[name]:
            start = np.interp(begin, [0, *r.evaluations], [0.0, *r.times])
            per.append((r.times[-1] - start) * price / (r.evaluations[-1] - begin))
        return float(np.median(per))


def quantiles(values: np.ndarray) -> np.ndarray:
    """Quartiles (3, ...) over the first axis; infinite between two infinite values."""
    share = (0.25, 0.5, 0.75)
    below = np.quantile(values, share, axis=0, method="lower")
    with np.errstate(invalid="ignore"):
        between = np.quantile(values, share, axis=0)
    # NumPy's interpolation returns NaN between two infinities, or a number and infinity.
    beyond = np.where(np.isinf(below), below, np.inf)
    exact = below == np.quantile(values, share, axis=0, method="higher")
    return np.where(exact, below, np.where(np.isnan(between), beyond, between))


def _quartiles(values: np.ndarray) -> str:
    low, median, high = quantiles(values)
    return f"{median:.5g} [{low:.5g}, {high:.5g}]"


def _reached(evaluations: float, seconds: float, share: float) -> str:
    if not math.isfinite(evaluations):
        return "-" if share == 0 else f"- ({100 * share:.0f} %)"
    return f"{evaluations:.0f} ({seconds:.2g} s)"
