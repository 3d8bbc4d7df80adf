"""Results of a sweep: its runs, and a summary for each setting over seeds."""

import hashlib
import json
import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, JsonValue

from posegsa.arguments import MAX_INTEGER
from posegsa.config import Experiment
from posegsa.judging.description import StoredFilter
from posegsa.settings.arrays import Cost
from posegsa.settings.fields import NonNegative
from posegsa.settings.plain import csv_text
from posegsa.words import counted, text_table, toml

SEED = "run.seed"
"""The key of the seed, over which the runs of a setting are averaged."""

Values = dict[str, JsonValue]
"""The varied settings: the value of each key, as in TOML and JSON."""


@dataclass(frozen=True, kw_only=True)
class SweepRun:
    """One search of a sweep, and the costs of its best candidate."""

    base: Experiment
    """The settings that are not varied."""
    values: Values
    """The varied settings by key, in the order of the table's columns."""
    seed: Annotated[int, Field(ge=0, le=MAX_INTEGER)]
    training_cost: Cost
    """Mean over the training scenarios; infinite where it diverged."""
    held_out_cost: Cost
    """Mean over the held-out scenarios."""
    held_out_worst: Cost
    diverged: Annotated[int, Field(ge=0)]
    """Number of held-out scenarios on which it diverged."""
    filter: StoredFilter
    """The filter that was found."""
    search_seconds: NonNegative
    """This run's share of the time of its batch."""
    environment: dict[str, str]
    version: str

    @property
    def experiment(self) -> Experiment:
        """The experiment of this run.

        Raises:
            ConfigError: The experiment can't have these values.
        """
        return with_values(self.base, self.values, self.seed)


def with_values(base: Experiment, values: Values, seed: int) -> Experiment:
    """An experiment with the values of one run of a sweep.

    Raises:
        ConfigError: The experiment can't have these values.
    """
    return base.replace(**{**values, SEED: seed})


def run_name(experiment: Experiment) -> str:
    """A name that is unique to the run of this experiment."""
    text = json.dumps(experiment.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class SweepRow(NamedTuple):
    """The runs of one setting, over seeds."""

    values: Values
    seeds: int
    training: "Spread"
    held_out: "Spread"
    diverged: int
    """Number of held-out scenarios on which it diverged, over all seeds."""


class Spread(NamedTuple):
    """Costs of several seeds."""

    mean: float
    deviation: float
    """Standard deviation; NaN for a single seed, or if a cost is infinite."""
    least: float
    most: float


def spread(costs: list[float]) -> Spread:
    """The spread of costs (n,) over n seeds."""
    known = len(costs) > 1 and all(map(math.isfinite, costs))
    return Spread(
        mean=float(np.mean(costs)),
        deviation=float(np.std(costs, ddof=1)) if known else math.nan,
        least=min(costs),
        most=max(costs),
    )


@dataclass(frozen=True)
class Sweep:
    """Runs that differ in the values of some keys, and in their seeds."""

    runs: tuple[SweepRun, ...]
    """The runs, at least one, in the order of their values; everything else is the same for all."""

    @property
    def keys(self) -> list[str]:
        """The varied keys."""
        return list(self.runs[0].values)

    def rows(self) -> list[SweepRow]:
        """A row for each setting, in the order of their first runs."""
        settings: dict[str, list[SweepRun]] = {}
        for run in self.runs:
            settings.setdefault(json.dumps(run.values), []).append(run)
        return [
            SweepRow(
                values=runs[0].values,
                seeds=len(runs),
                training=spread([run.training_cost for run in runs]),
                held_out=spread([run.held_out_cost for run in runs]),
                diverged=sum(run.diverged for run in runs),
            )
            for runs in settings.values()
        ]

    def table(self) -> str:
        """The settings as text: mean cost and standard deviation over seeds."""
        heads = ("seeds", "training", "± sd", "held out", "± sd", "least", "most", "diverged")
        rows = [[*self.keys, *heads]]
        for row in self.rows():
            own, unseen = row.training, row.held_out
            costs = (own.mean, own.deviation, *unseen)
            cells = ["" if math.isnan(cost) else f"{cost:.4g}" for cost in costs]
            shown = map(shown_value, row.values.values())
            rows.append([*shown, str(row.seeds), *cells, str(row.diverged)])
        title = f"{counted(len(self.runs), 'run')}; costs are means over scenarios, then seeds:"
        return f"{title}\n\n{text_table(rows)}"

    def csv(self) -> str:
        """The settings as CSV, with all digits."""
        names = [f"{of}_{what}" for of in ("training", "held_out") for what in Spread._fields]
        rows = [
            [*_cells(row.values), row.seeds, *row.training, *row.held_out, row.diverged]
            for row in self.rows()
        ]
        return csv_text([*self.keys, "seeds", *names, "diverged"], rows)

    def runs_csv(self) -> str:
        """The runs as CSV, with all digits."""
        names = ("training_cost", "held_out_cost", "held_out_worst", "diverged", "search_seconds")
        rows = [
            [*_cells(run.values), run.seed, *(getattr(run, name) for name in names)]
            for run in self.runs
        ]
        return csv_text([*self.keys, "seed", *names], rows)


def _cells(values: Values) -> list[JsonValue]:
    """Values as cells of a CSV file; an array is written as in TOML."""
    return [toml(one) if isinstance(one, list | dict) else one for one in values.values()]


def shown_value(value: JsonValue) -> str:
    """A value as in TOML, but text without its quotes."""
    return value if isinstance(value, str) else toml(value)
