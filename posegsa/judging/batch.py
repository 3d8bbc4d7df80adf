"""The results of many searches, and their spread."""

from dataclasses import dataclass

import numpy as np

from posegsa.judging.evaluation import CONSTANT, TUNED
from posegsa.judging.result import TuneResult


@dataclass(frozen=True)
class TuneBatch:
    """Results of a batch, in the order of its experiments and seeds."""

    results: tuple[TuneResult, ...]

    def summary(self) -> str:
        """Median and range over the batch, of training beside held-out cost."""

        def row(label: str, values: list[float]) -> str:
            return (
                f"  {label:<34}{np.median(values):>10.4g}{min(values):>10.4g}{max(values):>10.4g}"
            )

        def held_out(name: str) -> list[float]:
            return [r.evaluation.cost(name).mean for r in self.results]

        count = f"{len(self.results)} searches"
        rows = [
            f"  {count:<34}{'median':>10}{'minimum':>10}{'maximum':>10}",
            row(f"{TUNED}, training", [float(np.mean(r.training_costs)) for r in self.results]),
            row(f"{TUNED}, held out", held_out(TUNED)),
            row(f"{CONSTANT}, held out", held_out(CONSTANT)),
        ]
        return "\n".join(rows)
