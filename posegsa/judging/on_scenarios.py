"""The performance of a tuned filter on drawn scenarios."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from posegsa.judging.endurance import Endurance
from posegsa.judging.evaluation import CLAIRVOYANT, UNTUNED, Evaluation, called
from posegsa.judging.trajectory import Trajectory
from posegsa.judging.trust import Trust
from posegsa.settings.arrays import Numbers
from posegsa.words import counted, text_table

Costs = Annotated[np.ndarray, Numbers("training scenarios", allow="infinite")]

SURE_ENOUGH = 0.9
"""Below this share of samples inside the 95 % bound, a covariance is called too small."""


@dataclass(frozen=True, kw_only=True)
class OnScenarios:
    """A tuned filter on drawn scenarios, compared with others."""

    training: dict[str, Costs]
    """(S,) cost on each training scenario, infinite where a run diverged: of the tuned filter, and
    of the one filter that is always compared with it."""
    evaluation: Evaluation
    """Both filters, an untuned Kalman filter (after `evaluate`, all baselines) and the clairvoyant
    on held-out scenarios."""
    endurance: Endurance | None
    """Both filters long after the time that they were tuned for; None if that was not run."""
    trust: Trust
    trajectory: Trajectory
    """The tuned filter on the first held-out scenario."""

    @property
    def beside(self) -> str:
        """The name of the filter that the judged one is always compared with."""
        return next(name for name in self.training if name != self.evaluation.own)

    def text(self, endurance_scenarios: int) -> str:
        """A short text.

        Args:
            endurance_scenarios: Number of the longer scenarios that the filters were run on.
        """
        last = self.trajectory
        settled = last.time >= 0.5 * last.time[-1]
        unseen = f"({counted(self.evaluation.scenarios, 'unseen scenario')})"
        rows = [["mean cost", "training", "held out", "worst", unseen]]
        for name, training in self.training.items():
            found = self.evaluation.contenders[name]
            gain = found.filter.numbers.get("gain", [])
            label = f"{name} {gain[0]:.4g}/s" if gain and name != self.evaluation.own else name
            costs = (np.mean(training), np.mean(found.metrics.cost), np.max(found.metrics.cost))
            bad = np.count_nonzero(found.metrics.diverged)
            rows.append([label, *(f"{c:.4g}" for c in costs), f"diverged on {bad}" if bad else ""])
        costs = self.evaluation.costs
        rows += [
            [name, "", f"{np.mean(costs[name]):.4g}", f"{np.max(costs[name]):.4g}", ""]
            for name in (UNTUNED, CLAIRVOYANT)
            if name in costs
        ]
        one_run = (
            "On one unseen scenario, second half: attitude error "
            f"{_rms(last.attitude_error[settled]):.2f} deg RMS, distance |P_est - P| "
            f"{100 * _rms(last.distance[settled]):.1f} cm RMS (the cost's position error, "
            f"|P_est - R_err P|: {100 * _rms(last.position_error[settled]):.1f} cm)."
        )
        if last.lost is not None:
            one_run = (
                f"On one unseen scenario the estimate is not finite from {last.lost:.4g} s on."
            )
        parts = [text_table(rows), one_run]
        if long_after := self.long_after(endurance_scenarios):
            parts.append(long_after)
        if sure := self.too_sure():
            parts.append(sure)
        if self.trust.rule_weights is not None:
            parts.append(
                f"{self.trust.used_rules} of {self.trust.rule_weights.size} rules carry 1 % or "
                "more of the weight."
            )
        return "\n\n".join(parts)

    def long_after(self, scenarios: int) -> str:
        """Both filters long after the time that they were tuned for, as text; "" if not run.

        Args:
            scenarios: Number of the longer scenarios.
        """
        if self.endurance is None:
            return ""
        return self.endurance.table((self.evaluation.own, self.beside), scenarios)

    def too_sure(self) -> str:
        """That the judged filter's covariance is too small, in words; "" if it is not."""
        own = self.evaluation.own
        inside, beside = (
            float(np.mean(self.evaluation.contenders[name].metrics.nees_inside))
            for name in (own, self.beside)
        )
        if not inside < SURE_ENOUGH:  # nor without a covariance, where it is NaN
            return ""
        other = "" if np.isnan(beside) else f" ({self.beside}: {100 * beside:.0f} %)"
        return (
            f"{called(own).capitalize()} is too sure: once settled, the true pose is inside its "
            f"95 % bound at {100 * inside:.0f} % of the samples{other}. Do not trust its "
            "covariance."
        )

    def not_finite(self) -> str:
        """On how many scenarios the judged filter has no finite cost, in words; "" if on none."""
        own = self.evaluation.own
        costs = {"training": self.training[own], "held-out": self.evaluation.costs[own]}
        each = [
            f"{bad} of {counted(len(some), f'{words} scenario')}"
            for words, some in costs.items()
            if (bad := np.count_nonzero(~np.isfinite(some)))
        ]
        if not each:
            return ""
        since = self.trajectory.lost
        when = (
            ""
            if since is None
            else f"; on the first held-out one its estimate is not finite from {since:.4g} s on"
        )
        return f"{called(own)} has no finite cost on {' and '.join(each)}{when}"

    def warnings(self) -> list[str]:
        """What a reader must know before trusting the filter."""
        found, t, own = [], self.trust, self.evaluation.own
        if lost := self.not_finite():
            found.append(f"NOT FINITE: {lost}: do not trust this filter")
        if t.chaotic:
            found.append(
                f"SENSITIVE: training cost {t.cost_float32:.4g} in float32, {t.cost_float64:.4g} "
                f"in float64, {t.cost_perturbed:.4g} from a start changed by 1e-6; they should "
                "agree within 1 %. The simulation is chaotic: do not trust this filter"
            )
        if bad := int(np.sum(self.evaluation.contenders[own].metrics.diverged)):
            found.append(f"{called(own)} diverged on {counted(bad, 'held-out scenario')}")
        if t.uncovered:
            found.append(f"no rule fires for {100 * t.uncovered:.1f} % of errors and rates")
        if self.endurance is not None and (worse := self.endurance.worse()):
            found.append(
                f"past the time that it was tuned for it is worse than {called(self.beside)}: "
                f"{', '.join(worse)}"
            )
        return found


@np.errstate(over="ignore")  # a filter may diverge to any number
def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))
