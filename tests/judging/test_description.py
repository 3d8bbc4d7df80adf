"""Filters as they are stored: kinds and numbers, from there and back to the filter."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.own_filter import Complementary

import posegsa
from posegsa import config
from posegsa.config import Experiment
from posegsa.errors import ArgumentError, ConfigError, FuzzyError, RunFolderError
from posegsa.filters.attitude import AttitudeFilter
from posegsa.filters.kalman import KalmanFilter
from posegsa.filters.observer import Observer
from posegsa.judging.description import (
    KINDS,
    TITLES,
    Description,
    StoredFilter,
    candidate_of,
    configured_filter,
    describe,
    described_filter,
    rules_text,
    tuned_experiment,
)
from posegsa.model.schedules import (
    SCHEDULES,
    ConstantGain,
    KnotGain,
    RampGain,
    SmoothGain,
    SwitchGain,
)
from posegsa.saving.records import from_plain
from posegsa.search.candidates import Candidate
from posegsa.search.configured_filters import filter_of
from posegsa.search.search_spaces import search_space
from posegsa.settings.plain import plain

pytestmark = [
    pytest.mark.quick,
    pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning"),
]

FILE = Path("result.json")
ALSO = (
    'parameters.also=[{key="filter.gamma.0", lower=0.5, upper=50.0, scale="logarithmic"}, '
    '{key="scenario.landmarks.0.weight", lower=0.2, upper=2.0}]'
)
NOISE = 'parameters.also=[{key="filter.vector", lower=0.03, upper=3.0}]'
HEADING = 'parameters.also=[{key="filter.heading", lower=0.01, upper=1.0}]'
OWN = (
    *("filter.kind=own", "filter.attitude_gain=1.0", "filter.position_gain=4.0"),
    'parameters.also=[{key="filter.attitude_gain", lower=0.1, upper=10.0}]',
)
SEARCHED = (ALSO, "fuzzy.rules=searched")


class Case(NamedTuple):
    """A filter, of an experiment."""

    settings: tuple[str, ...]
    schedule: object = None
    """None is the experiment's own, in the middle of its box."""


f = jnp.float32
CASES = {
    "fuzzy": Case((ALSO,)),
    "fuzzy, rules searched": Case(SEARCHED),
    "constant": Case((ALSO,), ConstantGain(f(20))),
    "constant, of its own experiment": Case(("filter.schedule=constant", ALSO)),
    "switch": Case((ALSO,), SwitchGain(f(80), f(9), f(0.2), f(0.1))),
    "smooth": Case((ALSO,), SmoothGain(f(2), f(50), f(0.3))),
    "smooth, of its own experiment": Case(("filter.schedule=smooth", ALSO)),
    "ramp": Case((ALSO,), RampGain(f(0.1), f(3))),
    "open loop": Case((ALSO,), KnotGain(f([0, 0.2, 0.4]), f([4, 3, 2]))),
    "kalman": Case(("filter.kind=kalman", NOISE)),
    "imu": Case(("filter.kind=imu", HEADING)),
    "own": Case(OWN),
}


def made(name: str) -> tuple[Experiment, Candidate, Any]:
    """An experiment, a candidate of it, and the user's own filter if it is one."""
    case = CASES[name]
    experiment = config.override(tiny(), case.settings)
    space = search_space(experiment)
    candidate = space.candidate((space.box.lower + 2 * space.box.upper) / 3)
    if case.schedule is not None:
        candidate = dataclasses.replace(candidate, schedule=case.schedule)
    return experiment, candidate, Complementary if name == "own" else None


def test_every_kind_is_looked_at() -> None:
    kinds = {name.split(",")[0] for name in CASES}
    assert kinds == {*SCHEDULES, *TITLES} == {*KINDS}


@pytest.mark.parametrize("name", CASES)
def test_what_is_stored_gives_each_back(name: str) -> None:
    experiment, candidate, _ = made(name)
    stored = describe(candidate, experiment, 24)
    assert (stored.kind, stored.evaluations) == (name.split(",")[0], 24)
    assert tuple(stored.also) == candidate.keys != ()
    assert ("rules" in stored.numbers) == (name == "fuzzy, rules searched")
    assert from_plain(StoredFilter, plain(stored), FILE) == stored  # type: ignore[arg-type]  # an annotated type
    again = candidate_of(stored, experiment)
    assert jax.tree.structure(again) == jax.tree.structure(candidate)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(candidate), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-6)
    assert describe(again, experiment, 24) == stored


@pytest.mark.parametrize("name", CASES)
def test_the_filter_of_a_description_is_the_one_that_was_searched(name: str) -> None:
    experiment, candidate, own = made(name)
    stored = describe(candidate, experiment, 24)
    searched = candidate.applied(filter_of(experiment, own))
    types = {"kalman": KalmanFilter, "imu": AttitudeFilter, "own": Complementary}
    own_rules = {name: each for name, each in stored.numbers.items() if name != "rules"}
    configured = stored._replace(numbers=own_rules)  # a table that was found is in the experiment
    for filter in (
        described_filter(stored, experiment, own),
        described_filter(configured, tuned_experiment(experiment, stored), own),
    ):
        assert type(filter) is types.get(stored.kind, Observer)
        assert jax.tree.structure(filter) == jax.tree.structure(searched)
        for a, b in zip(jax.tree.leaves(filter), jax.tree.leaves(searched), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-6)
    if isinstance(filter, Observer):
        filter = dataclasses.replace(filter, schedule=None)
    before, after = jax.tree.leaves(filter_of(experiment, own)), jax.tree.leaves(filter)
    assert any(float(a) != float(b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize(
    "name", ["fuzzy", "constant, of its own experiment", "smooth, of its own experiment", "kalman"]
)
def test_the_tuned_experiment_is_configured_as_the_tuned_filter(name: str) -> None:
    """What `configured` makes of it, in particular of its file, is the same filter."""
    experiment, candidate, own = made(name)
    stored = describe(candidate, experiment, 24)
    tuned = tuned_experiment(experiment, stored)
    again = configured_filter(config.override(tuned, ["run.seed=1"]))
    assert again.kind == stored.kind
    assert again.numbers.keys() == stored.numbers.keys()
    for key, numbers in stored.numbers.items():
        np.testing.assert_allclose(again.numbers[key], numbers, rtol=1e-6)
    assert again.evaluations == 0
    filters = [described_filter(stored, experiment, own), described_filter(again, tuned, own)]
    for a, b in zip(*map(jax.tree.leaves, filters), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


def test_the_numbers_of_a_configuration_are_those_of_its_filter() -> None:
    also = {"filter.gamma": 3.5, "gain.smoothing": 0.5}
    numbers = config.TunedConfig(numbers=(5.0, 60.0, 0.25), also=also)
    settings = ["filter.schedule=smooth"]
    experiment = config.override(Experiment(), settings).replace(tuned=numbers)
    found = configured_filter(experiment)
    assert found == Description("smooth", {"low": [5.0], "high": [60.0], "half": [0.25]}, also, 0)
    filter = described_filter(found, experiment)
    assert isinstance(filter, Observer)
    assert isinstance(filter.schedule, SmoothGain)
    assert (float(filter.schedule.low), float(filter.schedule.half)) == (5.0, 0.25)
    assert float(filter.settings.gamma_angular) == 3.5
    assert float(filter.signal.smoothing) == 0.5


def test_a_schedule_without_numbers_is_refused_and_a_kalman_filter_has_its_own() -> None:
    with pytest.raises(ArgumentError, match=r"tuned.numbers: none of a fuzzy gain"):
        configured_filter(tiny())
    rules = tiny("fuzzy.rules=searched").replace(tuned=config.TunedConfig(numbers=(0.5,) * 22))
    with pytest.raises(ArgumentError, match="rules that are searched"):
        configured_filter(rules)
    assert configured_filter(config.override(tiny(), ["filter.kind=kalman"])) == Description(
        "kalman", {}, {}, 0
    )
    ramps = posegsa.load_config("kalman").replace(**{"filter.belief": "ramp"})
    needed = r"numbers = \[vectors.start, vectors.slope, landmarks.start, landmarks.slope\]"
    with pytest.raises(ArgumentError, match=needed):
        configured_filter(ramps)


def test_the_controller_of_a_kalman_filter_lies_in_the_boxes_too() -> None:
    scheduled = config.override(tiny(), ["filter.kind=kalman", "filter.unknown=fuzzy"])
    with pytest.raises(FuzzyError, match=r"k1: must lie in \[0, 0.15\], got 0.9"):
        configured_filter(scheduled.replace(tuned=config.TunedConfig(numbers=(0.9,) * 22)))


def test_what_is_recommended_is_configured_where_nothing_is_said() -> None:
    recommended = config.load("recommended")
    found = posegsa.configured()
    assert found.filter == configured_filter(recommended)
    assert found.also == recommended.tuned.also != {}


def test_searched_rules_are_in_the_tuned_experiment() -> None:
    experiment, candidate, _ = made("fuzzy, rules searched")
    stored = describe(candidate, experiment, 24)
    tuned = tuned_experiment(experiment, stored)
    again = describe(candidate_of(stored, experiment), experiment, 24)
    assert again.numbers["rules"] == stored.numbers["rules"]
    assert len(tuned.fuzzy.rules) == 5
    rules = candidate_of(stored, experiment).schedule.controller.rules  # type: ignore[union-attr]  # a fuzzy gain's
    lines = rules_text(rules).splitlines()[-5:]
    assert [tuple(line.split()[1:]) for line in lines] == [*tuned.fuzzy.rules]


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("fuzzy", {"k": [0.5] * 21}),
        ("fuzzy", {}),
        ("fuzzy", {"k": [0.5] * 22, "gain": [1.0]}),
        ("constant", {"gain": [1.0, 2.0]}),
        ("constant", {"low": [1.0]}),
        ("smooth", {"low": [1.0], "high": [2.0]}),
        ("switch", {"before": [1.0]}),
        ("open loop", {"time": [0.0, 1.0], "log_gain": [1.0]}),
        ("open loop", {"time": [1.0, 1.0], "log_gain": [1.0, 2.0]}),
        ("open loop", {"time": [], "log_gain": []}),
        ("kalman", {"vector": [0.1]}),
        ("own", {"gain": [0.1]}),
    ],
)
def test_numbers_of_another_kind_are_refused(kind: str, numbers: dict[str, list[float]]) -> None:
    data = {"kind": kind, "numbers": numbers, "also": {}, "evaluations": 0}
    with pytest.raises(RunFolderError, match=r"its numbers are .*allowed: "):
        from_plain(StoredFilter, data, FILE)  # type: ignore[arg-type]  # an annotated type


@pytest.mark.parametrize(
    ("time", "log_gain", "allowed"),
    [
        ([0.0, 1.0], [1.0], "'log_gain': 2"),
        ([], [1.0], "'time': 1"),
        ([0.0, 2.0, 1.0], [1.0] * 3, "ascending times"),
    ],
)
def test_a_clock_has_as_many_numbers_as_ascending_times(time, log_gain, allowed) -> None:
    clock = config.override(tiny(), ["filter.kind=kalman", "filter.unknown=clock"])
    numbers = {"unknown.time": time, "unknown.log_gain": log_gain}
    with pytest.raises(ValueError, match=rf"of unknown .*allowed: .*{allowed}"):
        candidate_of(Description("kalman", numbers, {}, 0), clock)
    found = {"unknown.time": [0.0, 1.0, 2.0], "unknown.log_gain": [1.0, 2.0, 3.0]}
    candidate_of(Description("kalman", found, {}, 0), clock)


@pytest.mark.parametrize("rules", [[], [5.0] * 25, [1.5] * 25, [1.0] * 24])
def test_a_rule_table_that_is_none_is_refused(rules: list[float]) -> None:
    found = Description("fuzzy", {"k": [0.5] * 22, "rules": rules}, {}, 0)
    with pytest.raises(ValueError, match=r"rules = .*allowed: 25 whole numbers up to 4"):
        candidate_of(found, tiny("fuzzy.rules=searched"))
    if rules:
        with pytest.raises(ValueError, match="allowed: none, as the table was not searched"):
            candidate_of(found, tiny())


def test_a_filter_of_the_users_own_is_passed_and_needed() -> None:
    experiment, candidate, own = made("own")
    stored = describe(candidate, experiment, 24)
    with pytest.raises(ArgumentError, match=r'filter: none with filter.kind = "own"'):
        described_filter(stored, experiment)
    with pytest.raises(ArgumentError, match=r"filter, with filter.kind = 'observer'"):
        described_filter(Description("constant", {"gain": [9.0]}, {}, 0), tiny(), own)
    with pytest.raises((ArgumentError, ConfigError)):
        described_filter(stored._replace(also={"filter.nothing": 1.0}), experiment, own)
