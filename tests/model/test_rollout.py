"""Whole simulations, against the reference: the compiled chain in float64, agent by agent."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from builders import as_arrays
from setups import (
    PAPER,
    cost_of_estimates,
    lasting,
    paper,
    reference_samples,
    reference_start,
    reference_truth,
    repaired_terms,
    search_vectors,
    sensed,
    space,
    start,
    tracked,
    world,
)

from posegsa.config import Experiment
from posegsa.judging.trajectory import trajectory
from posegsa.model.filter import initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import Estimates, run_filter, simulate, simulate_cost
from posegsa.model.scenario import Truth
from posegsa.model.schedules import ConstantGain, FuzzyGain
from posegsa.model.signal import SignalSettings
from posegsa.search.build import cost_weights, filter_settings, signal_settings

VECTOR = search_vectors(1, seed=1)[0]
"""A schedule with nothing special about it; its gains run from 11 to 75 in the paper's scenario."""
THREE = [[1.0, 0.2, -0.3], [-0.2, 0.8, 0.4], [0.1, -0.5, 1.4]]
"""Vectors that are independent, neither orthogonal nor of one length."""
cost_of = jax.jit(simulate_cost)


def fuzzy_schedule() -> FuzzyGain:
    return FuzzyGain(space().controller(jnp.asarray(VECTOR)))


def reference_gain(experiment: Experiment) -> Callable[[float, float, float], float]:
    """The gain function of `VECTOR` as the reference evaluates it."""
    inputs, outputs = (t[0] for t in repaired_terms(VECTOR[None]))
    sampled = experiment.fuzzy.centroid == "sampled"
    points = experiment.fuzzy.sampled_points
    options: dict[str, Any] = {"no_rule": experiment.fuzzy.no_rule}
    if sampled:
        options["centroid"] = lambda h, t: reference.sampled_centroid(h, t, 0.0, 100.0, points)

    def gain(error: float, rate: float, last: float) -> float:
        rules = reference.PAPER_RULES
        return reference.fuzzy_gain(error, rate, inputs, outputs, rules, last, **options)

    return gain


def reference_run(
    experiment: Experiment,
    measurements: Measurements,
    truth: np.ndarray,
    gain: Callable[[float, float, float], float],
) -> reference.Trajectory:
    """The reference's trajectory, at an experiment's settings."""
    f, g = experiment.filter, experiment.gain
    gamma = f.gamma if isinstance(f.gamma, tuple) else (f.gamma, f.gamma)
    return reference.run(
        reference_samples(measurements),
        reference_start(PAPER.scenario),
        np.array(PAPER.scenario.initial_bias_estimate),
        truth,
        gain,
        signal=g.signal,
        position_weight=g.position_weight,
        error_scale=g.error_scale,
        rate_scale=g.rate_scale,
        law=f.law,
        gamma=gamma,
        substeps=f.substeps,
        gain_limit=None if f.gain_limit == "off" else f.gain_limit,
    )


def assert_same_run(
    estimates: Estimates, expected: reference.Trajectory, signal: SignalSettings
) -> None:
    """Every signal within 1e-8 of its largest magnitude."""
    change = np.abs(np.diff(expected.e, prepend=expected.e[0]))
    pairs = {
        "rotation": (estimates.rotation, expected.T_est[:, :3, :3]),
        "position": (estimates.position, expected.T_est[:, :3, 3]),
        "bias": (estimates.bias, expected.b_est),
        "gain": (estimates.gain, expected.gain),
        "error": (estimates.error, np.clip(expected.e / signal.error_scale, 0, 1)),
        "rate": (estimates.rate, np.clip(change * signal.rate_scale, 0, 1)),
    }
    for name, (ours, theirs) in pairs.items():
        off = np.abs(np.asarray(ours) - theirs).max()
        assert off <= 1e-8 * np.abs(theirs).max(), f"{name}: {off}"


def assert_same_errors(truth: Truth, estimates: Estimates, expected: reference.Trajectory) -> None:
    made = trajectory(truth, estimates)
    for ours, theirs in (
        (made.attitude_distance, expected.attitude_error),
        (made.position_error, expected.position_error),
    ):
        assert np.abs(ours - theirs).max() <= 1e-8 * theirs.max()


# The whole chain ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_the_papers_experiment_against_the_reference() -> None:
    experiment = paper()
    truth, measurements, scenario, initial = world(experiment)
    true_poses = reference_truth(experiment.scenario)
    expected = reference_run(experiment, measurements, true_poses, reference_gain(experiment))
    settings = filter_settings(experiment.filter, "float64")
    signal = signal_settings(experiment.gain, "float64")

    estimates = simulate(fuzzy_schedule(), scenario, initial, settings, signal)
    assert_same_run(estimates, expected, signal)
    assert_same_errors(truth, estimates, expected)

    weights = cost_weights(experiment.cost, 1500, jnp.dtype("float64"))
    cost = cost_of(fuzzy_schedule(), scenario, initial, weights, settings, signal)
    theirs = reference.cost(expected.attitude_error, expected.position_error)
    np.testing.assert_allclose(cost.total, theirs, rtol=1e-8)

    # The gain limit is at work: K_used = min(K, c / (dt L)) is not K.
    limited = np.minimum(expected.gain, gain_limits(measurements, expected, 1.5, 0.01))
    np.testing.assert_allclose(estimates.gain_used, limited, rtol=1e-8)
    assert (limited < expected.gain).sum() > 10
    np.testing.assert_allclose(estimates.time, 0.01 * np.arange(1500), rtol=1e-12)


def gain_limits(
    measurements: Measurements, expected: reference.Trajectory, c: float, step: float
) -> np.ndarray:
    """c / (step L) at each sample (N,)."""
    pairs = zip(expected.T_est, reference_samples(measurements), strict=True)
    curvature = [reference.curvature(T, s.y, s.p, s.sL, s.vB, s.vI, s.sR) for T, s in pairs]
    return c / (step * np.array(curvature))


CHAINS: dict[str, tuple[tuple[str, ...], list, list]] = {
    # settings, vectors, landmarks
    "printed law": (("filter.law=printed", "filter.gamma=1.0"), THREE[:2], [[0.5, 1.4, 1]]),
    "two sub-steps": (("filter.substeps=2",), THREE[:2], [[0.5, 1.4, 1]]),
    "no gain limit": (("filter.substeps=4", "filter.gain_limit=off"), THREE[:2], [[0.5, 1.4, 1]]),
    "pose signal, two landmarks": (
        ("gain.signal=pose",),
        THREE[:2],
        [[0.5, 1.4, 1], [-1, 0.3, 2]],
    ),
    "scaled signal, three vectors, two gammas": (
        (
            "gain.error_scale=0.5",
            "gain.rate_scale=3.0",
            "gain.position_weight=0.4",
            "filter.gamma=[4.0, 6.0]",
        ),
        THREE,
        [[0.5, 1.4, 1]],
    ),
}


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("changes", "vectors", "landmarks"), CHAINS.values(), ids=CHAINS.keys())
def test_the_chain_against_the_reference(
    changes: tuple[str, ...], vectors: list, landmarks: list
) -> None:
    experiment = paper(*lasting(2.0), *changes)
    true_poses, measurements = sensed(np.full(200, 0.01), vectors, landmarks)
    expected = reference_run(experiment, measurements, true_poses, reference_gain(experiment))
    scenario = tracked(measurements, true_poses, "float64")
    settings = filter_settings(experiment.filter, "float64")
    signal = signal_settings(experiment.gain, "float64")

    estimates = simulate(fuzzy_schedule(), scenario, start("float64"), settings, signal)
    assert_same_run(estimates, expected, signal)
    # In sub-steps too, a gain well under the limit is used as it is.
    limits = gain_limits(measurements, expected, 1.5, 0.01 / settings.substeps)
    free = expected.gain < 0.5 * limits
    assert free.sum() > 10
    np.testing.assert_allclose(estimates.gain_used[free], expected.gain[free], rtol=1e-8)
    # The cost of the trajectory; that the running form is the same is shown once, above and in
    # test_cost, because it is one more compilation for each case.
    c = experiment.cost
    weights = cost_weights(c, 200, jnp.dtype("float64"))
    theirs = reference.cost(
        expected.attitude_error,
        expected.position_error,
        transient=c.transient_window,
        steady=c.steady_window,
    )
    cost = cost_of_estimates(estimates, scenario, weights)
    np.testing.assert_allclose(cost.total, theirs, rtol=1e-8)


# A user's own measurements ------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_run_filter_with_missing_measurements_and_uneven_steps_against_the_reference() -> None:
    step = np.random.default_rng(1).uniform(0.002, 0.02, 300)
    landmarks = [[0.5, 1.4, 1], [-1, 0.3, 2]]
    true_poses, measurements = sensed(step, THREE, landmarks, missing=0.4)
    nothing = (measurements.vector_weights.sum(axis=1) == 0) & (
        measurements.landmark_weights.sum(axis=1) == 0
    )
    assert nothing.any()  # some samples have only the velocities
    experiment = paper()
    expected = reference_run(experiment, measurements, true_poses, reference_gain(experiment))
    settings = filter_settings(experiment.filter, "float64")
    signal = signal_settings(experiment.gain, "float64")
    own = as_arrays(measurements, "float64")
    estimates = run_filter(fuzzy_schedule(), own, start("float64"), settings, signal)
    assert_same_run(estimates, expected, signal)
    np.testing.assert_allclose(estimates.time, np.cumsum(step) - step, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(np.asarray(estimates.gain_used)[nothing], estimates.gain[nothing])
    assert (np.asarray(estimates.error)[nothing] == 0).all()


def user_measurements(samples: int, dtype: str) -> Measurements:
    _, measurements = sensed(np.full(samples, 0.01), THREE[:2], [[0.5, 1.4, 1]])
    return as_arrays(measurements, dtype)


def test_run_filter_refuses_the_pose_signal() -> None:
    experiment = paper("gain.signal=pose", dtype="float32")
    with pytest.raises(ValueError, match='signal "pose" needs the true pose; use "measured"'):
        run_filter(
            ConstantGain(jnp.asarray(10.0)),
            user_measurements(5, "float32"),
            initial_state(jnp.eye(3), jnp.zeros(3)),
            filter_settings(experiment.filter, "float32"),
            signal_settings(experiment.gain, "float32"),
        )


# Under JAX's transformations ----------------------------------------------------------------------
