"""The results of many searches, and their spread."""

from dataclasses import dataclass

import numpy as np

from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.result import TuneResult
from posegsa.words import counted, text_table


@dataclass(frozen=True)
class TuneBatch:
    """Results of a batch, in the order of its experiments and seeds."""

    results: tuple[TuneResult, ...]

    def summary(self) -> str:
        """Median and range over the batch, of training beside held-out cost."""
        costs = {f"{TUNED}, training": [float(np.mean(r.training_costs)) for r in self.results]}
        for name in (TUNED, CONSTANT):
            costs[f"{name}, held out"] = [r.evaluation.cost(name).mean for r in self.results]
        rows = [[counted(len(self.results), "search", "searches"), "median", "minimum", "maximum"]]
        for name, each in costs.items():
            rows.append([name, *(f"{of(each):.4g}" for of in (np.median, np.min, np.max))])
        return text_table(rows)
