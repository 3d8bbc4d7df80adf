"""Errors long after the window that a filter was tuned for."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from helpers.messages import assert_states
from helpers.results import endurance as made

from posegsa import config
from posegsa.judging import endurance as endurance_module
from posegsa.judging.endurance import Endurance, endurance
from posegsa.judging.metrics import error_tracks
from posegsa.model.schedules import ConstantGain
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import endurance_keys, held_out_keys, training_keys
from posegsa.search.population import ScenarioBatch
from posegsa.search.problem import tuning_problem

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

RUN = tiny()
"""The experiment of `test_evaluate`, so that it is compiled once."""
SHORT = config.override(
    RUN, ["scenario.duration=0.3", "cost.transient_window=[0, 9]", "cost.steady_window=[15, 28]"]
)
COUNT = RUN.run.endurance_scenarios


def constant(gain: float) -> Candidate:
    return Candidate(ConstantGain(jnp.float32(gain)))


def long_after(experiment: config.Experiment, settings: Sequence[str] = ()) -> Endurance:
    problem = tuning_problem(config.override(experiment, settings))
    return endurance(problem, constant(20), constant(3))


def test_windows_double_and_errors_are_root_mean_squares() -> None:
    found = long_after(RUN)
    np.testing.assert_allclose(found.begin, [0, 2, 4, 8])
    np.testing.assert_allclose(found.end, [2, 4, 8, 16])

    longer = config.override(RUN, ["scenario.duration=16.0"])
    batch = scenario_batch(longer, endurance_keys(RUN.run.seed, COUNT))
    for gain, attitude, position, distance in (
        (20, found.attitude, found.position, found.distance),
        (3, found.other_attitude, found.other_position, found.other_distance),
    ):
        track = error_tracks(constant(gain), batch)
        assert track.position.shape == (COUNT, 1600)
        angle = np.degrees(np.arccos(1 - 2 * np.asarray(track.attitude, np.float64)))
        for w, (first, last) in enumerate(((0, 200), (200, 400), (400, 800), (800, 1600))):
            for rms, errors in (
                (attitude[w], angle),
                (position[w], track.position),
                (distance[w], track.distance),
            ):
                window = np.asarray(errors, np.float64)[:, first:last]
                assert rms == pytest.approx(np.sqrt(np.mean(window**2)), rel=1e-5)
    assert found.position[-1] < 0.7 * found.other_position[-1], "the gains differ"


def test_it_is_as_long_as_configured_and_counts_to_the_end() -> None:
    settings = ["run.endurance_times=3", "run.endurance_scenarios=1", "family.duration=[0.1, 0.2]"]
    found = long_after(SHORT, settings)
    np.testing.assert_allclose(found.begin, [0, 0.3, 0.6])
    np.testing.assert_allclose(found.end, [0.3, 0.6, 0.9])
    assert (found.position > 0).all()
    once = long_after(SHORT, ["run.endurance_times=1"])
    assert once.end.tolist() == [0.3]
    assert once.worse() == []


def test_it_runs_a_user_s_own_filter() -> None:
    by_hand = constant(20).applied(tuning_problem(RUN).simulated.filter)
    short = ["scenario.duration=0.3", "cost.transient_window=[0, 9]", "cost.steady_window=[15, 28]"]
    experiment = config.override(config.load("kalman"), [*short, "filter.kind=own"])
    problem = tuning_problem(experiment, own=by_hand)
    found = endurance(problem, Candidate(), Candidate())
    np.testing.assert_array_equal(found.attitude, found.other_attitude)
    assert (found.attitude > 0).all()


def test_what_precedes_a_start_from_the_sensors_does_not_count(monkeypatch) -> None:
    begins = 0.01 * jnp.array([0.0, 150.0] + [80.0] * (COUNT - 2), jnp.float32)

    def late(*given: Any) -> ScenarioBatch:
        return scenario_batch(*given)._replace(begin=begins)

    before = long_after(RUN)
    monkeypatch.setattr(endurance_module, "scenario_batch", late)
    found = long_after(RUN)
    longer = config.override(RUN, ["scenario.duration=16.0"])
    batch = scenario_batch(longer, endurance_keys(RUN.run.seed, COUNT))
    distance = np.asarray(error_tracks(constant(20), batch).distance, np.float64)
    first = [0, 150, *[80] * (COUNT - 2)]
    counted = np.concatenate([one[k:200] for one, k in zip(distance, first, strict=True)])
    assert found.distance[0] == pytest.approx(np.sqrt(np.mean(counted**2)), rel=1e-5)
    np.testing.assert_allclose(found.distance[1:], before.distance[1:], rtol=1e-12)


def test_its_scenarios_are_no_others() -> None:
    seed = RUN.run.seed
    keys = {
        tuple(key)
        for some in (
            endurance_keys(seed, COUNT),
            training_keys(seed, 100),
            held_out_keys(seed, 100),
        )
        for key in jax.random.key_data(some).tolist()
    }
    assert len(keys) == COUNT + 200


def test_worse_names_the_windows_after_the_first() -> None:
    assert made().worse() == []
    worse = made(attitude=np.array([99.0, 6, 8.5, 5]), position=np.array([9.0, 0.2, 0.2, 0.3]))
    # Equal is not worse. The first window is skipped, because the cost judges it.
    assert worse.worse() == ["attitude from 30 to 60 s", "P_err from 60 to 120 s"]


def test_the_distance_has_a_table_and_a_warning_of_its_own() -> None:
    far = made(distance=np.array([3.0, 0.25, 0.2, 1.0]))
    assert far.worse() == ["distance from 60 to 120 s"]
    title, *_, last, words = far.table(("tuned filter", "constant"), 16).splitlines()
    assert_states(title, "16")
    assert last.split("  ")[0] == "60 to 120 s"
    assert [float(cell) for cell in last.replace("deg", "cm").split() if cell.count(".")] == [
        *(5.5, 10.0, 100.0),
        *(8.5, 20.0, 80.0),
    ]
    assert "|P_est - R_err P|" in words


def test_nan_is_worse() -> None:
    lost = made(position=np.array([3.0, 0.2, np.nan, np.inf]))
    assert lost.worse() == ["P_err from 30 to 60 s", "P_err from 60 to 120 s"]
