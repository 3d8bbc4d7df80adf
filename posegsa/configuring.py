"""A filter that was not searched, as a result: to be judged, replayed, streamed, exported."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import get_args

import jax
import numpy as np
from jax import Array

from posegsa import config
from posegsa.arguments import check_type
from posegsa.config import SEARCHED, Experiment
from posegsa.errors import FuzzyError
from posegsa.judging.description import (
    Description,
    configured_filter,
    describe,
    described_filter,
)
from posegsa.judging.judge import on_recordings
from posegsa.judging.result import Result
from posegsa.model.fuzzy import FuzzyController
from posegsa.model.schedules import SCHEDULES, FuzzyGain, GainSchedule
from posegsa.recordings.imu import as_read_by
from posegsa.recordings.recording import Recording
from posegsa.runtime import environment
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import OwnFilter
from posegsa.search.search_spaces import parameter_space, rule_table
from posegsa.version import VERSION


def configured(
    experiment: Experiment | str | Path | None = None,
    *,
    schedule: GainSchedule | None = None,
    filter: OwnFilter | None = None,
    recordings: Sequence[Recording] = (),
) -> Result:
    """The filter of a configuration, with the numbers of its last tuning, as a result.

    The configurations that come with posegsa have such numbers, in [tuned].

    Args:
        experiment: The configuration: an experiment, a TOML file or the name of a shipped one; by
            default the recommended experiment.
        schedule: A gain schedule made by hand instead of the configured one: `ConstantGain`,
            `FuzzyGain` of a controller that the experiment can have, or another of
            `posegsa.model.schedules.SCHEDULES`.
        filter: The user's own filter, if `filter.kind` is "own" (see `tune`).
        recordings: The filter knows their vectors and landmarks; those with a truth judge it.

    Raises:
        ArgumentError: The configuration has no numbers for its schedule; or another schedule.
        ConfigError: The file cannot be read or is not a valid experiment.
        FuzzyError: The controller is not one that the experiment can have.
    """
    chosen = config.as_experiment(experiment)
    if schedule is None:
        found = configured_filter(chosen)
        with jax.enable_x64(chosen.run.dtype == "float64"):
            described_filter(found, chosen, filter)  # refuses what cannot be made
    else:
        chosen, found = _by_hand(schedule, chosen)
    result = Result(
        experiment=chosen,
        filter=found,
        search=None,
        environment=environment(),
        version=VERSION,
        own=filter,
    )
    each = [as_read_by(found.kind, one) for one in recordings]
    return on_recordings(result, [], each) if each else result


def _by_hand(schedule: GainSchedule, experiment: Experiment) -> tuple[Experiment, Description]:
    """The experiment of a schedule made by hand, in which nothing is searched, and its filter."""
    check_type("schedule", schedule, *SCHEDULES.values())
    kind = next(kind for kind, made in SCHEDULES.items() if isinstance(schedule, made))
    settings = ["parameters.also=[]"]
    if kind in get_args(config.ScheduleKind):
        settings.insert(0, f"filter.schedule={kind}")
    chosen = config.override(experiment.replace(tuned=config.TunedConfig()), settings)
    if isinstance(schedule, FuzzyGain) and chosen.fuzzy.rules == SEARCHED:
        chosen = chosen.replace(**{"fuzzy.rules": rule_table(schedule.controller.rules)})
    with jax.enable_x64(chosen.run.dtype == "float64"):
        if isinstance(schedule, FuzzyGain):
            space, own = parameter_space(chosen), schedule.controller
            made = space.schedule(space.checked(np.asarray(space.vector(own)))).controller
            for each in fields(FuzzyController):
                # The reach only saves time and changes no result.
                if each.name != "reach" and not _same(getattr(made, each.name), own, each.name):
                    raise FuzzyError(
                        f"schedule.controller.{each.name}: is not what the experiment's "
                        f"parameters give, {getattr(made, each.name)}; allowed: a controller of "
                        "the experiment, or one with the controller's [fuzzy] settings"
                    )
        return chosen, describe(Candidate(schedule), chosen, 0)


def _same(made: object, controller: FuzzyController, name: str) -> bool:
    """Whether a field is the same in both controllers, terms to the precision of both."""
    own = getattr(controller, name)
    if isinstance(own, Array | np.ndarray):
        eps = 8 * max(float(np.finfo(np.asarray(a).dtype).eps) for a in (made, own))
        low, high = controller.output_range
        return bool(np.allclose(np.asarray(made), np.asarray(own), rtol=0, atol=eps * (high - low)))
    return made == own
