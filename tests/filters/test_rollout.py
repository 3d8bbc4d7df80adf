"""Whole simulations, against the reference: the compiled chain in float64, agent by agent."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import as_arrays
from helpers.controllers import repaired_terms, search_vectors
from helpers.experiments import PAPER, lasting, paper, space
from helpers.filters import start, state_of
from helpers.measurements import (
    cost_of_estimates,
    directions,
    reference_samples,
    reference_start,
    reference_truth,
    sensed,
    tracked,
    world,
)
from jax import Array
from scipy.spatial.transform import Rotation

from posegsa.config import Experiment
from posegsa.filters.observer import Observer
from posegsa.filters.rollout import (
    Estimates,
    simulate,
    simulate_cost,
    simulate_errors,
)
from posegsa.judging.trajectory import trajectory
from posegsa.model.measurements import Measurements
from posegsa.model.scenario import Truth
from posegsa.model.schedules import ConstantGain, FuzzyGain, GainSchedule, SwitchGain
from posegsa.model.se3 import Quaternion
from posegsa.model.signal import SignalSettings
from posegsa.recordings.running import run_filter
from posegsa.search.configured_filters import filter_of as observer_of
from posegsa.search.configured_filters import filter_settings, signal_settings
from posegsa.search.drawn_scenarios import cost_weights

VECTOR = search_vectors(1, seed=1)[0]
"""A typical schedule; its gains range from 11 to 75 in the paper's scenario."""
THREE = [[1.0, 0.2, -0.3], [-0.2, 0.8, 0.4], [0.1, -0.5, 1.4]]
"""Independent vectors, neither orthogonal nor of equal length."""
TWO = [[0.5, 1.4, 1.0], [-1.0, 0.3, 2.0]]
"""Landmarks [m]."""
cost_of = jax.jit(simulate_cost)


@cache
def fuzzy_schedule() -> FuzzyGain:
    return FuzzyGain(space().controller(jnp.asarray(VECTOR)))


def observed(experiment: Experiment, schedule: GainSchedule | None = None) -> Observer:
    """The experiment's observer with a schedule, by default `fuzzy_schedule`."""
    return replace(observer_of(experiment), schedule=schedule or fuzzy_schedule())


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


def as_used(experiment: Experiment) -> dict[str, Any]:
    """Vector settings of the reference, and the weights of vectors and landmarks."""
    f, scenario = experiment.filter, experiment.scenario
    return {
        "normalise": f.normalise_vectors,
        "cross_weight": f.cross_vector_weight if f.cross_vector else None,
        "vector_weights": [v.weight for v in scenario.vectors],
        "landmark_weights": [p.weight for p in scenario.landmarks],
    }


def reference_run(
    experiment: Experiment,
    measurements: Measurements,
    truth: np.ndarray,
    gain: Callable[[float, float, float], float],
    learning: Callable[[float], float] = lambda time: 1.0,
) -> reference.Trajectory:
    """The reference's trajectory, at an experiment's settings."""
    f, g = experiment.filter, experiment.gain
    gamma = f.gamma if isinstance(f.gamma, tuple) else (f.gamma, f.gamma)
    law = reference.VectorBias(
        gain=f.vector_bias_gain,
        leak=f.vector_bias_leak,
        bound=f.vector_bias_bound,
        excitation=f.excitation,
        excitation_time=f.excitation_time,
        law=f.vector_bias_law,
    )
    return reference.run(
        reference_samples(measurements),
        reference_start(PAPER.scenario),
        np.array(PAPER.scenario.initial_bias_estimate),
        truth,
        gain,
        signal=g.signal,
        position_weight=g.position_weight,
        smoothing=g.smoothing,
        error_scale=g.error_scale,
        rate=g.rate,
        rate_scale=g.rate_scale,
        vector_bias=law if f.vector_bias == "estimated" else None,
        learning=learning,
        unknown=None if g.unknown == "off" else (g.unknown, g.unknown_fall, g.unknown_rise),
        bias_wait=None if f.bias_wait == "off" else f.bias_wait,
        length=f.length,
        length_growth=0.0 if f.length_growth == "off" else f.length_growth,
        landmark_unit=f.landmark_unit,
        as_used=as_used(experiment),
        law=f.law,
        gamma=gamma,
        gamma_law=f.gamma_law,
        substeps=f.substeps,
        gain_limit=None if f.gain_limit == "off" else f.gain_limit,
        bias_bounds=None if f.bias_bound == "off" else f.bias_bound,
    )


def assert_same_run(
    estimates: Estimates, expected: reference.Trajectory, signal: SignalSettings
) -> None:
    """Every signal within 1e-9 of its largest magnitude."""
    pairs = {
        "rotation": (estimates.rotation, expected.T_est[:, :3, :3]),
        "position": (estimates.position, expected.T_est[:, :3, 3]),
        "bias": (estimates.bias, expected.b_est),
        "gain": (estimates.gain, expected.gain),
        "error": (
            estimates.error,
            np.maximum(np.clip(expected.e / signal.error_scale, 0, 1), expected.unknown),
        ),
        "rate": (estimates.rate, np.clip(expected.rate * signal.rate_scale, 0, 1)),
    }
    if estimates.vector_bias.shape[1] > 0:
        pairs["vector_bias"] = (estimates.vector_bias, expected.c_est)
    for name, (ours, theirs) in pairs.items():
        off = np.abs(np.asarray(ours) - theirs).max()
        assert off <= 1e-9 * np.abs(theirs).max(), f"{name}: {off}"


def assert_same_errors(truth: Truth, estimates: Estimates, expected: reference.Trajectory) -> None:
    made = trajectory(
        truth.rotation, truth.position, estimates, np.zeros((estimates.vector_bias.shape[1], 3))
    )
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
    signal = signal_settings(experiment.gain, "float64")
    observer = observed(experiment)

    estimates = simulate(observer, scenario, initial)
    assert_same_run(estimates, expected, signal)
    assert_same_errors(truth, estimates, expected)

    weights = cost_weights(experiment.cost, 1500, jnp.dtype("float64"))
    cost = cost_of(observer, scenario, initial, weights)
    theirs = reference.cost(expected.attitude_error, expected.position_error)
    np.testing.assert_allclose(cost.total, theirs, rtol=1e-8)

    # The gain limit is at work: K_used = min(K, c / (dt L)) is not K.
    limited = np.minimum(expected.gain, gain_limits(experiment, measurements, expected))
    np.testing.assert_allclose(estimates.gain_used, limited, rtol=1e-8)
    assert (limited < expected.gain).sum() > 10
    np.testing.assert_allclose(estimates.time, 0.01 * np.arange(1500), rtol=1e-12)


def gain_limits(
    experiment: Experiment, measurements: Measurements, expected: reference.Trajectory
) -> np.ndarray:
    """c / (dt/n L) of the first sub-step of each sample (N,)."""
    f, limits = experiment.filter, []
    assert f.gain_limit != "off"
    samples = reference_samples(measurements)
    for T, c, sample in zip(expected.T_est, expected.c_est, samples, strict=True):
        s = reference.used_sample(sample, c, **as_used(experiment))
        L = reference.curvature(T, s.y, s.p, s.sL, s.vB, s.vI, s.sR)
        limits.append(f.gain_limit * f.substeps / (s.dt * L) if L > 0 else np.inf)
    return np.array(limits)


class Chain(NamedTuple):
    """Settings of a chain: filter, signal and sensors."""

    settings: tuple[str, ...]
    vectors: int = 2
    landmarks: int = 1
    missing: float = 0.0


RAW = ("filter.normalise_vectors=false", "filter.cross_vector=false")
"""Vectors are used as measured."""
LEARNT = ("filter.vector_bias=estimated", "filter.vector_bias_gain=2.0")
"""Their biases are estimated, fast enough to matter in two seconds."""
SCALED = (
    "gain.error_scale=0.5",
    "gain.rate_scale=3.0",
    "gain.position_weight=0.4",
    "gain.smoothing=0.05",
)
"""Every number of the signal differs from the paper's."""
CHAINS = {  # each needs its own compilation, so each combines many options
    "as the paper": Chain((*SCALED, "filter.gamma=[4.0, 6.0]"), missing=0.3),
    "printed law, pose signal": Chain(
        (*RAW, "filter.law=printed", "filter.gamma=1.0", "gain.signal=pose")
    ),
    "four sub-steps, no limit": Chain(
        (*RAW, "filter.substeps=4", "filter.gain_limit=off", "filter.gamma_law=linear"),
        vectors=3,
        landmarks=2,
    ),
    "biases of one vector": Chain(
        (*LEARNT, "filter.cross_vector=false", "filter.gamma_law=linear"), vectors=1, landmarks=2
    ),
    "biases of two vectors": Chain(
        (
            *LEARNT,
            "filter.cross_vector_weight=0.4",
            "filter.excitation=1.0",
            "filter.excitation_time=0.3",
            "filter.substeps=2",
            "filter.gamma_law=quadratic",
            "filter.vector_bias_law=quadratic",
            "filter.bias_bound=[0.5, 1.5]",
            "gain.smoothing=0.02",
        ),
        missing=0.3,
    ),
    "what is unknown, a growing length": Chain(
        (
            *LEARNT,
            *("filter.gamma_law=quadratic", "filter.substeps=2", "filter.bias_wait=0.4"),
            *("filter.length=1.5", "filter.length_growth=0.3", "gain.smoothing=0.05"),
            "filter.landmark_unit=length",
            *("gain.unknown=0.4", "gain.unknown_fall=0.05", "gain.unknown_rise=0.6"),
        ),
        landmarks=2,
        missing=0.3,
    ),
}
OWN = Chain(
    (
        *LEARNT,
        "filter.normalise_vectors=false",
        "filter.vector_bias_leak=0.5",
        "filter.vector_bias_bound=0.1",
        "gain.rate=per_second",
        "gain.rate_scale=0.02",
    ),
    vectors=3,
    landmarks=2,
    missing=0.4,
)
"""The chain for a user's own measurements."""


def weighted(chain: Chain) -> Experiment:
    """The experiment of a chain, with a different weight for each vector and landmark."""
    vectors = [
        f"{{direction = {v}, weight = {w}}}" for v, w in zip(THREE, (0.8, 1.3, 0.5), strict=True)
    ]
    landmarks = [f"{{position = {p}, weight = {w}}}" for p, w in zip(TWO, (1.2, 0.7), strict=True)]
    return paper(
        *lasting(2.0),
        f"scenario.vectors=[{', '.join(vectors[: chain.vectors])}]",
        f"scenario.landmarks=[{', '.join(landmarks[: chain.landmarks])}]",
        *chain.settings,
    )


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS.keys())
def test_the_chain_against_the_reference(chain: Chain) -> None:
    experiment = weighted(chain)
    rng = np.random.default_rng(2)
    # Where measurements are missing the time steps are uneven too.
    step = rng.uniform(0.005, 0.015, 200) if chain.missing else np.full(200, 0.01)
    true_poses, measurements = sensed(
        step,
        THREE[: chain.vectors],
        TWO[: chain.landmarks],
        missing=chain.missing,
        vector_bias=0.2,
    )
    expected = reference_run(experiment, measurements, true_poses, reference_gain(experiment))
    settings = filter_settings(experiment)
    scenario = tracked(measurements, true_poses, observed(experiment), "float64")
    signal = signal_settings(experiment.gain, "float64")
    learnt = chain.vectors if settings.vector_bias is not None else 0

    estimates = simulate(observed(experiment), scenario, start("float64"))
    assert_same_run(estimates, expected, signal)
    assert estimates.vector_bias.shape == (200, learnt, 3)
    if learnt:
        assert np.abs(expected.c_est[-1]).max() > 0.05
        length = np.linalg.norm(estimates.vector_bias, axis=-1).max()
        assert length <= experiment.filter.vector_bias_bound * (1 + 1e-12)
    if isinstance(bounds := experiment.filter.bias_bound, tuple):
        longest = np.linalg.norm(estimates.bias.reshape(200, 2, 3), axis=-1).max(axis=0)
        assert (longest <= np.array(bounds) * (1 + 1e-12)).all()
        assert (longest > 0.8 * np.array(bounds)).all(), "reached"
    # A gain well below the limit is used unchanged, in sub-steps too.
    if experiment.filter.gain_limit == "off":
        free = np.full(200, True)
    else:
        free = expected.gain < 0.5 * gain_limits(experiment, measurements, expected)
    assert free.sum() > 10
    np.testing.assert_allclose(estimates.gain_used[free], expected.gain[free], rtol=1e-8)
    # The cost of the trajectory. That the running sum is the same is only tested above and in
    # test_cost, because it takes one more compilation per case.
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
    step = np.random.default_rng(1).uniform(0.002, 0.02, 200)
    experiment = weighted(OWN)
    true_poses, measurements = sensed(step, THREE, TWO, missing=OWN.missing, vector_bias=0.2)
    nothing = (measurements.vector_weights.sum(axis=1) == 0) & (
        measurements.landmark_weights.sum(axis=1) == 0
    )
    assert nothing[1:].any()  # some samples have only the velocities
    expected = reference_run(experiment, measurements, true_poses, reference_gain(experiment))
    signal = signal_settings(experiment.gain, "float64")
    own = as_arrays(measurements, "float64")
    estimates = run_filter(observed(experiment), own, start("float64"))
    assert_same_run(estimates, expected, signal)
    np.testing.assert_allclose(estimates.time, np.cumsum(step) - step, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(np.asarray(estimates.gain_used)[nothing], estimates.gain[nothing])
    # A part that can't be measured keeps its value.
    error, k = np.asarray(estimates.error), np.flatnonzero(nothing[1:]) + 1
    np.testing.assert_array_equal(error[k], error[k - 1])
    length = np.linalg.norm(estimates.vector_bias, axis=-1)
    assert 0.05 < length.max() <= experiment.filter.vector_bias_bound * (1 + 1e-12)
    assert (np.asarray(estimates.rate)[k] == 0).all()


@pytest.mark.usefixtures("x64")
def test_a_switch_of_gain_and_learning_against_the_reference() -> None:
    experiment = weighted(CHAINS["biases of two vectors"])
    step = np.full(200, 0.01)
    true_poses, measurements = sensed(step, THREE[:2], TWO[:1], vector_bias=0.2)
    # Half a sample away from one, so that rounding of the time can't matter.
    before, after, time, learning_time = 40.0, 6.0, 0.705, 1.205
    clock = iter(0.01 * np.arange(200))
    expected = reference_run(
        experiment,
        measurements,
        true_poses,
        lambda error, rate, last: before if next(clock) < time else after,
        learning=lambda now: float(now >= learning_time),
    )
    signal = signal_settings(experiment.gain, "float64")
    schedule = SwitchGain(*(jnp.asarray(x) for x in (before, after, time, learning_time)))
    observer = observed(experiment, schedule)
    scenario = tracked(measurements, true_poses, observer, "float64")
    estimates = simulate(observer, scenario, start("float64"))
    assert_same_run(estimates, expected, signal)
    assert (np.asarray(estimates.vector_bias)[:121] == 0).all()
    assert (np.asarray(estimates.vector_bias)[122] != 0).any()


@pytest.mark.usefixtures("x64")
def test_run_filter_refuses_the_pose_signal() -> None:
    experiment = weighted(OWN._replace(settings=(*OWN.settings, "gain.signal=pose")))
    _, measurements = sensed(np.full(200, 0.01), THREE, TWO)
    with pytest.raises(ValueError, match=r'"pose".*"measured"'):
        run_filter(
            observed(experiment, ConstantGain(jnp.asarray(10.0))),
            as_arrays(measurements, "float64"),
            state_of(np.eye(4)),
        )


# Under JAX's transformations ----------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_derivatives_of_the_cost_by_the_parameters_are_those_of_the_cost() -> None:
    experiment = paper(*lasting(2.0))
    true_poses, measurements = sensed(np.full(200, 0.01), THREE[:2], [[0.5, 1.4, 1]])
    made = space()
    scenario = tracked(measurements, true_poses, observed(experiment), "float64")
    weights = cost_weights(experiment.cost, 200, jnp.dtype("float64"))

    given = scenario, start("float64"), weights

    def observer(k: np.ndarray) -> Observer:
        return observed(experiment, FuzzyGain(made.controller(k)))

    of_vector = jax.jit(observer)

    def cost(k: np.ndarray) -> float:
        return float(cost_of(of_vector(k), *given).total)

    k = VECTOR
    slope = jax.jit(
        lambda k, along: jax.jvp(
            lambda k: simulate_cost(observer(k), *given).total, (k,), (along,)
        )[1]
    )
    rng, h = np.random.default_rng(0), 1e-6
    width = reference.PAPER_UPPER - reference.PAPER_LOWER
    slopes = []
    for along in rng.normal(size=(4, 22)) * width:
        ahead, behind = (cost(k + s * h * along) for s in (1, -1))
        slopes.append(float(slope(k, along)))
        # Rounding of the difference, 1e-13 / h, and the kinks of min and max that h steps over.
        assert slopes[-1] == pytest.approx((ahead - behind) / (2 * h), rel=1e-4)
    assert np.isfinite(slopes).all()
    assert np.abs(slopes).min() > 1e-3


def test_attitude_errors_of_half_a_turn_are_not_rounded_above_one() -> None:
    samples = jax.tree.map(lambda a: a[:1], world(paper(dtype="float32")).samples)
    turns = Rotation.random(1000, rng=np.random.default_rng(0))
    half_turns = Rotation.from_rotvec(np.pi * directions(1000)) * turns
    true, estimated = (
        tuple(jnp.asarray(r.as_quat(scalar_first=True).T, jnp.float32)) for r in (half_turns, turns)
    )

    @jax.jit
    @jax.vmap
    def attitude(true: Quaternion, estimated: Quaternion) -> Array:
        truth = samples.truth._replace(attitude=tuple(a[None] for a in true))
        initial = start("float32")._replace(attitude=estimated)
        filter = Observer(ConstantGain(jnp.float32(5)), filter_settings(PAPER))
        return simulate_errors(filter, samples._replace(truth=truth), initial).attitude[0]

    assert attitude(true, estimated).max() == 1
