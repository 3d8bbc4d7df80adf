"""[[parameters.also]]: which further numbers a search may tune, and which are refused."""

import tomllib

import pytest
from helpers.experiments import BASE
from helpers.messages import assert_states

from posegsa import config
from posegsa.config.tunable import AlsoTuned, tunable
from posegsa.errors import ConfigError
from posegsa.filters.kalman import KalmanNoise

pytestmark = pytest.mark.quick

PLAIN = config.override(config.Experiment(), BASE)
"""An experiment without estimated biases and without further tuned numbers."""
LEARNT = {
    *("filter.vector_bias_gain", "filter.vector_bias_leak", "filter.vector_bias_bound"),
    *("filter.excitation", "filter.excitation_time"),
}
"""An experiment that tunes a number of the law of the vectors' biases."""
ALWAYS = {
    *("filter.gamma.0", "filter.gamma.1", "filter.gain_limit", "filter.length"),
    *("gain.position_weight", "gain.smoothing", "gain.error_scale", "gain.rate_scale"),
    *("scenario.vectors.0.weight", "scenario.vectors.1.weight", "scenario.landmarks.0.weight"),
}
CROSS = {"filter.cross_vector_weight"}


def also(*entries: dict) -> list[str]:
    """The setting that tunes these further numbers."""
    tables = ", ".join(
        "{" + ", ".join(f"{name} = {value!r}" for name, value in entry.items()) + "}"
        for entry in entries
    )
    return [f"parameters.also=[{tables}]"]


def refusal(*entries: dict, base: config.Experiment | None = None) -> str:
    """The error about these further numbers, on one line."""
    with pytest.raises(ConfigError) as caught:
        config.override(base or PLAIN, also(*entries))
    return " ".join(str(caught.value).split())


@pytest.mark.parametrize(
    ("settings", "keys"),
    [
        ([], ALWAYS | CROSS),
        (["filter.vector_bias=estimated"], ALWAYS | CROSS | LEARNT),
        (["filter.cross_vector=false"], ALWAYS),
        (
            ["filter.bias_bound=[0.5, 1.5]"],
            ALWAYS | CROSS | {"filter.bias_bound.0", "filter.bias_bound.1"},
        ),
        (["filter.gain_limit=off"], (ALWAYS | CROSS) - {"filter.gain_limit"}),
        (
            ["filter.gamma=3.0"],
            (ALWAYS | CROSS | {"filter.gamma"}) - {"filter.gamma.0", "filter.gamma.1"},
        ),
        (
            ["scenario.landmarks=[{position=[1, 0, 0]}, {position=[0, 1, 0]}]"],
            ALWAYS | CROSS | {"scenario.landmarks.1.weight"},
        ),
    ],
)
def test_tunable_is_what_has_an_effect(settings, keys) -> None:
    assert set(tunable(config.override(PLAIN, settings))) == keys


def test_every_tunable_key_is_taken_and_written_back() -> None:
    base = config.override(PLAIN, ["filter.vector_bias=estimated"])
    keys = list(tunable(base))
    wanted = [{"key": key, "lower": 0.5, "upper": 2.0, "scale": "logarithmic"} for key in keys]
    experiment = config.override(base, also(*wanted))
    assert experiment.parameters.also == tuple(AlsoTuned(**one) for one in wanted)
    assert config.from_dict(tomllib.loads(config.to_toml(experiment))) == experiment


def test_an_unknown_key_is_refused_with_those_there_are() -> None:
    said = refusal({"key": "filter.gama", "lower": 1.0, "upper": 2.0})
    assert_states(said, 'parameters.also.0.key = "filter.gama"', *tunable(PLAIN))


@pytest.mark.parametrize(
    "key",
    [
        "filter.substeps",  # an integer, and static
        "filter.vector_bias_gain",  # no bias is estimated
        "scenario.vectors.2.weight",  # only two vectors
        "scenario.velocity_noise",  # a property of the world, not of the filter
        "../scenario",
        "filter.gamma",  # a pair here; each number has its own key
    ],
)
def test_a_number_without_effect_is_refused(key) -> None:
    good = {"key": "filter.gain_limit", "lower": 1.0, "upper": 2.0}
    said = refusal(good, {"key": key, "lower": 1.0, "upper": 2.0})
    assert_states(said, f'parameters.also.1.key = "{key}"')
    assert "parameters.also.0" not in said


RECOMMENDED = {one.key for one in config.Experiment().also}
OF_BIAS = {"filter.vector_bias_gain"}


def keys_of(experiment: config.Experiment) -> set[str]:
    """The further tuned numbers for several error signals; written out they are the same."""
    written = config.from_dict(tomllib.loads(config.to_toml(experiment)))
    assert written == experiment
    assert written.also == experiment.also
    return {one.key for one in experiment.also}


@pytest.mark.parametrize(
    ("settings", "gone"),
    [
        ([], set()),
        (["filter.vector_bias=off"], OF_BIAS),
        (["filter.law=printed"], {"filter.length"}),
        (["gain.unknown=off"], set()),
        (["filter.gamma=3.0"], {"filter.gamma"}),
        (["filter.gamma=[3.0, 4.0]"], {"filter.gamma"}),
        (["gain.smoothing=1.0", "filter.vector_bias=off"], {"gain.smoothing"} | OF_BIAS),
        (["scenario.landmarks.0.weight=1.0"], {"scenario.landmarks.0.weight"}),
        (["scenario.vectors.1.weight=1.0"], set()),
        (["scenario.landmarks.0.noise=0.2"], set()),
    ],
)
def test_stated_or_ineffective_keys_of_the_default_list_are_not_tuned(settings, gone) -> None:
    assert keys_of(config.override(config.Experiment(), settings)) == RECOMMENDED - gone


def test_the_same_holds_for_a_file_and_for_python() -> None:
    stated = {"filter": {"gamma": 3.0, "vector_bias": "off"}, "scenario": {"duration": 60.0}}
    assert keys_of(config.from_dict(stated)) == RECOMMENDED - OF_BIAS - {"filter.gamma"}
    (gamma,) = (one for one in config.Experiment().also if one.key == "filter.gamma")
    both = stated | {"parameters": {"also": [gamma]}}
    assert keys_of(config.from_dict(both)) == {"filter.gamma"}, "stated, and asked for"
    python = config.Experiment(filter=config.ObserverConfig(vector_bias="off"))
    assert keys_of(python) == RECOMMENDED - OF_BIAS
    stated = config.Experiment(
        filter=config.ObserverConfig(gamma=3.5), gain=config.GainConfig(smoothing=0.0)
    )
    assert keys_of(stated) == RECOMMENDED - {"filter.gamma", "gain.smoothing"}


def test_what_is_off_is_not_tuned_by_default_and_what_is_on_is() -> None:
    whole = config.load("observer")
    of_unknown = {"gain.unknown", "gain.unknown_fall", "gain.unknown_rise"}
    assert keys_of(whole) == RECOMMENDED | of_unknown | {"filter.bias_wait", "filter.length_growth"}
    off = config.override(whole, ["gain.unknown=off", "filter.bias_wait=off"])
    assert keys_of(off) == RECOMMENDED | {"filter.length_growth"}
    assert not off.tuned.numbers, "they were of another filter"


def test_bounds_with_which_the_rest_is_wrong_are_refused() -> None:
    base = config.override(PLAIN, ["filter.cross_vector=false", "scenario.vectors.0.weight=1.0"])
    alone = {"key": "scenario.landmarks.0.weight", "lower": 0.0, "upper": 3.0}
    said = refusal(alone, base=base)
    assert_states(said, "lower bounds", "scenario.vectors")


def test_what_is_asked_for_and_has_no_effect_is_refused() -> None:
    own = {"key": "filter.excitation", "lower": 0.1, "upper": 0.2}  # not the default bounds
    assert_states(refusal(own), 'parameters.also.0.key = "filter.excitation"')


def test_tuned_numbers_stay_within_their_bounds() -> None:
    base = config.Experiment()
    found = config.with_tuned(base, {"filter.gamma": 20.000001, "gain.smoothing": 0.0999999})
    assert found.filter.gamma == 20.0
    assert found.gain.smoothing == 0.1
    assert found.also == base.also


KALMAN = config.override(PLAIN, ["filter.kind=kalman"])
OWN = config.override(PLAIN, ["filter.kind=own", "filter.stiffness=2.0", "filter.leak=0.0"])
CONSTANT = config.override(PLAIN, ["filter.schedule=constant"])


def test_of_another_filter_its_own_numbers_are_tunable() -> None:
    noises = {f"filter.{name}" for name in KalmanNoise._fields}
    of_biases = {"filter.vector_walk", "filter.initial_vector_bias"}
    assert keys_of(KALMAN) == noises
    assert keys_of(config.override(KALMAN, ["filter.vector_bias=off"])) == noises - of_biases
    assert keys_of(config.override(KALMAN, ["filter.vector=0.3"])) == noises - {"filter.vector"}
    assert keys_of(config.from_dict({"filter": {"kind": "kalman", "vector": 0.3}})) == noises - {
        "filter.vector"
    }
    assert keys_of(OWN) == set(), "only what is asked for is tuned"
    entries = [
        {"key": f"filter.{name}", "lower": 0.5, "upper": 3.0} for name in ("leak", "stiffness")
    ]
    own = config.override(OWN, also(*entries))
    assert keys_of(own) == {"filter.leak", "filter.stiffness"}
    tuned = config.with_tuned(own, {"filter.stiffness": 9.0, "filter.leak": 1.0})
    assert tuned.filter == config.OwnConfig(stiffness=3.0, leak=1.0)


@pytest.mark.parametrize(
    ("base", "key"),
    [
        (KALMAN, "filter.gamma.0"),
        (KALMAN, "gain.smoothing"),
        (KALMAN, "scenario.vectors.0.weight"),
        (KALMAN, "filter.vector_bias"),
        (OWN, "filter.gamma.0"),
        (OWN, "gain.smoothing"),
        (OWN, "scenario.vectors.0.weight"),
        (CONSTANT, "gain.smoothing"),
    ],
)
def test_a_number_of_another_filter_is_refused(base, key) -> None:
    said = refusal({"key": key, "lower": 1.0, "upper": 2.0}, base=base)
    assert_states(said, f'parameters.also.0.key = "{key}"', "no effect")


def test_a_key_twice_is_refused() -> None:
    one = {"key": "gain.smoothing", "lower": 1.0, "upper": 2.0}
    assert_states(refusal(one, one), 'parameters.also.1.key = "gain.smoothing"', "once")


@pytest.mark.parametrize(
    ("entry", "facts"),
    [
        (
            {"key": "gain.smoothing", "lower": -1.0, "upper": 2.0},
            ["parameters.also.0.lower = -1.0", "gain.smoothing", "0"],
        ),
        (
            {"key": "filter.gamma.1", "lower": -1.0, "upper": 2.0},
            ["parameters.also.0.lower = -1.0", "filter.gamma.1", "0"],
        ),
        (
            {"key": "gain.error_scale", "lower": 0.0, "upper": 2.0},
            ["parameters.also.0.lower = 0.0", "gain.error_scale", "1e-09"],
        ),
        (
            {"key": "filter.gain_limit", "lower": -3.0, "upper": 0.0},
            ["parameters.also.0.upper = 0.0", "filter.gain_limit"],
        ),
        (
            {"key": "scenario.landmarks.0.weight", "lower": 0.0, "upper": 2e9},
            ["parameters.also.0.upper = 2000000000.0", "1000000000"],
        ),
        ({"key": "gain.smoothing", "lower": 3.0, "upper": 2.0}, ["at most upper = 2.0"]),
        (
            {"key": "gain.smoothing", "lower": 0.0, "upper": 2.0, "scale": "logarithmic"},
            ["above 0", 'scale = "logarithmic"'],
        ),
        ({"key": "gain.smoothing", "lower": 0.0}, ["parameters.also.0.upper"]),
        (
            {"key": "gain.smoothing", "lower": 0.0, "upper": 1.0, "scale": "log"},
            ["log", "logarithmic"],
        ),
    ],
)
def test_bounds_that_a_number_may_not_have_are_refused(entry, facts) -> None:
    assert_states(refusal(entry), *facts)


def test_a_number_may_be_held_at_one_value() -> None:
    fixed = {"key": "gain.smoothing", "lower": 0.0, "upper": 0.0}
    assert config.override(PLAIN, also(fixed)).parameters.also[0].upper == 0
