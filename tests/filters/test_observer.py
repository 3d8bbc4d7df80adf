"""The observer: one step against the reference, its state, and under JAX's transformations."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference
from helpers.arrays import as_arrays
from helpers.filters import (
    GAMMA,
    biases,
    fitting,
    jitted_observe,
    jitted_prepare,
    jitted_state,
    jitted_transform,
    leaves_close,
    matrices,
    observed,
    prepared,
    prepared_for,
    random_estimates,
    random_samples,
    settings,
    stacked,
    state_of,
    stepped,
    vector_bias,
    vector_biases,
    vector_settings,
    with_vector_biases,
)
from helpers.measurements import random_measurements, random_poses, reference_sample
from hypothesis import given
from hypothesis import strategies as st
from jax import Array

from posegsa.config import (
    Experiment,
    ObserverConfig,
    ParametersConfig,
    RunConfig,
    override,
)
from posegsa.errors import ArgumentError
from posegsa.filters.observer import FilterSettings, Observer, bias_gains, see
from posegsa.model.estimate import FilterState, initial_state
from posegsa.model.measurements import Measurements
from posegsa.model.sample import prepare
from posegsa.model.schedules import ConstantGain
from posegsa.recordings.running import run_filter
from posegsa.search.configured_filters import filter_settings

COUNT = 30
"""Number of states stepped at once; mostly the same, so that programs are compiled once."""
SEQUENCE = 40
"""Number of samples filtered one after the other; likewise."""

# One step against the reference ------------------------------------------------------------------


def check_against_reference(
    vectors: int, landmarks: int, missing: float = 0.3, **options: Any
) -> None:
    """Random states, each with its own measurements, weights, time step and gain."""
    count, rng = COUNT, np.random.default_rng(vectors + 10 * landmarks)
    raw = random_measurements(rng, count, vectors, landmarks, missing)
    T, b, state = random_estimates(rng, count)
    # With limit 1.5 the largest of these gains are cut, the smallest not.
    gains = 10 ** rng.uniform(-0.5, 1.6, count)
    sample = jitted_prepare(as_arrays(raw, np.float64))
    after, used = jitted_observe(state, sample, gains, settings(**options))
    limit = {"gain_limit": 1.5} | options
    steps = [
        reference.filter_step(T[k], b[k], reference_sample(raw, k), gains[k], gamma=GAMMA, **limit)
        for k in range(count)
    ]
    # Absolute tolerances, for numbers up to about 10.
    np.testing.assert_allclose(matrices(after), [T for T, _ in steps], rtol=0, atol=1e-10)
    np.testing.assert_allclose(biases(after), [b for _, b in steps], rtol=0, atol=1e-10)
    if limit["gain_limit"] is None:
        np.testing.assert_allclose(used, gains, rtol=1e-15)
    else:
        assert (np.asarray(used) <= gains * (1 + 1e-15)).all()


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("law", "substeps", "gain_limit"),
    [  # with and without sub-steps; each law with and without the limit
        ("gradient", 1, 1.5),
        ("gradient", 2, None),
        ("printed", 2, None),
        ("printed", 2, 1.5),
    ],
)
def test_a_step_is_the_references_for_both_laws_substeps_and_limit(
    law, substeps, gain_limit
) -> None:
    check_against_reference(2, 1, law=law, gain_limit=gain_limit, substeps=substeps)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("vectors", "landmarks"),
    [(0, 0), (0, 2), (1, 0), (3, 2)],
)
def test_a_step_is_the_references_for_any_number_of_vectors_and_landmarks(
    vectors, landmarks
) -> None:
    check_against_reference(vectors, landmarks, missing=0.5)


@pytest.mark.usefixtures("x64")
def test_a_sample_without_measurements_only_moves_by_the_velocity() -> None:
    rng = np.random.default_rng(0)
    raw = random_measurements(rng, COUNT, 2, 1, missing=1.0)
    T, b, state = random_estimates(rng, COUNT)
    gain = np.full(COUNT, 20.0)
    after, used = jitted_observe(state, jitted_prepare(as_arrays(raw, float)), gain, settings())
    poses = matrices(after)
    for k in range(COUNT):
        Y = np.concatenate([raw.angular_velocity[k], raw.velocity[k]])
        moved = T[k] @ reference.se3_exp((Y - b[k]) * raw.time_step[k])
        np.testing.assert_allclose(poses[k], moved, atol=1e-13)
    np.testing.assert_array_equal(biases(after), b)
    np.testing.assert_array_equal(used, gain)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("substeps", [1, 2])
def test_the_gain_used_is_the_least_of_gain_and_limit_averaged_over_substeps(substeps) -> None:
    count, rng = COUNT, np.random.default_rng(0)
    raw = random_measurements(rng, count, 2, 1)
    T, b, state = random_estimates(rng, count)
    gains = 10 ** rng.uniform(-0.5, 2.5, count)
    sample = jitted_prepare(as_arrays(raw, float))
    _, used = jitted_observe(state, sample, gains, settings(substeps=substeps))
    want = np.zeros((count, substeps))
    for k in range(count):
        T_est, b_est, seen = T[k], b[k], reference_sample(raw, k)
        h = seen.dt / substeps
        for j in range(substeps):
            L = reference.curvature(T_est, seen.y, seen.p, seen.sL, seen.vB, seen.vI, seen.sR)
            want[k, j] = min(gains[k], 1.5 / (h * L))
            # A sub-step is a step of dt / n without velocity.
            still = replace(seen, dt=h, omega=b_est[:3], v=b_est[3:])
            T_est, b_est = reference.filter_step(T_est, b_est, still, want[k, j], gamma=GAMMA)
    limited = want[:, 0] < gains
    assert limited.any()
    assert not limited.all()
    np.testing.assert_allclose(used, want.mean(axis=1), rtol=1e-11)


@pytest.mark.usefixtures("x64")
def test_a_sequence_with_uneven_steps_and_dropouts_online_at_once_and_by_the_reference() -> None:
    # The vectors' biases are estimated from a state without biases.
    rng = np.random.default_rng(4)
    raw = random_measurements(rng, SEQUENCE, 2, 1, missing=0.4)
    m = as_arrays(raw, np.float64)
    law = {"gain": 0.5, "leak": 0.1, "bound": 0.5, "excitation": 0.2, "excitation_time": 1.0}
    chosen, K = learning(**law), 8.0
    observer = Observer(ConstantGain(jnp.asarray(K)), chosen)
    (T,), (b,), states = random_estimates(rng, 1)
    state = plain = jax.tree.map(lambda a: a[0], states)
    c, turning = np.zeros((2, 3)), np.zeros(3)
    online, by_reference = [], []
    for k in range(SEQUENCE):
        # Sample k is the estimate before its update, so that sample 0 is the initial one.
        online.append(with_none(state))
        by_reference.append((T, b, c))
        state = stepped(state, m.at(k), K, chosen)
        sample, gains = reference_sample(raw, k), []
        used = reference.used_sample(sample, c, normalise=True, cross_weight=0.5)
        after = reference.filter_step(
            *(T, b, used, K),
            gamma=GAMMA,
            gamma_law="linear",
            substeps=2,
            gain_limit=1.5,
            gains_used=gains,
        )
        c, turning = reference.learn_vector_biases(
            *(T, b, c, turning, sample, 1.0),
            reference.VectorBias(**law, law="fixed"),
            float(np.mean(gains)),
        )
        T, b = after
    one_by_one = stacked(jax.tree.map(lambda *a: np.stack(a), *online))
    for start in (plain, with_none(plain)):
        estimates = run_filter(observer, m, start)
        at_once = np.asarray(jitted_transform(estimates.rotation, estimates.position))
        found = at_once, estimates.bias, estimates.vector_bias
        wanted = zip(*by_reference, strict=True)
        for got, loop, want in zip(found, one_by_one, wanted, strict=True):
            np.testing.assert_allclose(got, loop, rtol=0, atol=1e-12)
            # Rounding, slightly amplified because the measurements fit no pose.
            np.testing.assert_allclose(got, want, rtol=0, atol=1e-10)
    assert np.abs(c).max() > 0.01
    np.testing.assert_allclose(estimates.time, np.cumsum(raw.time_step) - raw.time_step)


def with_none(state: FilterState) -> FilterState:
    """The state; if it has no vector biases, with those of two vectors, all 0."""
    zero = np.zeros_like(state.place[0])
    zeros = (zero, zero, zero)
    return state if state.turning else state._replace(vector_biases=(zeros,) * 2, turning=zeros)


# The state and the settings ----------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("shape", [(), (2, 3)])
def test_the_state_returns_its_input(shape) -> None:
    rng = np.random.default_rng(0)
    T = random_poses(rng, int(np.prod(shape))).reshape(*shape, 4, 4)
    b = rng.normal(size=(*shape, 6))
    state = jitted_state(T[..., :3, :3], T[..., :3, 3], b)
    again, bias, _ = stacked(state)
    np.testing.assert_allclose(again, T, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(np.asarray(again)[..., :3, 3], T[..., :3, 3])
    np.testing.assert_array_equal(bias, b)
    assert {a.shape for a in jax.tree.leaves(state)} == {shape}


def test_the_bias_is_zero_unless_given() -> None:
    bias = biases(jitted_state(np.eye(3, dtype=np.float32), np.ones(3, np.float32)))
    assert bias.tolist() == [0] * 6
    assert bias.dtype == np.float32


def test_integers_make_a_floating_point_state() -> None:
    with jax.numpy_dtype_promotion("standard"):  # as a user may pass it
        made = jax.eval_shape(lambda: initial_state(np.eye(3, dtype=int), [4, -3, 5], [0] * 6))
    assert {a.dtype for a in jax.tree.leaves(made)} == {np.dtype(np.float32)}


@pytest.mark.parametrize("wide", [False, True], ids=["32 bits", "64 bits allowed"])
@pytest.mark.parametrize("gain", [5, 5.0, np.float32(5)], ids=["int", "float", "numpy"])
def test_step_takes_a_gain_of_any_kind_and_keeps_the_states_dtype(gain, wide) -> None:
    raw, T, b = one_sample()
    state, chosen = state_of(T, b, np.float32), settings(np.float32)
    with jax.enable_x64(wide):
        after = jax.eval_shape(lambda: stepped(state, raw.at(0), gain, chosen))
    assert {a.dtype for a in jax.tree.leaves(after)} == {np.dtype(np.float32)}


@pytest.mark.parametrize(("gain", "wide"), [(5, True), (np.float32(5), False)])
def test_step_is_the_references_whatever_the_kind_of_the_gain(gain, wide) -> None:
    raw, T, b = one_sample()
    with jax.enable_x64(wide):
        after = stepped(state_of(T, b, np.float32), raw.at(0), gain, settings(np.float32))
        found = stacked(after)[:2]
    T, b = (a.astype(np.float64) for a in (T, b))
    want = reference.filter_step(T, b, reference_sample(raw, 0), 5.0, gamma=GAMMA, gain_limit=1.5)
    for a, wanted in zip(found, want, strict=True):
        np.testing.assert_allclose(a, wanted, rtol=0, atol=2e-6)


def one_sample() -> tuple[Measurements, np.ndarray, np.ndarray]:
    """One sample of two vectors and a landmark, a pose and a bias, in float32."""
    rng = np.random.default_rng(0)
    raw, (T, b, _) = random_measurements(rng, 1, 2, 1), random_estimates(rng, 1)
    raw, T, b = jax.tree.map(lambda a: a.astype(np.float32), (raw, T, b))
    return raw, T[0], b[0]


def test_step_compiles_once_for_all_numbers(caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(0)
    m = as_arrays(random_measurements(rng, 3, 2, 1, missing=0.3), np.float32)
    state = as_arrays(jax.tree.map(lambda a: a[0], random_estimates(rng, 1)[2]), np.float32)
    for k, (gamma, limit) in enumerate([((1.0, 2.0), 1.5), ((0.0, 0.0), 0.7), ((5.0, 5.0), 1.0)]):
        chosen = settings(np.float32, gamma=gamma, gain_limit=limit)
        with caplog.at_level("WARNING"), jax.log_compiles():
            state = stepped(state, m.at(k), np.float32(k), chosen)
        if k == 0:
            caplog.clear()
    assert not [r for r in caplog.records if "Compiling" in r.message]


def configured(dtype: Any, **section: Any) -> FilterSettings:
    """The filter settings of a [filter] section, with the paper's scenario."""
    run = RunConfig(dtype=np.dtype(dtype).name)
    parameters = ParametersConfig(also=())  # what else may be tuned depends on the section
    return filter_settings(
        Experiment(run=run, filter=ObserverConfig(**section), parameters=parameters)
    )


def test_filter_settings_are_those_of_the_configuration(dtype) -> None:
    chosen = configured(dtype, gamma=4.0, gain_limit=0.5, substeps=3)
    assert (chosen.law, chosen.gamma_law, chosen.substeps) == ("gradient", "quadratic", 3)
    numbers = (chosen.gamma_angular, chosen.gamma_linear, chosen.gain_limit)
    assert [float(a) for a in numbers] == [4, 4, 0.5]
    assert {a.dtype for a in jax.tree.leaves(chosen)} == {np.dtype(dtype)}
    chosen = configured(dtype, gamma=(1.0, 2.0), gain_limit="off", law="printed")
    assert (float(chosen.gamma_angular), float(chosen.gamma_linear)) == (1, 2)
    assert (chosen.law, float(chosen.gain_limit)) == ("printed", np.inf)
    chosen = configured(dtype, gamma_law="quadratic", normalise_vectors=False, cross_vector=False)
    assert chosen.gamma_law == "quadratic"
    assert (chosen.vectors.normalise, chosen.vectors.cross) == (False, False)
    assert configured(dtype, vector_bias="off").vector_bias is None


def test_weights_and_the_law_of_the_vectors_biases_are_those_of_the_configuration() -> None:
    changes = [
        "scenario.vectors.1.weight=0.25",
        "scenario.landmarks.0.weight=2.0",
        "filter.cross_vector_weight=0.75",
        "filter.vector_bias=estimated",
        "filter.vector_bias_gain=0.5",
        "filter.vector_bias_leak=0.01",
        "filter.vector_bias_bound=0.25",
        "filter.excitation=0.5",
        "filter.excitation_time=2.0",
    ]
    chosen = filter_settings(override(Experiment(), changes))
    assert chosen.vectors.weights is not None
    assert [float(s) for s in chosen.vectors.weights] == [1, 0.25]
    assert float(chosen.vectors.cross_weight) == 0.75
    assert chosen.vectors.each_agent
    assert chosen.landmark_weights is not None
    assert [float(s) for s in chosen.landmark_weights] == [2]
    law = chosen.vector_bias
    assert law is not None
    numbers = (law.gain, law.leak, law.per_bound, law.per_turning, law.excitation_time)
    np.testing.assert_allclose(numbers, [0.5, 0.01, 16, 16, 2], rtol=1e-6)


# Estimated biases of the vectors ------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_an_estimated_bias_is_never_longer_than_its_bound() -> None:
    m, _, state = random_samples(COUNT)
    state = with_vector_biases(state, 3, length=2.0)  # some are beyond the bound already
    chosen = learning(gain=60.0, bound=0.4, excitation=1e-3)
    sample = prepared_for(m, chosen)
    for _ in range(2):
        state, _ = jitted_observe(state, sample, np.full(COUNT, 20.0), chosen)
        length = np.linalg.norm(vector_biases(state), axis=-1)
        assert length.max() <= 0.4 * (1 + 1e-12)
    assert length.max() > 0.3
    assert (length == 0).any()  # a step far beyond the bound starts again at 0


@pytest.mark.usefixtures("x64")
def test_the_estimated_bias_of_a_missing_vector_stays() -> None:
    rng = np.random.default_rng(0)
    m = as_arrays(random_measurements(rng, COUNT, 3, 2, missing=0.5), np.float64)
    state = with_vector_biases(random_estimates(rng, COUNT)[2], 3, length=0.1)
    chosen = learning(leak=0.2, excitation=1e-3)
    after, _ = jitted_observe(state, prepared_for(m, chosen), np.full(COUNT, 5.0), chosen)
    missing = np.asarray(m.vector_weights) == 0
    before, now = vector_biases(state), vector_biases(after)
    np.testing.assert_array_equal(now[missing], before[missing])
    assert (now[~missing] != before[~missing]).all()


@pytest.mark.usefixtures("x64")
def test_at_rest_a_bias_is_not_observable_and_nothing_is_learnt() -> None:
    m, _, state = random_samples(COUNT)
    state = with_vector_biases(state, 3, length=0.1)
    # The measured angular velocity is, and always was, exactly its bias.
    omega = biases(state)[:, :3]
    m = m._replace(angular_velocity=jnp.asarray(omega))
    x, y, z = jnp.asarray(omega.T)
    state = state._replace(turning=(x, y, z))
    chosen = learning()
    still, _ = jitted_observe(state, prepared_for(m, chosen), np.full(COUNT, 5.0), chosen)
    before = vector_biases(state)
    np.testing.assert_allclose(vector_biases(still), before, rtol=0, atol=1e-15)
    # With a leak the estimate decays.
    forgets = learning(leak=0.5)
    leaked, _ = jitted_observe(state, prepared_for(m, forgets), np.full(COUNT, 5.0), forgets)
    kept = (1 - 0.5 * np.asarray(m.time_step))[:, None, None]
    np.testing.assert_allclose(vector_biases(leaked), kept * before, rtol=1e-12)


@pytest.mark.usefixtures("x64")
def test_a_unit_of_length_is_the_same_observer_run_in_that_unit() -> None:
    metres, (m, _, state) = 3.7, random_samples(COUNT)
    K = np.geomspace(0.5, 200.0, COUNT)
    in_metres = settings(gamma_law="quadratic")
    in_metres = replace(in_metres, length=jnp.asarray(metres))
    found, used = jitted_observe(state, jitted_prepare(m), K, in_metres)
    host, at = jax.tree.map(np.asarray, (m, state))
    scaled = host._replace(
        velocity=host.velocity / metres,
        landmarks=host.landmarks / metres,
        landmark_references=host.landmark_references / metres,
        landmark_weights=host.landmark_weights * metres**2,
    )
    start = at._replace(
        place=tuple(a / metres for a in at.place),
        bias_linear=tuple(a / metres for a in at.bias_linear),
    )
    without = replace(in_metres, length=None)
    want, wanted_gain = jitted_observe(start, jitted_prepare(scaled), K, without)
    np.testing.assert_allclose(used, wanted_gain, rtol=1e-12)
    leaves_close(found.attitude, want.attitude, atol=1e-12)
    leaves_close(found.bias_angular, want.bias_angular, atol=1e-12)
    leaves_close(found.place, [metres * np.asarray(a) for a in want.place], atol=1e-11)
    linear = [metres * np.asarray(a) for a in want.bias_linear]
    leaves_close(found.bias_linear, linear, atol=1e-11)
    in_one = replace(in_metres, length=jnp.asarray(1.0))
    one, _ = jitted_observe(state, jitted_prepare(m), K, in_one)
    none, _ = jitted_observe(state, jitted_prepare(m), K, without)
    leaves_close(one, none, atol=1e-14)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("law", "power"), [("linear", 1), ("quadratic", 2)])
def test_gamma_follows_the_gain_used_as_far_as_a_step_is_stable(law, power) -> None:
    K, dt, reach = np.meshgrid(
        np.geomspace(0.01, 1000, 21), np.geomspace(1e-3, 0.5, 11), [0.0, 3.0, 900.0]
    )
    chosen = settings(gamma_law=law, gamma=(40.0, 700.0))
    m = as_arrays(random_measurements(np.random.default_rng(0), COUNT, 2, 1), np.float64)
    sample = jitted_prepare(m)._replace(time_step=jnp.asarray(dt), reach=jnp.asarray(reach))
    found = jax.jit(bias_gains)(K, sample, chosen)
    for gamma, g, stiffer in zip(found, (40, 700), (1 + reach, np.ones_like(reach)), strict=True):
        gamma, wanted = np.asarray(gamma), g * (K / 10) ** power
        step, bound = gamma * dt * stiffer, K / 2
        assert (step <= bound * (1 + 1e-12)).all()
        free = wanted * dt * stiffer <= bound
        assert 0 < free.mean() < 1
        np.testing.assert_allclose(gamma[free], wanted[free], rtol=1e-12)
        np.testing.assert_allclose(step[~free], bound[~free], rtol=1e-12)


# On-line -----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", [0, 1])
@pytest.mark.parametrize("learns", [False, True])
def test_with_fewer_than_two_vectors_there_is_no_cross_product(learns, vectors) -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), COUNT, vectors, 3), np.float64)
    state = random_estimates(np.random.default_rng(0), COUNT)[2]
    chosen = learning() if learns else settings(vectors=vector_settings(cross_weight=0.5))
    without = replace(chosen, vectors=replace(chosen.vectors, cross=False))
    if learns and vectors:
        state = with_vector_biases(state, vectors)

    @jax.jit
    def used(state: FilterState, m: Measurements) -> Any:
        return [see(state, prepare(m, one.vectors), one) for one in (chosen, without)]

    crossed, plain = used(state, m)
    for leaf in jax.tree.leaves(crossed):
        assert np.isfinite(leaf).all()
    leaves_close(crossed, plain, atol=0)


@pytest.mark.usefixtures("x64")
def test_without_vectors_a_filter_that_learns_their_biases_still_takes_a_step() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 1, 0, 3), np.float64)
    start = state_of(np.eye(4))
    after = jax.eval_shape(lambda: stepped(start, m.at(0), 5.0, learning()))
    assert jax.tree.structure(after) == jax.tree.structure(start)


@pytest.mark.usefixtures("x64")
def test_settings_of_another_number_of_sensors_are_refused() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 5, 3, 1), np.float64)
    chosen = filter_settings(override(Experiment(), ["run.dtype=float64"]))
    start = state_of(np.eye(4))
    with pytest.raises(ArgumentError, match=r"vectors.weights: 2 of them; allowed: 3"):
        stepped(start, m.at(0), 5.0, chosen)
    two = state_of(np.eye(4), learnt_vectors=2)
    with pytest.raises(ArgumentError, match=r"vector_biases: of 2 vectors; allowed: 3"):
        stepped(two, m.at(0), 5.0, learning())


# Transformations ---------------------------------------------------------------------------------


def learning(dtype: Any = np.float64, **law: float) -> FilterSettings:
    """Settings of a filter that estimates the vectors' biases and uses every option for vectors."""
    return settings(
        dtype,
        gamma_law="linear",
        substeps=2,
        vectors=vector_settings(dtype, normalise=True, cross_weight=0.5, each_agent=True),
        learnt=vector_bias(dtype, **law),
    )


@pytest.mark.usefixtures("x64")
def test_jit_equals_eager() -> None:
    m, _, state = random_samples(COUNT)
    state, chosen = with_vector_biases(state, 3), learning(leak=0.1)
    inputs = (state, prepared_for(m, chosen), np.linspace(1.0, 40.0, COUNT), chosen)
    leaves_close(jitted_observe(*inputs), observed(*inputs), atol=1e-12)


@pytest.mark.parametrize("wide", [False, True], ids=["32 bits", "64 bits allowed"])
def test_float32_stays_float32(wide) -> None:
    rng = np.random.default_rng(0)
    raw, (T, b, _) = random_measurements(rng, 4, 2, 1), random_estimates(rng, 4)

    def result(raw: Measurements, T: Array, b: Array, gain: Array) -> Any:
        state = initial_state(T[:, :3, :3], T[:, :3, 3], b)
        return observed(state, prepared(raw), gain, settings(np.float32, substeps=2))

    with jax.enable_x64(wide):
        shapes = jax.eval_shape(result, *as_arrays((raw, T, b, np.ones(4)), np.float32))
    assert {a.dtype for a in jax.tree.leaves(shapes)} == {np.dtype(np.float32)}


def test_float32_agrees_with_float64_to_rounding() -> None:
    rng = np.random.default_rng(0)
    raw, (T, b, _) = random_measurements(rng, COUNT, 2, 1), random_estimates(rng, COUNT)
    inputs = raw, np.linspace(1, 40, COUNT)

    def result(dtype: type[np.floating]) -> Any:
        m, gain = as_arrays(inputs, dtype)
        return jitted_observe(state_of(T, b, dtype), jitted_prepare(m), gain, settings(dtype))

    single = result(np.float32)
    with jax.enable_x64(True):
        double = result(np.float64)
    # Numbers up to 40 (gains), after some tens of operations.
    leaves_close(single, double, rtol=1e-5, atol=1e-5)


@jax.jit
def forward_and_reverse(chosen: FilterSettings, *inputs: Any) -> tuple[Any, Any]:
    """Derivatives of the sum of all outputs of a step by state, gain and measurements."""

    def total(state: FilterState, gain: Array, m: Measurements) -> Array:
        after, _ = observed(state, prepare(m, chosen.vectors), gain, chosen)
        return sum(jax.tree.leaves(after))

    ones = jax.tree.map(jnp.ones_like, inputs)
    return jax.jvp(total, inputs, ones), jax.grad(total, argnums=(0, 1, 2))(*inputs)


@pytest.mark.parametrize("gain_limit", [1.5, None], ids=["limited", "no limit"])
@pytest.mark.parametrize("seen", [1.0, 0.0], ids=["all seen", "none seen"])
@pytest.mark.parametrize("learns", [False, True], ids=["", "biases learnt"])
def test_derivatives_are_finite_at_rest_on_the_truth_and_without_measurements(
    learns, seen, gain_limit
) -> None:
    # Every argument of a square root and every divisor is 0 here.
    m = fitting(np.eye(4), np.array([[0.0, 0.0, 1.0]] * 2), np.zeros((1, 3)))
    m = m._replace(vector_weights=np.full(2, seen), landmark_weights=np.full(1, seen))
    state = state_of(np.eye(4), dtype=np.float32, learnt_vectors=2 * learns)
    chosen = replace(learning(np.float32), substeps=1) if learns else settings(np.float32)
    limit = np.float32(np.inf if gain_limit is None else gain_limit)
    chosen = replace(chosen, gain_limit=jnp.asarray(limit))
    forward, reverse = forward_and_reverse(chosen, state, np.float32(3), as_arrays(m, np.float32))
    assert np.isfinite(forward).all()
    for leaf in jax.tree.leaves(reverse):
        assert np.isfinite(leaf).all()


@pytest.mark.usefixtures("x64")
@given(seed=st.integers(0, 2**31))
def test_the_attitude_stays_a_rotation(seed) -> None:
    m, _, state = random_samples(COUNT, seed)
    after, _ = jitted_observe(state, jitted_prepare(m), np.full(COUNT, 20.0), settings())
    norm = np.linalg.norm(np.stack(after.attitude), axis=0)
    np.testing.assert_allclose(norm, np.ones(COUNT), rtol=1e-14)
