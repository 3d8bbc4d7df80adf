"""The observer: one step against the reference, its state, and under JAX's transformations."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from builders import as_arrays, random_measurements, random_poses, reference_sample
from filters import (
    GAMMA,
    fitting,
    jitted_observe,
    jitted_prepare,
    jitted_state,
    jitted_transform,
    leaves_close,
    matrices,
    observed,
    prepared,
    random_estimates,
    random_samples,
    settings,
    vector_bias,
    vector_settings,
    with_vector_biases,
)
from hypothesis import given
from hypothesis import strategies as st
from jax import Array

from posegsa.config import (
    Experiment,
    FilterConfig,
    GainConfig,
    ParametersConfig,
    RunConfig,
    override,
)
from posegsa.errors import ArgumentError
from posegsa.model import se3
from posegsa.model.filter import FilterSettings, FilterState, _step, bias_gains, initial_state, step
from posegsa.model.measurements import Measurements
from posegsa.model.rollout import begin, run_filter, scheduled_step
from posegsa.model.sample import Sample, prepare
from posegsa.model.schedules import ConstantGain
from posegsa.search.build import filter_settings, signal_settings

COUNT = 30
"""States that are stepped at once; of one number wherever it does not matter: one program."""

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
    after, used = jitted_observe(state, sample, jnp.asarray(gains), settings(**options))
    limit = {"gain_limit": 1.5} | options
    steps = [
        reference.filter_step(T[k], b[k], reference_sample(raw, k), gains[k], gamma=GAMMA, **limit)
        for k in range(count)
    ]
    # Relative to numbers up to 10 or so.
    np.testing.assert_allclose(matrices(after), [T for T, _ in steps], rtol=0, atol=1e-10)
    np.testing.assert_allclose(after.bias, [b for _, b in steps], rtol=0, atol=1e-10)
    if limit["gain_limit"] is None:
        np.testing.assert_allclose(used, gains, rtol=1e-15)
    else:
        assert (np.asarray(used) <= gains * (1 + 1e-15)).all()


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("law", "substeps", "gain_limit"),
    [  # each law with and without sub-steps, with and without the limit
        ("gradient", 1, 1.5),
        ("gradient", 3, None),
        ("printed", 1, None),
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
    [(0, 0), (0, 3), (1, 0), (3, 2)],
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
    for k in range(COUNT):
        Y = np.concatenate([raw.angular_velocity[k], raw.velocity[k]])
        moved = T[k] @ reference.se3_exp((Y - b[k]) * raw.time_step[k])
        np.testing.assert_allclose(matrices(after)[k], moved, atol=1e-13)
    np.testing.assert_array_equal(after.bias, b)
    np.testing.assert_array_equal(used, gain)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("substeps", [1, 2])
def test_the_gain_used_is_the_least_of_gain_and_limit_averaged_over_substeps(substeps) -> None:
    count, rng = COUNT, np.random.default_rng(0)
    raw = random_measurements(rng, count, 2, 1)
    T, b, state = random_estimates(rng, count)
    gains = 10 ** rng.uniform(-0.5, 2.5, count)
    sample = jitted_prepare(as_arrays(raw, float))
    _, used = jitted_observe(state, sample, jnp.asarray(gains), settings(substeps=substeps))
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
    rng = np.random.default_rng(4)
    raw = random_measurements(rng, 40, 2, 2, missing=0.4)
    m = as_arrays(raw, np.float64)
    chosen, K = settings(substeps=2), jnp.asarray(8.0)
    (T,), (b,), states = random_estimates(rng, 1)
    state = jax.tree.map(lambda a: a[0], states)
    signal = signal_settings(GainConfig(), np.float64)
    estimates = run_filter(ConstantGain(K), m, state, chosen, signal)
    online, by_reference = [], []
    for k in range(40):
        # Sample k is the estimate before its update, so that sample 0 is the initial one.
        online.append(state)
        by_reference.append((T, b))
        state = step(state, m.at(k), K, chosen)
        sample = reference_sample(raw, k)
        T, b = reference.filter_step(T, b, sample, 8.0, gamma=GAMMA, substeps=2, gain_limit=1.5)
    states = jax.tree.map(lambda *a: np.stack(a), *online)
    at_once = np.asarray(jitted_transform(estimates.rotation, estimates.position))
    np.testing.assert_allclose(at_once, matrices(states), atol=1e-12)
    np.testing.assert_allclose(estimates.bias, states.bias, atol=1e-12)
    # Rounding, amplified a little by steps on measurements that fit nothing.
    np.testing.assert_allclose(at_once, [T for T, _ in by_reference], atol=1e-10)
    np.testing.assert_allclose(estimates.bias, [b for _, b in by_reference], atol=1e-10)
    np.testing.assert_allclose(estimates.time, np.cumsum(raw.time_step) - raw.time_step)


# The state and the settings ----------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_the_state_gives_back_what_it_was_made_of(shape) -> None:
    rng = np.random.default_rng(0)
    T = random_poses(rng, int(np.prod(shape))).reshape(*shape, 4, 4)
    b = rng.normal(size=(*shape, 6))
    state = jitted_state(T[..., :3, :3], T[..., :3, 3], b)
    np.testing.assert_allclose(state.rotation, T[..., :3, :3], atol=1e-14)
    np.testing.assert_array_equal(state.position, T[..., :3, 3])
    np.testing.assert_array_equal(state.bias, b)
    assert {a.shape for a in jax.tree.leaves(state)} == {shape}


def test_the_bias_is_zero_unless_given() -> None:
    state = initial_state(np.eye(3, dtype=np.float32), np.ones(3, np.float32))
    assert state.bias.tolist() == [0] * 6
    assert state.bias.dtype == np.float32


def test_whole_numbers_make_a_state_of_floating_ones() -> None:
    with jax.numpy_dtype_promotion("standard"):  # as a user has it
        state = initial_state(np.eye(3, dtype=int), [4, -3, 5], [0] * 6)
        assert {a.dtype for a in jax.tree.leaves(state)} == {np.dtype(np.float32)}


@pytest.mark.parametrize("wide", [False, True], ids=["32 bits", "64 bits allowed"])
@pytest.mark.parametrize("gain", [5, 5.0, np.float32(5)], ids=["int", "float", "numpy"])
def test_step_takes_a_gain_of_any_kind_and_keeps_the_states_dtype(gain, wide) -> None:
    rng = np.random.default_rng(0)
    raw, (T, b, _) = random_measurements(rng, 1, 2, 1), random_estimates(rng, 1)
    chosen = settings(np.float32)
    with jax.enable_x64(wide):
        m, T, b = as_arrays((raw, T, b), np.float32)
        state = jitted_state(T[0, :3, :3], T[0, :3, 3], b[0])
        want, _ = jitted_observe(state, jitted_prepare(m.at(0)), jnp.float32(5), chosen)
        got = step(state, m.at(0), gain, chosen)
    assert {a.dtype for a in jax.tree.leaves(got)} == {np.dtype(np.float32)}
    leaves_close(got, want, atol=2e-6)


def test_step_compiles_once_for_all_numbers() -> None:
    rng = np.random.default_rng(0)
    m = as_arrays(random_measurements(rng, 3, 2, 1, missing=0.3), np.float32)
    state = as_arrays(jax.tree.map(lambda a: a[0], random_estimates(rng, 1)[2]), np.float32)
    _step.clear_cache()
    for k, (gamma, limit) in enumerate([((1.0, 2.0), 1.5), ((0.0, 0.0), 0.7), ((5.0, 5.0), 1.0)]):
        chosen = settings(np.float32, gamma=gamma, gain_limit=limit)
        state = step(state, m.at(k), jnp.float32(k), chosen)
    assert _step._cache_size() == 1


def configured(dtype: Any, **section: Any) -> FilterSettings:
    """The filter settings of a [filter] section, with the paper's scenario."""
    run = RunConfig(dtype=np.dtype(dtype).name)
    parameters = ParametersConfig(also=())  # what may be tuned too depends on the section
    return filter_settings(
        Experiment(run=run, filter=FilterConfig(**section), parameters=parameters)
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


# What is learnt of the vectors --------------------------------------------------------------------


@pytest.mark.usefixtures("x64")
def test_an_estimated_bias_is_never_longer_than_its_bound() -> None:
    m, _, state = random_samples(200)
    state = with_vector_biases(state, 3, length=2.0)  # some of them beyond it already
    chosen = learning(gain=60.0, bound=0.4, excitation=1e-3)
    sample = prepared_for(m, chosen)
    for _ in range(2):
        state, _ = jitted_observe(state, sample, jnp.full(200, 20.0), chosen)
        length = np.linalg.norm(state.vector_bias, axis=-1)
        assert length.max() <= 0.4 * (1 + 1e-12)
    assert length.max() > 0.3
    assert (length == 0).any()  # a step far beyond it begins anew


@pytest.mark.usefixtures("x64")
def test_the_estimated_bias_of_a_missing_vector_stays() -> None:
    rng = np.random.default_rng(0)
    m = as_arrays(random_measurements(rng, COUNT, 3, 2, missing=0.5), np.float64)
    state = with_vector_biases(random_estimates(rng, COUNT)[2], 3, length=0.1)
    chosen = learning(leak=0.2, excitation=1e-3)
    after, _ = jitted_observe(state, prepared_for(m, chosen), np.full(COUNT, 5.0), chosen)
    missing = np.asarray(m.vector_weights) == 0
    before, now = np.asarray(state.vector_bias), np.asarray(after.vector_bias)
    np.testing.assert_array_equal(now[missing], before[missing])
    assert (now[~missing] != before[~missing]).all()


@pytest.mark.usefixtures("x64")
def test_at_rest_a_bias_can_not_be_told_and_nothing_is_learnt_of_it() -> None:
    m, _, state = random_samples(COUNT)
    state = with_vector_biases(state, 3, length=0.1)
    # The measured angular velocity is its bias, and always was.
    omega = np.array(state.bias)[:, :3]
    m = m._replace(angular_velocity=jnp.asarray(omega))
    x, y, z = jnp.asarray(omega.T)
    state = state._replace(turning=(x, y, z))
    chosen = learning()
    still, _ = jitted_observe(state, prepared_for(m, chosen), np.full(COUNT, 5.0), chosen)
    np.testing.assert_allclose(still.vector_bias, state.vector_bias, rtol=0, atol=1e-15)
    # With a leak it is forgotten.
    forgets = learning(leak=0.5)
    leaked, _ = jitted_observe(state, prepared_for(m, forgets), np.full(COUNT, 5.0), forgets)
    kept = (1 - 0.5 * np.asarray(m.time_step))[:, None, None]
    np.testing.assert_allclose(leaked.vector_bias, kept * state.vector_bias, rtol=1e-12)


@pytest.mark.usefixtures("x64")
def test_a_unit_of_length_is_the_same_observer_run_in_that_unit() -> None:
    metres, (m, _, state) = 3.7, random_samples(COUNT)
    K = np.geomspace(0.5, 200.0, COUNT)
    in_metres = settings(gamma_law="quadratic", substeps=2)
    in_metres = replace(in_metres, length=jnp.asarray(metres))
    found, used = jitted_observe(state, jitted_prepare(m), K, in_metres)
    scaled = m._replace(
        velocity=m.velocity / metres,
        landmarks=m.landmarks / metres,
        landmark_references=m.landmark_references / metres,
        landmark_weights=m.landmark_weights * metres**2,
    )
    start = state._replace(
        place=se3.scale(1 / metres, state.place),
        bias_linear=se3.scale(1 / metres, state.bias_linear),
    )
    want, wanted_gain = jitted_observe(
        start, jitted_prepare(scaled), K, settings(gamma_law="quadratic", substeps=2)
    )
    np.testing.assert_allclose(used, wanted_gain, rtol=1e-12)
    leaves_close(found.attitude, want.attitude, atol=1e-12)
    leaves_close(found.bias_angular, want.bias_angular, atol=1e-12)
    leaves_close(found.place, se3.scale(metres, want.place), atol=1e-11)
    leaves_close(found.bias_linear, se3.scale(metres, want.bias_linear), atol=1e-11)
    in_one = replace(in_metres, length=jnp.asarray(1.0))
    one, _ = jitted_observe(state, jitted_prepare(m), K, in_one)
    none, _ = jitted_observe(state, jitted_prepare(m), K, replace(in_metres, length=None))
    leaves_close(one, none, atol=1e-14)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("law", "power"), [("linear", 1), ("quadratic", 2)])
def test_gamma_follows_the_gain_used_as_far_as_a_step_is_stable(law, power) -> None:
    K, dt, reach = np.meshgrid(
        np.geomspace(0.01, 1000, 21), np.geomspace(1e-3, 0.5, 11), [0.0, 3.0, 900.0]
    )
    chosen = settings(gamma_law=law, gamma=(40.0, 700.0))
    m = as_arrays(random_measurements(np.random.default_rng(0), 1, 2, 1), np.float64)
    sample = prepare(m, chosen.vectors)
    sample = sample._replace(time_step=jnp.asarray(dt), reach=jnp.asarray(reach))
    found = bias_gains(jnp.asarray(K), sample, chosen)
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
def test_biases_are_learnt_from_a_state_that_has_none_yet() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 20, 2, 1), np.float64)
    plain = initial_state(np.eye(3), np.zeros(3))
    made = initial_state(np.eye(3), np.zeros(3), learnt_vectors=2)
    chosen, signal = learning(excitation=1e-3), signal_settings(GainConfig(), np.float64)
    schedule = ConstantGain(jnp.asarray(5.0))
    both = [run_filter(schedule, m, start, chosen, signal) for start in (plain, made)]
    assert np.abs(both[0].vector_bias[-1]).max() > 0
    np.testing.assert_array_equal(both[0].vector_bias, both[1].vector_bias)
    after = [step(start, m.at(0), 5.0, chosen) for start in (plain, made)]
    np.testing.assert_array_equal(after[0].vector_bias, after[1].vector_bias)
    loop, _ = scheduled_step(begin(schedule, plain), m.at(0), schedule, chosen, signal)
    np.testing.assert_allclose(loop.state.vector_bias, after[0].vector_bias, rtol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("vectors", [0, 1])
@pytest.mark.parametrize("learns", [False, True])
def test_with_fewer_than_two_vectors_there_is_no_cross_product(learns, vectors) -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 20, vectors, 3), np.float64)
    start = initial_state(np.eye(3), np.zeros(3))
    chosen = (
        learning(excitation=1e-3) if learns else settings(vectors=vector_settings(cross_weight=0.5))
    )
    without = replace(chosen, vectors=replace(chosen.vectors, cross=False))
    signal = signal_settings(GainConfig(), np.float64)
    crossed, plain = (
        run_filter(ConstantGain(jnp.asarray(5.0)), m, start, one, signal)
        for one in (chosen, without)
    )
    assert np.isfinite(crossed.position).all()
    for ours, theirs in zip(crossed, plain, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.usefixtures("x64")
def test_settings_of_another_number_of_sensors_are_refused() -> None:
    m = as_arrays(random_measurements(np.random.default_rng(0), 5, 3, 1), np.float64)
    chosen = filter_settings(override(Experiment(), ["run.dtype=float64"]))
    start = initial_state(np.eye(3), np.zeros(3))
    with pytest.raises(ArgumentError, match=r"vectors.weights: 2 of them; allowed: 3"):
        step(start, m.at(0), 5.0, chosen)
    two = initial_state(np.eye(3), np.zeros(3), learnt_vectors=2)
    with pytest.raises(ArgumentError, match=r"vector_biases: of 2 vectors; allowed: 3"):
        step(two, m.at(0), 5.0, learning())


# Transformations ---------------------------------------------------------------------------------


def learning(dtype: Any = np.float64, **law: float) -> FilterSettings:
    """Settings of a filter that learns the vectors' biases, with all that it can make of them."""
    return settings(
        dtype,
        gamma_law="linear",
        substeps=2,
        vectors=vector_settings(dtype, normalise=True, cross_weight=0.5, each_agent=True),
        learnt=vector_bias(dtype, **law),
    )


@jax.jit
def prepared_for(m: Measurements, chosen: FilterSettings) -> Sample:
    return prepare(m, chosen.vectors)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("learns", [False, True])
def test_jit_equals_eager(learns) -> None:
    m, _, state = random_samples(COUNT)
    chosen = settings()
    if learns:
        state, chosen = with_vector_biases(state, 3), learning(leak=0.1)
    inputs = (state, prepared_for(m, chosen), np.linspace(1.0, 40.0, COUNT), chosen)
    leaves_close(jitted_observe(*inputs), observed(*inputs), atol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("learns", [False, True])
def test_vmap_over_agents_equals_a_loop(learns) -> None:
    m, _, states = random_samples(1)
    chosen = settings()
    if learns:
        states, chosen = with_vector_biases(states, 3), learning(leak=0.1)
    sample, state = jax.tree.map(lambda a: a[0], (prepared_for(m, chosen), states))
    gains = np.linspace(1.0, 60.0, 7)
    together = jax.jit(jax.vmap(observed, in_axes=(None, None, 0, None)))
    got = together(state, sample, gains, chosen)
    for i, gain in enumerate(gains):
        one = jitted_observe(state, sample, gain, chosen)
        leaves_close(jax.tree.map(lambda a, i=i: a[i], got), one, atol=1e-12)


@pytest.mark.parametrize("wide", [False, True], ids=["32 bits", "64 bits allowed"])
@pytest.mark.parametrize("gain_limit", [None, 1.5])
def test_float32_stays_float32(wide, gain_limit) -> None:
    rng = np.random.default_rng(0)
    raw, (T, b, _) = random_measurements(rng, 4, 2, 1), random_estimates(rng, 4)

    def result(raw: Measurements, T: Array, b: Array, gain: Array) -> Any:
        state = initial_state(T[:, :3, :3], T[:, :3, 3], b)
        chosen = settings(np.float32, gain_limit=gain_limit, substeps=2)
        return observed(state, prepared(raw), gain, chosen)

    with jax.enable_x64(wide):
        shapes = jax.eval_shape(result, *as_arrays((raw, T, b, np.ones(4)), np.float32))
    assert {a.dtype for a in jax.tree.leaves(shapes)} == {np.dtype(np.float32)}


def test_float32_agrees_with_float64_to_rounding() -> None:
    rng = np.random.default_rng(0)
    raw, (T, b, _) = random_measurements(rng, COUNT, 2, 1), random_estimates(rng, COUNT)
    inputs = (raw, T[:, :3, :3], T[:, :3, 3], b, np.linspace(1, 40, COUNT))

    def result(dtype: type[np.floating]) -> Any:
        m, R, P, b, gain = as_arrays(inputs, dtype)
        return jitted_observe(jitted_state(R, P, b), jitted_prepare(m), gain, settings(dtype))

    single = result(np.float32)
    with jax.enable_x64(True):
        double = result(np.float64)
    # Numbers up to 40 (gains), with some tens of operations on them.
    leaves_close(single, double, rtol=1e-5, atol=1e-5)


@jax.jit
def forward_and_reverse(chosen: FilterSettings, *inputs: Any) -> tuple[Any, Any]:
    """Derivatives of the sum of all that a step returns, by state, gain and measurements."""

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
    # Everything that has a square root or a division is at its zero here.
    m = fitting(np.eye(4), np.array([[0.0, 0.0, 1.0]] * 2), np.zeros((1, 3)))
    m = m._replace(vector_weights=np.full(2, seen), landmark_weights=np.full(1, seen))
    state = initial_state(
        np.eye(3, dtype=np.float32), np.zeros(3, np.float32), learnt_vectors=2 * learns
    )
    chosen = learning(np.float32) if learns else settings(np.float32)
    limit = np.float32(np.inf if gain_limit is None else gain_limit)
    chosen = replace(chosen, gain_limit=jnp.asarray(limit))
    forward, reverse = forward_and_reverse(chosen, state, jnp.float32(3), as_arrays(m, np.float32))
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
