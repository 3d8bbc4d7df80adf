"""Errors of a tuned filter long after the time window that it was tuned for."""

import math
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np

from posegsa import config
from posegsa.judging.metrics import POSITION_WORDS, error_tracks
from posegsa.judging.untuned import with_idle_schedules
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import endurance_keys
from posegsa.search.population import ScenarioBatch
from posegsa.search.problem import TuningProblem
from posegsa.settings.arrays import Numbers
from posegsa.settings.fields import MAX_SAMPLES
from posegsa.words import counted, text_table

PerWindow = Annotated[np.ndarray, Numbers("windows", allow="any")]

WORSE_RATIO = 1.02
"""Ratio of errors above which one counts as worse."""


class Endurance(NamedTuple):
    """Root mean square errors over all scenarios in w windows of time, each (w,)."""

    begin: PerWindow
    """Start of each window [s]; the first is as long as a training scenario."""
    end: PerWindow
    """End of each window [s]."""
    attitude: PerWindow
    """Attitude error of the tuned filter [deg]."""
    position: PerWindow
    """Its position error as in the cost, |P_est - R_err P| [m]."""
    distance: PerWindow
    """Distance of its position from the true one, |P_est - P| [m]."""
    other_attitude: PerWindow
    """The attitude error of the other filter [deg]."""
    other_position: PerWindow
    """Its position error as in the cost [m]."""
    other_distance: PerWindow
    """Its distance from the true position [m]."""

    def rows(self) -> list[tuple[float, ...]]:
        """The windows one by one, in the order of the fields."""
        return list(zip(*(each.tolist() for each in self), strict=True))

    def table(self, names: tuple[str, str], scenarios: int) -> str:
        """The windows as text.

        Args:
            names: Names of the judged filter and of the other one.
            scenarios: Number of scenarios.
        """
        heads = ["attitude", "P_err", "distance"]
        own, other = names
        rows = [["RMS error", own, "", "", other, "", ""], ["", *heads, *heads]]
        rows += [
            [f"{begin:g} to {end:g} s"]
            + [
                cell
                for angle, *lengths in (errors[:3], errors[3:])
                for cell in (f"{angle:.2f} deg", *(f"{100 * one:.1f} cm" for one in lengths))
            ]
            for begin, end, *errors in self.rows()
        ]
        unseen = counted(scenarios, "other unseen scenario")
        title = f"In the time that it was tuned for and long after, on {unseen}:"
        return f"{title}\n\n{text_table(rows)}\n{POSITION_WORDS}"

    def worse(self) -> list[str]:
        """Errors and windows after the first in which the tuned filter is worse, as text.

        An error below WORSE_RATIO times the other's counts as equal.
        """
        found = []
        for name, own, other in (
            ("attitude", self.attitude, self.other_attitude),
            ("P_err", self.position, self.other_position),
            ("distance", self.distance, self.other_distance),
        ):
            # `not <=` instead of `>`: NaN counts as worse.
            windows = [i for i in range(1, len(own)) if not own[i] <= WORSE_RATIO * other[i]]
            found += [f"{name} from {self.begin[i]:g} to {self.end[i]:g} s" for i in windows]
        return found


def endurance(problem: TuningProblem, tuned: Candidate, other: Candidate) -> Endurance:
    """Run two candidates on unseen scenarios `run.endurance_times` as long as the experiment's.

    The windows double in length: with scenarios of 15 s, 0 to 15, 15 to 30, 30 to 60, 60 to 120 s.
    """
    experiment = problem.experiment
    run, duration = experiment.run, experiment.scenario.duration
    last = min(run.endurance_times * duration, MAX_SAMPLES * experiment.scenario.sampling_time)
    edges = [0.0, duration]
    while edges[-1] < last:
        edges.append(min(2 * edges[-1], last))
    settings = [f"scenario.duration={edges[-1]!r}", "family.duration=off"]
    longer = config.override(experiment, settings)
    unseen = endurance_keys(run.seed, run.endurance_scenarios)
    batch = scenario_batch(longer, unseen, filter_of(longer, problem.own))
    # Shifted by half a sample, so that rounding puts no sample into the window before its own.
    time = np.asarray(batch.samples.time[0], np.float64) + 0.5 * longer.scenario.sampling_time
    # Before a start from the sensors nothing is estimated.
    starts = None if batch.begin is None else np.asarray(batch.begin, np.float64)[:, None]

    def mean_square(error: np.ndarray, begin: float, end: float) -> float:
        window = (time >= begin) & (time < end)
        counts = True if starts is None else time[window] > starts
        return float(np.mean(error[:, window] ** 2, where=counts))

    def errors(candidate: Candidate, batch: ScenarioBatch) -> dict[str, np.ndarray]:
        tracks = error_tracks(candidate, batch)
        half = np.sqrt(np.asarray(tracks.attitude, np.float64))
        each = {
            "attitude": np.degrees(2 * np.arcsin(half)),
            "position": np.asarray(tracks.position, np.float64),
            "distance": np.asarray(tracks.distance, np.float64),
        }
        return {
            name: np.array(
                [math.sqrt(mean_square(error, begin, end)) for begin, end in pairwise(edges)]
            )
            for name, error in each.items()
        }

    of_other = errors(other, with_idle_schedules(batch, problem))
    others = {f"other_{name}": error for name, error in of_other.items()}
    windows = {"begin": np.array(edges[:-1]), "end": np.array(edges[1:])}
    return Endurance(**windows, **errors(tuned, batch), **others)
