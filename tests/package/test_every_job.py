"""Every job for every filter on every kind of data: one table, each of whose cells is tried."""

import runpy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from helpers.experiments import TINY
from helpers.recordings import bench, inertial_motion
from jax import Array

import posegsa
from posegsa import config, evaluating
from posegsa.judging.baselines import Baseline, baselines
from posegsa.judging.description import Description
from posegsa.judging.evaluation import RANDOM, TUNED
from posegsa.judging.result import Result
from posegsa.model.schedules import Gains, ScheduleInputs
from posegsa.recordings.recording import Recording


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearGain:
    """A gain schedule of a user's own, K = low + slope e."""

    low: Array
    slope: Array

    def initial_gain(self) -> Array:
        """K without an error."""
        return self.low

    def prepare(self) -> "LinearGain":
        """Nothing to compute."""
        return self

    def __call__(self, inputs: ScheduleInputs) -> Gains:
        """K [1/s] of the scaled error."""
        return Gains(self.low + self.slope * inputs.error)


def observer_with_linear_gain(low: Array, slope: Array) -> posegsa.Observer:
    """The observer with a schedule of the user's own."""
    return posegsa.Observer(
        LinearGain(low, slope), posegsa.filter_settings(config.override(config.Experiment(), TINY))
    )


EXAMPLES = Path(__file__).parents[2] / "examples"
OWN = {"kind": "own"}
FILTERS: dict[str, tuple[dict[str, Any], Callable[..., Any] | None]] = {
    "fuzzy": ({}, None),
    "smooth": ({"schedule": "smooth"}, None),
    "believing": ({"schedule": "constant", "belief": "ramp"}, None),
    "kalman": ({"kind": "kalman", "vector_bias": "off"}, None),
    "scheduled kalman": (
        {"kind": "kalman", "vector_bias": "off", "belief": "fuzzy", "unknown": "switch"},
        None,
    ),
    "imu": ({"kind": "imu"}, None),
    "own filter": (
        OWN | {"attitude_gain": 5.0, "position_gain": 4.0, "bias_gain": 0.2},
        runpy.run_path(str(EXAMPLES / "own_filter.py"))["ComplementaryFilter"],
    ),
    "own schedule": (OWN | {"low": 5.0, "slope": 40.0}, observer_with_linear_gain),
}
"""By name: its section of the configuration, and what the user passes."""
SEARCHED = {
    "kalman": "vector",
    "scheduled kalman": "belief_smoothing",
    "imu": "heading",
    "own filter": "attitude_gain",
    "own schedule": "low",
}
"""A number that is searched, of filters without a schedule of posegsa."""
DATA = ("scenarios", "recordings")
ONLY_RECORDINGS = ("imu",)
"""Filters that read sensors which no scenario has."""


def experiment(name: str) -> config.Experiment:
    """A small experiment with a filter."""
    section, _ = FILTERS[name]
    data = config.override(config.Experiment(), TINY).model_dump(mode="json")
    if "kind" in section:
        data["filter"] = section
        key, value = f"filter.{SEARCHED[name]}", section.get(SEARCHED[name], 0.1)
        ends = {"lower": 0.5 * value, "upper": 2.0 * value}
        data["parameters"]["also"] = [{"key": key, **ends}]
    else:
        data["filter"] |= section
    data["run"] |= {"training_scenarios": 1, "held_out_scenarios": 2, "endurance_times": 1}
    data["search"] = {"optimiser": "de", "agents": 4, "iterations": 2}
    return config.from_dict(data)


@cache
def recording(seen: str, filter: str = "") -> Recording:
    """A short recording with the sensors of the experiment, or of the filter."""
    if filter in ONLY_RECORDINGS:
        return posegsa.imu(**inertial_motion(1.0, 1.0), name=seen)
    return Recording.from_arrays(**bench(), name=seen)


@cache
def tuned(name: str, data: str) -> Result:
    """The filter, tuned on scenarios or on a recording."""
    recordings: dict[str, Any] = {}
    if data == "recordings":
        recordings = {"recordings": recording("one", name), "held_out": recording("other", name)}
    return posegsa.tune(experiment(name), filter=FILTERS[name][1], **recordings)


def cell(name: str, data: str) -> Any:
    return pytest.param(name, data, id=f"{name}, {data}")


def found(name: str) -> Result:
    """The filter, tuned on scenarios if it reads what they have."""
    return tuned(name, "recordings" if name in ONLY_RECORDINGS else "scenarios")


CELLS = [
    cell(name, data)
    for name in FILTERS
    for data in DATA
    if data == "recordings" or name not in ONLY_RECORDINGS
]


@pytest.mark.parametrize(("name", "data"), CELLS)
def test_every_filter_is_tuned(name: str, data: str) -> None:
    result = tuned(name, data)
    assert result.search is not None
    assert np.isfinite(result.search.best_cost)
    assert result.search.best_cost <= result.search.history.best[0]
    judged = result.on_scenarios if data == "scenarios" else result.on_recordings
    assert judged is not None
    numbers = result.filter.numbers.values() if SEARCHED.get(name) is None else result.also
    assert len(numbers) >= 1


@pytest.mark.parametrize(("name", "data"), CELLS)
def test_every_filter_is_evaluated(name: str, data: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def one_of_them(experiment: config.Experiment, found: Description) -> dict[str, Baseline]:
        return {RANDOM: baselines(experiment, found)[RANDOM]}  # each of the others takes a search

    monkeypatch.setattr(evaluating, "baselines", one_of_them)
    result = found(name)
    if data == "recordings":
        unseen = recording("other", name)
        on = posegsa.evaluate(result, recordings=unseen, others=False).on_recordings
        assert on is not None
        assert np.isfinite(on.held_out[0].errors["judged"].total)
    else:
        on = posegsa.evaluate(result, scenarios=3).on_scenarios
        assert on is not None
        assert {TUNED, RANDOM} <= set(on.evaluation.contenders)
        assert np.isfinite(on.evaluation.cost(TUNED).mean)


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_runs_as_a_stream(name: str) -> None:
    """A stream computes what the filter computes over arrays."""
    result, seen = found(name), recording("one", name)
    start, m = seen.initial(), seen.measurements
    known = {"vector_references": np.asarray(m.vector_references)[0]}
    known |= {"landmark_references": np.asarray(m.landmark_references)[0]}
    stream = posegsa.PoseFilter(
        result, rotation=start.rotation, position=start.position, bias=start.bias, **known
    )
    arrays = result.estimate(seen)
    for k in range(5):
        pose = stream.update(
            time_step=0.01,
            angular_velocity=m.angular_velocity[k],
            velocity=m.velocity[k],
            vectors=m.vectors[k],
            landmarks=m.landmarks[k],
        )
        np.testing.assert_allclose(pose.rotation, arrays.rotation[k + 1], atol=2e-5)
        if not seen.attitude_only:
            np.testing.assert_allclose(pose.position, arrays.position[k + 1], atol=2e-5)


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_is_written_as_c(name: str) -> None:
    """`tests/export` runs the C; here each kind of filter of a result comes out as a header."""
    header = posegsa.export_c(found(name))
    assert "posegsa_step(" in header
    assert "Tuned with posegsa" in header


@pytest.mark.parametrize("name", FILTERS)
def test_every_result_is_saved_and_read(name: str, tmp_path: Any) -> None:
    result = tuned(name, "recordings")
    posegsa.save(result, tmp_path / "run", figures=[])
    again = posegsa.load(tmp_path / "run", filter=FILTERS[name][1])
    assert again.filter == result.filter
    first, second = (one.estimate(recording("one", name)).rotation[-1] for one in (result, again))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", ONLY_RECORDINGS)
def test_what_no_scenario_has_is_refused_there(name: str) -> None:
    with pytest.raises(posegsa.PosegsaError, match=r"filter\.kind = .imu.* allowed: recordings"):
        posegsa.tune(experiment(name))
    with pytest.raises(posegsa.PosegsaError, match=r"filter\.kind = .imu.* allowed: recordings"):
        posegsa.evaluate(posegsa.configured(name), scenarios=3)
