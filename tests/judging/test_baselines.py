"""Baselines of a tuned filter: how each is found, stored and read back."""

import dataclasses
import math
import sys
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny

from posegsa import config
from posegsa.filters.noise_schedules import NoiseGains
from posegsa.judging import baselines
from posegsa.judging.baselines import (
    best_constant,
    random_search,
    replayed,
    search_baseline,
    searchable,
)
from posegsa.judging.description import Description, candidate_of, configured_filter, describe
from posegsa.judging.evaluation import (
    AS_CONFIGURED,
    CONSTANT,
    CONTENDERS,
    EKF,
    RANDOM,
    REPLAYED,
    SMOOTH,
    TUNED,
    UNTUNED,
)
from posegsa.judging.metrics import error_tracks, estimates_on, metrics_of
from posegsa.judging.tuned_kalman import VARIANTS
from posegsa.model.schedules import (
    SCHEDULES,
    ConstantGain,
    KnotGain,
    RampGain,
    ScheduleInputs,
    SmoothGain,
    SwitchGain,
)
from posegsa.search.candidates import Candidate
from posegsa.search.population import costs_by_scenario
from posegsa.search.problem import TuningProblem, tuning_problem
from posegsa.search.schedule_spaces import KNOTS, knot_times, noise_space, schedule_space

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

ALSO = (
    'parameters.also=[{key="filter.gamma.0", lower=0.5, upper=50.0, scale="logarithmic"}, '
    '{key="scenario.landmarks.0.weight", lower=0.2, upper=2.0}]'
)


@pytest.fixture(scope="module")
def problem() -> TuningProblem:
    """The problem of `test_evaluate`, so that its programs are compiled once."""
    return tuning_problem(tiny())


@pytest.fixture(scope="module")
def tuned_too() -> TuningProblem:
    """The same with estimated biases, and with two more tuned numbers."""
    return tuning_problem(tiny(ALSO, "filter.vector_bias=estimated"))


def middle(problem: TuningProblem) -> Candidate:
    """An arbitrary controller: the middle of the search box."""
    return problem.space.candidate((problem.space.box.lower + problem.space.box.upper) / 2)


def mean_cost(one: Candidate, problem: TuningProblem) -> float:
    tracks = error_tracks(one, problem.training)
    return float(np.mean(metrics_of(tracks, problem.training)[0].cost))


def inputs(error, time=0.0) -> ScheduleInputs:
    return ScheduleInputs(jnp.float32(error), jnp.float32(0), jnp.float32(time), jnp.float32(1))


OWN_KIND = {"constant": {CONSTANT, REPLAYED}, "smooth": {SMOOTH}, "kalman": {REPLAYED}}
"""Filters that cannot be compared with one of a kind: the same kind, and gains that it lacks."""


@pytest.mark.parametrize("kind", ["fuzzy", "constant", "smooth", "kalman"])
def test_each_other_filter_can_be_compared_with_a_tuned_one(problem, kind) -> None:
    settings = ["filter.kind=kalman"] if kind == "kalman" else [f"filter.schedule={kind}"]
    own = config.override(problem.experiment, settings)
    found = baselines.baselines(own, Description(kind, {}, {}, 24))
    gone = OWN_KIND.get(kind, set()) | {TUNED}
    if kind != "kalman":
        gone |= {AS_CONFIGURED}
    assert set(found) == {*CONTENDERS} - gone
    kinds = {name: each.experiment.filter.kind for name, each in found.items()}
    of_its_own = {name: kinds[name] for name in (AS_CONFIGURED, REPLAYED, RANDOM) if name in kinds}
    assert set(of_its_own.values()) == {own.filter.kind}
    kalman = {name for name, each in kinds.items() if each == "kalman"} - set(of_its_own)
    assert kalman == {*VARIANTS, UNTUNED}
    for name in kalman - {UNTUNED}:
        learns = found[name].experiment.filter.vector_bias == "estimated"
        assert learns == (name != EKF)


def test_a_baseline_is_found_as_what_it_is(problem) -> None:
    tuned = describe(middle(problem), problem.experiment, 24)
    found = baselines.baselines(problem.experiment, tuned)
    some = {name: found[name] for name in (REPLAYED, SMOOTH, UNTUNED)}
    gains, searched, untuned = baselines.search_baselines(problem, some).values()
    assert (gains.kind, gains.evaluations) == ("open loop", 0)
    assert gains == describe(replayed(problem, middle(problem)), problem.experiment, 0)
    assert (searched.kind, searched.evaluations) == ("smooth", 24)
    assert searched == describe(search_baseline(problem, "smooth"), problem.experiment, 24)
    kalman = config.override(problem.experiment, ["filter.kind=kalman", "filter.vector=0.3"])
    assert untuned == configured_filter(found[UNTUNED].experiment)
    own = baselines.baselines(kalman, Description("kalman", {}, {}, 9))
    before = {AS_CONFIGURED: own[AS_CONFIGURED]}
    of_kalman = problem._replace(experiment=kalman)
    as_configured = Description("kalman", {}, {}, 0)
    assert baselines.search_baselines(of_kalman, before) == {AS_CONFIGURED: as_configured}


def test_beside_a_filter_without_a_schedule_is_the_default_observer() -> None:
    kalman = config.override(tiny(), ["filter.kind=kalman"])
    beside = baselines.observer_experiment(kalman)
    assert beside.filter == config.ObserverConfig()
    assert beside.scenario == kalman.scenario
    assert [one.key for one in beside.also] == [one.key for one in config.Experiment().also]
    assert baselines.observer_experiment(tiny()) == tiny()


@pytest.mark.parametrize("kind", [kind for kind in SCHEDULES if kind != "fuzzy"])
def test_a_search_is_repeated_and_better_than_the_middle_of_its_box(problem, kind) -> None:
    found, again = (search_baseline(problem, kind) for _ in range(2))
    assert isinstance(found.schedule, SCHEDULES[kind])
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    space = schedule_space(kind, problem.experiment)
    between = Candidate(space.schedule((space.lower + space.upper) / 2))
    assert mean_cost(found, problem) < mean_cost(between, problem)


def test_the_baselines_have_the_filter_that_suits_them(tuned_too) -> None:
    found = search_baseline(tuned_too, "switch")
    assert found.keys == tuned_too.space.keys != ()
    for value, one in zip(found.values, tuned_too.experiment.also, strict=True):
        assert one.lower * (1 - 1e-6) <= value <= one.upper * (1 + 1e-6)
    assert 0 < float(found.schedule.learning_time) <= 1


def test_one_that_descends_is_searched_by_differential_evolution() -> None:
    for name in ("adam", "gsa+adam"):
        enough = ["search.agents=10", "search.iterations=100"]
        one = config.override(config.override(tiny(), enough), [f"search.optimiser={name}"])
        assert searchable(one).search.optimiser == "de"
    few = ["search.optimiser=adam", "search.agents=1", "search.iterations=2"]
    assert searchable(config.override(tiny(), few)).search.evaluations == 44
    assert searchable(tiny()) == tiny()


def test_learning_begins_later_only_where_biases_are_learnt() -> None:
    learnt = tiny("filter.vector_bias=estimated")
    assert float(schedule_space("switch", learnt).upper[3]) == 1
    assert float(schedule_space("switch", tiny()).upper[3]) == 0
    assert float(noise_space("switch", learnt).upper[3]) == 0, "a noise has no bias law"


def test_replayed_gains_are_the_tuned_ones_where_these_ignore_the_error(problem) -> None:
    times = knot_times(1.99).astype(np.float32)
    log_gains = np.interp(times, [0.0, 0.8, 1.99], [2.8, 2.0, 1.0]).astype(np.float32)
    knots = dataclasses.replace(middle(problem), schedule=KnotGain(times, log_gains))
    again = replayed(problem, knots)
    assert (again.keys, again.values) == (knots.keys, knots.values)
    tracks, replay = (error_tracks(one, problem.scenarios) for one in (knots, again))
    # All gains are below the gain limit, which cuts the gain of each scenario separately.
    np.testing.assert_allclose(replay.gain, tracks.gain, rtol=1e-4)
    np.testing.assert_allclose(replay.position, tracks.position, rtol=1e-4)


def test_replayed_gains_are_means_over_training_scenarios(problem) -> None:
    tuned = middle(problem)
    schedule = replayed(problem, tuned).schedule
    assert isinstance(schedule, KnotGain)
    gain = np.asarray(error_tracks(tuned, problem.training).gain)
    np.testing.assert_allclose(np.exp(schedule.log_gain), np.cbrt(np.prod(gain, axis=0)), rtol=1e-4)
    np.testing.assert_allclose(schedule.time, 0.01 * np.arange(200), atol=1e-6)


def test_a_replayed_kalman_filter_is_a_clock_of_its_schedules_mean_output(problem) -> None:
    of_line = config.override(problem.experiment, ["filter.kind=kalman", "filter.unknown=ramp"])
    start, slope = 0.1, 1.0
    line = Description("kalman", {"unknown.start": [start], "unknown.slope": [slope]}, {}, 24)
    one = baselines.baselines(of_line, line)[REPLAYED]
    clock = baselines.search_baselines(problem, {REPLAYED: one})[REPLAYED]
    assert clock.evaluations == 0

    training = baselines.variant_of(problem, of_line).training
    tuned = candidate_of(line, of_line)
    error = np.stack([estimates_on(tuned, training, i).error for i in range(3)])
    gain = 1 + 100 * np.clip(slope * (error - start), 0.0, 1.0)
    assert gain.min() == 1
    assert gain.max() > 30
    np.testing.assert_allclose(clock.numbers["unknown.time"], 0.01 * np.arange(200), atol=1e-6)
    replayed_gain = np.exp(clock.numbers["unknown.log_gain"])
    np.testing.assert_allclose(replayed_gain, np.mean(gain, axis=0), rtol=1e-4)
    found = candidate_of(clock, one.experiment).schedule
    assert isinstance(found, NoiseGains)
    assert isinstance(found.unknown, KnotGain)


def test_scenarios_that_have_not_started_are_left_out_of_a_replay(monkeypatch) -> None:
    problem = tuning_problem(config.override(tiny(), ["filter.kind=kalman", "filter.unknown=ramp"]))
    begin = np.array([0.0, 1.0, 9.0])  # the last one never starts
    training = problem.training._replace(begin=begin)
    outputs = iter([10.0, 30.0, 50.0])

    def estimates(candidate, batch, scenario) -> Any:
        full = np.full(batch.samples.time.shape[1], np.float32(next(outputs) / 100))
        return SimpleNamespace(error=full, rate=full)

    monkeypatch.setattr(baselines, "estimates_on", estimates)
    line = NoiseGains(unknown=RampGain(jnp.float32(0), jnp.float32(1)))
    schedule = replayed(problem._replace(training=training), Candidate(line)).schedule
    assert isinstance(schedule, NoiseGains)
    assert isinstance(schedule.unknown, KnotGain)
    gain, late = np.exp(schedule.unknown.log_gain), schedule.unknown.time >= 1
    np.testing.assert_allclose(gain[~late], 11, rtol=1e-5)
    np.testing.assert_allclose(gain[late], 21, rtol=1e-5)


@pytest.mark.parametrize("kind", ["off", "clock"])
def test_a_kalman_filter_without_feedback_has_nothing_to_replay(problem, kind) -> None:
    own = config.override(problem.experiment, ["filter.kind=kalman", f"filter.unknown={kind}"])
    assert REPLAYED not in baselines.baselines(own, Description("kalman", {}, {}, 24))


def test_random_search_needs_no_library_of_the_runs_own_optimiser(problem, monkeypatch) -> None:
    found = random_search(problem)
    assert found.kind == "fuzzy"
    for module in [m for m in sys.modules if m.split(".")[0] == "evosax"]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, "evosax", None)
    other = config.override(problem.experiment, ["search.optimiser=cma_es"])
    again = random_search(problem._replace(experiment=other))
    assert again.numbers == found.numbers
    assert again.also == found.also


def test_the_grids_constant_is_the_best_of_all_whole_gains(problem) -> None:
    grid = best_constant(problem)
    gains = np.resize(np.linspace(1, 101, 41), baselines.CONSTANT_GAINS).astype(np.float32)
    costs = costs_by_scenario(Candidate(ConstantGain(gains)), problem.training)
    assert mean_cost(grid, problem) <= np.mean(costs, axis=0).min() * (1 + 1e-4)
    assert 1 <= float(grid.schedule.gain) <= 101


def test_the_smooth_schedule_is_half_way_at_half() -> None:
    schedule = SmoothGain(jnp.float32(2), jnp.float32(50), jnp.float32(0.3))
    assert float(schedule(inputs(0.0)).gain) == 2
    assert float(schedule(inputs(0.3)).gain) == pytest.approx(26)
    assert float(schedule(inputs(1.0)).gain) < 50


def test_the_switch_changes_the_gain_at_one_time_and_learning_at_another() -> None:
    switch = SwitchGain(*map(jnp.float32, (80, 9, 2, 1)))
    found = [switch(inputs(0.5, time)) for time in (0, 0.99, 1, 1.99, 2, 9)]
    assert [float(gains.gain) for gains in found] == [80, 80, 80, 80, 9, 9]
    assert [float(gains.learning) for gains in found] == [0, 0, 1, 1, 1, 1]


def test_the_knot_schedule_passes_its_knots_and_holds_its_ends() -> None:
    knots = KnotGain(jnp.float32([0, 1, 3]), jnp.log(jnp.float32([100, 10, 1])))
    for time, gain in ((0, 100), (1, 10), (2, math.sqrt(10)), (3, 1), (9, 1)):
        assert float(knots(inputs(0.1, time)).gain) == pytest.approx(gain, rel=1e-5)


@pytest.mark.parametrize("end", [0.5, 14.99, 60.0])
def test_open_loop_knots_cover_the_run_and_are_dense_at_the_start(end) -> None:
    knots = knot_times(end)
    assert len(knots) == KNOTS
    assert (np.diff(knots) > 0).all()
    assert knots[0] == 0
    assert knots[-1] == pytest.approx(end)
    assert np.count_nonzero(knots <= min(2.0, end / 2) * (1 + 1e-9)) == KNOTS // 2 + 1
