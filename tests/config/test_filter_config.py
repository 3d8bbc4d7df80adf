"""[filter]: which filter, with which numbers; and [tuned], the numbers of its last tuning."""

import tomllib
from pathlib import Path

import pytest
from helpers.messages import assert_states

from posegsa import config
from posegsa.config import (
    Experiment,
    KalmanConfig,
    ObserverConfig,
    OwnConfig,
    TunedConfig,
    from_dict,
    override,
    to_toml,
)
from posegsa.errors import ConfigError
from posegsa.model.fuzzy import FuzzyController
from posegsa.search.search_spaces import parameter_space

pytestmark = pytest.mark.quick

CONFIGS = Path(__file__).parents[2] / "configs"
K = tuple(0.01 * i for i in range(22))
COUNTS = {"fuzzy": 22, "constant": 1, "smooth": 3}
"""How many numbers each schedule has."""
BASE = Experiment()


def refusal(data: dict) -> str:
    """What is said of an experiment's data, on one line."""
    with pytest.raises(ConfigError) as caught:
        from_dict(data)
    return " ".join(str(caught.value).split())


def with_numbers(schedule: str, count: int) -> dict:
    numbers = [5.0 + i for i in range(count)]
    return {"filter": {"schedule": schedule}, "tuned": {"numbers": numbers}}


# Kinds --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("section", "made"),
    [
        ({}, ObserverConfig()),
        ({"kind": "observer", "schedule": "smooth"}, ObserverConfig(schedule="smooth")),
        ({"kind": "kalman", "vector": 0.3}, KalmanConfig(vector=0.3)),
        ({"kind": "own", "stiffness": 2, "kindness": 1.5}, OwnConfig(stiffness=2.0, kindness=1.5)),
        ({"kind": "own"}, OwnConfig()),
    ],
)
def test_a_table_is_the_filter_of_its_kind(section: dict, made: config.FilterConfig) -> None:
    experiment = from_dict({"filter": section})
    assert experiment.filter == made
    assert type(experiment.filter) is type(made)
    assert from_dict(tomllib.loads(to_toml(experiment))) == experiment
    assert from_dict(experiment.model_dump(mode="json")) == experiment
    assert override(experiment, []) == experiment
    hash(experiment)


def test_a_users_own_filter_has_its_numbers_by_name() -> None:
    own = from_dict({"filter": {"kind": "own", "stiffness": 2, "leak": 0.5}})
    assert isinstance(own.filter, OwnConfig)
    assert own.filter.numbers == {"stiffness": 2.0, "leak": 0.5}
    changed = override(own, ["filter.leak=0.25"])
    assert changed.filter == OwnConfig(stiffness=2.0, leak=0.25)
    described = {name: value for name, value, _ in changed.filter.described()}
    assert described == {"kind": "own", "stiffness": 2.0, "leak": 0.25}
    assert changed != own


@pytest.mark.parametrize(
    ("section", "facts"),
    [
        ({"kind": "kalmann"}, ['filter.kind = "kalmann"', "observer", "own", "'kalman'"]),
        ({"kind": 3}, ["filter.kind = 3", "observer"]),
        ({"kind": "kalman", "vectr": 1.0}, ["filter.vectr", "did you mean filter.vector"]),
        ({"kind": "kalman", "gamma": 1.0}, ["filter.gamma", "unknown key"]),
        ({"kind": "kalman", "vector": 0.0}, ["filter.vector = 0.0", "1e-09"]),
        ({"kind": "observer", "velocity": 0.1}, ["filter.velocity", "unknown key"]),
        ({"schedule": "switch"}, ['filter.schedule = "switch"', "fuzzy", "constant", "smooth"]),
        ({"kind": "own", "stiffness": "high"}, ['filter.stiffness = "high"', "number"]),
        ({"kind": "own", "leak": float("nan")}, ["filter.leak = nan", "finite"]),
        ({"kind": "own", "leak": [1.0, 2.0]}, ["filter.leak = [1.0, 2.0]", "number"]),
        ({"kind": "own", "leak": True}, ["filter.leak = true", "number"]),
    ],
)
def test_a_filter_that_can_not_be_is_refused_by_its_key(section: dict, facts: list[str]) -> None:
    assert_states(refusal({"filter": section}), *facts)


def test_only_an_observer_needs_two_vectors_for_their_cross_product() -> None:
    alone = {"scenario": {"vectors": [{"direction": [0, 0, 1]}], "landmarks": []}}
    for position in ([1, 0, 0], [0, 1, 0], [0, 0, 1]):
        alone["scenario"]["landmarks"].append({"position": position})
    assert_states(refusal(alone), "filter.cross_vector = true", "two vectors")
    assert from_dict(alone | {"filter": {"kind": "kalman"}}).filter == KalmanConfig()


# Changes ------------------------------------------------------------------------------------------


def test_another_kind_has_its_own_defaults_and_what_is_named() -> None:
    kalman = override(BASE, ["filter.kind=kalman", "filter.vector=0.3"])
    assert kalman.filter == KalmanConfig(vector=0.3)
    assert "filter.vector" not in [one.key for one in kalman.also]
    assert BASE.replace(filter=KalmanConfig(vector=0.3)).filter == KalmanConfig(vector=0.3)
    assert kalman.scenario == BASE.scenario
    back = override(kalman, ["filter.kind=observer", "filter.gamma=3.0"])
    assert back.filter == ObserverConfig(gamma=3.0)
    recommended = [one for one in BASE.also if one.key != "filter.gamma"]
    assert [*back.also] == recommended, "what is tuned by default, except for the named"
    listed = '{key="filter.vector", lower=0.1, upper=1.0}'
    asked = override(BASE, ["filter.kind=kalman", f"parameters.also=[{listed}]"])
    assert [one.key for one in asked.also] == ["filter.vector"]


def test_bounds_follow_a_gain_range_that_is_named_with_another_kind() -> None:
    settings = ["filter.kind=kalman", "parameters.gain_range=[0, 50]"]
    kalman = override(BASE, settings)
    assert kalman.parameters.upper == override(BASE, settings[1:]).parameters.upper


def test_a_constant_gain_has_no_error_signal_to_tune() -> None:
    constant = override(BASE, ["filter.schedule=constant"])
    keys = [one.key for one in constant.also]
    assert keys == [one.key for one in BASE.also if not one.key.startswith("gain.")]
    assert constant.filter == ObserverConfig(schedule="constant")
    also = [one.model_dump(mode="json") for one in BASE.also if one.key == "gain.smoothing"]
    with pytest.raises(ConfigError, match=r"gain\.smoothing"):
        constant.replace(**{"parameters.also": [one | {"upper": one["upper"] + 1} for one in also]})


# The numbers of the last tuning -------------------------------------------------------------------


@pytest.mark.parametrize("schedule", COUNTS)
def test_a_schedule_has_as_many_numbers_as_it_needs_or_none(schedule: str) -> None:
    own = COUNTS[schedule]
    experiment = from_dict(with_numbers(schedule, own))
    assert experiment.tuned.numbers == tuple(5.0 + i for i in range(own))
    assert from_dict(tomllib.loads(to_toml(experiment))) == experiment
    hash(experiment)
    assert from_dict(with_numbers(schedule, 0)).tuned == TunedConfig()
    for wrong in {*COUNTS.values(), own + 1, own - 1} - {own, 0}:
        said = refusal(with_numbers(schedule, wrong))
        assert_states(said, f"tuned.numbers = {wrong}", f"{own} of a {schedule} gain", "none")


@pytest.mark.parametrize("kind", ["kalman", "own"])
def test_a_filter_without_a_schedule_has_none(kind: str) -> None:
    data = {"filter": {"kind": kind}, "tuned": {"numbers": [1.0]}}
    assert_states(refusal(data), "tuned.numbers = 1", "none")


def test_further_numbers_are_those_that_can_be_tuned() -> None:
    good = {"filter.gamma": 3.0, "scenario.landmarks.0.weight": 0.5}
    experiment = from_dict({"tuned": {"also": good}})
    assert experiment.tuned.also == good
    assert hash(experiment) == hash(from_dict({"tuned": {"also": dict(reversed(good.items()))}}))
    assert from_dict(tomllib.loads(to_toml(experiment))) == experiment
    for wrong, facts in (
        ({"filter.gama": 3.0}, ["tuned.also.filter.gama = 3.0", "no effect", "filter.gamma"]),
        ({"filter.gamma": -3.0}, ["tuned.also.filter.gamma = -3.0", "0"]),
    ):
        assert_states(refusal({"tuned": {"also": wrong}}), *facts)
    own = {"filter": {"kind": "own", "leak": 1.0}}
    assert from_dict(own | {"tuned": {"also": {"filter.leak": 2.0}}}).tuned.also == {
        "filter.leak": 2.0
    }
    assert_states(
        refusal(own | {"tuned": {"also": {"filter.gamma": 2.0}}}), "tuned.also.filter.gamma"
    )


def test_they_are_gone_with_another_schedule_unless_named() -> None:
    tuned = TunedConfig(numbers=K, also={"filter.gamma": 3.0})
    base = BASE.replace(tuned=tuned)
    assert override(base, ["run.seed=3", "filter.gain_limit=1.0"]).tuned == tuned
    for kind in ("filter.schedule=constant", "filter.kind=kalman"):
        assert override(base, [kind]).tuned == TunedConfig()
    named = override(base, ["filter.schedule=constant", "tuned.numbers=[20.0]"])
    assert named.tuned == TunedConfig(numbers=(20.0,))
    with pytest.raises(ConfigError, match=r"tuned\.numbers = 1\s.*none"):
        override(base, ["filter.kind=kalman", "tuned.numbers=[20.0]"])


EXPERIMENTS = sorted(CONFIGS.glob("*.toml"))


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_the_numbers_of_a_shipped_file_are_within_its_bounds(path: Path) -> None:
    experiment = config.load(path)
    bounds = {one.key: (one.lower, one.upper) for one in experiment.also}
    assert experiment.tuned.also.keys() in (set(), bounds.keys())
    for key, value in experiment.tuned.also.items():
        low, high = bounds[key]
        assert low * (1 - 1e-6) <= value <= high * (1 + 1e-6), key
    if numbers := experiment.tuned.numbers:
        space = parameter_space(experiment)
        lower, upper = experiment.parameters.lower, experiment.parameters.upper
        assert len(numbers) % 22 == 0
        for first in range(0, len(numbers), 22):  # a Kalman filter has several controllers
            own = numbers[first : first + 22]
            assert isinstance(space.controller(space.checked(own)), FuzzyController)
            for low, value, high in zip(lower, own, upper, strict=True):
                assert low - 1e-4 <= value <= high + 1e-4


def test_numbers_of_the_last_tuning_go_where_a_change_leaves_them_without_meaning() -> None:
    recommended = config.load("recommended")
    without = override(recommended, ["filter.unknown=off"])
    assert without.tuned == config.TunedConfig()
    assert [one.key for one in without.also] == [
        one.key for one in recommended.also if not one.key.startswith("filter.unknown_")
    ]
    assert override(recommended, ["filter.vector=0.2"]).tuned == recommended.tuned
    with pytest.raises(ConfigError, match=r"tuned\.numbers"):
        override(recommended, ["tuned.numbers=[1.0]"])
