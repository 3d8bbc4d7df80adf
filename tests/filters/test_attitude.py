"""The attitude filter for inertial sensors, against a reference in NumPy and by what it must do."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.reference_attitude import attitudes
from scipy.spatial.transform import Rotation

from posegsa import config
from posegsa.errors import ArgumentError
from posegsa.filters.attitude import AttitudeFilter, AttitudeNumbers, AttitudeState, Interval
from posegsa.filters.base import Sensors, samples_of
from posegsa.filters.rollout import run
from posegsa.model.estimate import initial_state
from posegsa.model.measurements import Measurements

STEP = 0.01
NUMBERS = {name: getattr(config.AttitudeConfig(), name) for name in AttitudeNumbers._fields}
GRAVITY, FIELD = np.array([0.0, 0.0, 9.81]), np.array([0.0, 0.4, -0.6])


@pytest.fixture(autouse=True)
def double() -> Any:
    with jax.enable_x64(True):
        yield


def made(interval: Interval = "before", **changes: float) -> AttitudeFilter:
    numbers = {name: jnp.asarray(value) for name, value in (NUMBERS | changes).items()}
    return AttitudeFilter(AttitudeNumbers(**numbers), interval)


def sensed(
    seconds: float = 20.0,
    *,
    rest: float = 0.0,
    seed: int = 0,
    bias: tuple[float, float, float] = (0.01, -0.02, 0.005),
    steps: np.ndarray | None = None,
    speed: float = 1.0,
) -> dict[str, np.ndarray]:
    """True attitudes (K + 1, 3, 3), and what ideal sensors measure of a tumbling, shaken body."""
    steps = np.full(round(seconds / STEP), STEP) if steps is None else steps
    time = np.cumsum(steps) - steps
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (2, 3))
    moving = (time >= rest)[:, None]
    omega = moving * speed * np.sin(time[:, None] * [0.9, 1.3, 0.7] + phases[0])
    R = [Rotation.from_rotvec(rng.normal(size=3)).as_matrix()]
    for w, dt in zip(omega, steps, strict=True):
        R.append(R[-1] @ Rotation.from_rotvec(dt * w).as_matrix())
    R = np.array(R)
    shake = moving * np.sin(time[:, None] * [7.0, 5.0, 6.0] + phases[1]) * [2.0, 1.0, 1.5]
    return {
        "R": R,
        "gyr": omega + np.array(bias),
        "acc": np.einsum("kji,kj->ki", R[:-1], shake + GRAVITY),
        "mag": np.einsum("kji,j->ki", R[:-1], FIELD),
        "steps": steps,
    }


AT_ONCE = 100
"""Samples that a compiled program takes: the same one for recordings of any length."""


@jax.jit
def some(filter: AttitudeFilter, m: Measurements, state: AttitudeState, count: int) -> Any:
    """The state after the first `count` samples; attitude and bias before each."""

    def look(total: Any, view: Any, entry: Any) -> Any:
        return total, (view.estimate.attitude, view.estimate.bias_angular)

    last, _, stored = run(look, filter, samples_of(filter, m), state, count=count)
    return last, stored


def ran(
    filter: AttitudeFilter,
    seen: dict[str, np.ndarray],
    references: Any = (GRAVITY, [0.0, 1.0, 0.0]),
    start: Any = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
) -> tuple[AttitudeState, dict[str, np.ndarray]]:
    """The last state, and attitudes and biases before each sample."""
    K = len(seen["gyr"])
    padded = {
        name: np.concatenate([seen[name][:K], seen[name][:1].repeat(-K % AT_ONCE, axis=0)])
        for name in ("gyr", "acc", "mag", "steps")
    }
    measurements = Measurements.from_arrays(
        time_step=padded["steps"],
        angular_velocity=padded["gyr"],
        velocity=np.zeros_like(padded["gyr"]),
        vectors=np.stack([padded["acc"], padded["mag"]], axis=1),
        vector_references=references,
        dtype=np.float64,
    )
    measurements = jax.tree.map(np.asarray, measurements)
    state = filter.start(initial_state(np.array(start), np.zeros(3)), Sensors(2, 0))
    assert jax.tree.leaves(state)[0].dtype == np.float64
    parts = []
    for k in range(0, K, AT_ONCE):
        rows = jax.tree.map(lambda a, k=k: a[k : k + AT_ONCE], measurements)
        state, stored = some(filter, rows, state, min(AT_ONCE, K - k))
        parts.append(jax.tree.map(np.asarray, stored))
    (w, x, y, z), b = jax.tree.map(lambda *a: np.concatenate(a)[:K], *parts)
    return state, {
        "R": Rotation.from_quat(np.stack([x, y, z, w], 1)).as_matrix(),
        "b": np.stack(b, 1),
    }


def degrees(R: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Angles (K,) between rotations [deg]."""
    return np.degrees(Rotation.from_matrix(R @ np.swapaxes(true, -1, -2)).magnitude())


@pytest.mark.parametrize("interval", ["before", "after"])
@pytest.mark.parametrize("rest", [0.0, 4.0])
def test_it_computes_what_the_reference_in_numpy_computes(interval: Interval, rest: float) -> None:
    seen = sensed(12.0, rest=rest, seed=3, steps=np.random.default_rng(0).uniform(0.004, 0.02, 900))
    rng = np.random.default_rng(1)
    for name, noise in (("gyr", 0.01), ("acc", 0.1), ("mag", 0.01)):
        seen[name] = seen[name] + noise * rng.normal(size=seen[name].shape)
    seen["acc"][5:9] = np.nan
    seen["acc"][300] = 400.0
    seen["mag"][:20] = np.nan
    seen["mag"][400:430] = np.nan
    seen["mag"][500:600] += [0.3, 0.0, 0.1]
    seen["mag"][700] = 30.0
    compare(interval, seen)


@pytest.mark.parametrize("interval", ["before", "after"])
def test_it_computes_what_the_reference_computes_through_what_is_rare(interval: Interval) -> None:
    """A first field that is far too short, a pause, and a magnetometer that is slow."""
    steps = np.full(900, 0.01)
    steps[450], steps[600] = 0.6, 0.2
    seen = sensed(12.0, rest=1.0, seed=3, steps=steps)
    seen["mag"][:5] *= 0.02
    seen["mag"][np.arange(900) % 4 != 0] = np.nan
    compare(interval, seen)


@pytest.mark.parametrize("interval", ["before", "after"])
@pytest.mark.parametrize("name", ["acc", "mag"])
def test_it_computes_what_the_reference_computes_from_a_wrong_start(
    interval: Interval, name: str
) -> None:
    seen = sensed(12.0, seed=5)
    seen[name][:80] *= -1
    seen["gyr"][600] = 900.0
    compare(interval, seen)


def compare(interval: Interval, seen: dict[str, np.ndarray]) -> None:
    """The filter and the reference in NumPy, on one sensor's samples."""
    last, found = ran(made(interval), seen)
    expected = attitudes(
        NUMBERS,
        *(seen[name] for name in ("gyr", "acc", "mag", "steps")),
        before=interval == "before",
    )
    np.testing.assert_allclose(found["R"], expected["R"][:-1], atol=1e-9)
    np.testing.assert_allclose(found["b"], expected["b"][:-1], atol=1e-10)
    np.testing.assert_allclose(last.field_belief, expected["belief"][-1], rtol=1e-8)
    assert bool(last.at_rest) == expected["rest"][-1]
    P = np.zeros((8, 8))
    for i, row in enumerate(last.covariance):
        P[i, i:] = P[i:, i] = row
    np.testing.assert_allclose(P, expected["P"], atol=1e-9)


def test_from_a_start_in_motion_it_finds_attitude_and_bias() -> None:
    seen = sensed(60.0)
    last, found = ran(made("after", magnetometer_delay=0.0), seen)
    off = degrees(found["R"], seen["R"][:-1])
    assert off[-1000:].max() < 1.0
    np.testing.assert_allclose(last.estimate.bias, [0.01, -0.02, 0.005, 0, 0, 0], atol=4e-3)
    assert last.heading_deviation < np.deg2rad(5)
    assert last.inclination_deviation < np.deg2rad(3)


def test_at_rest_it_learns_the_bias_and_says_so() -> None:
    seen = sensed(8.0, rest=8.0)
    last, _ = ran(made("after"), seen)
    assert bool(last.at_rest)
    np.testing.assert_allclose(last.estimate.bias[:3], [0.01, -0.02, 0.005], atol=5e-4)
    moving, _ = ran(made("after"), sensed(9.0, rest=8.0))
    assert not bool(moving.at_rest)


def test_without_a_magnetometer_it_keeps_the_inclination_and_the_given_heading() -> None:
    seen = sensed(30.0, bias=(0.0, 0.0, 0.0))
    seen["mag"][:] = np.nan
    last, found = ran(made("after"), seen)
    tilt = found["R"][:, 2] - seen["R"][:-1, 2]  # R^T up
    assert np.degrees(np.linalg.norm(tilt[-1000:], axis=1)).max() < 1.0
    error = found["R"] @ np.swapaxes(seen["R"][:-1], 1, 2)
    heading = np.unwrap(np.arctan2(error[:, 1, 0], error[:, 0, 0]))[500:]
    assert np.degrees(np.ptp(heading)) < 1.0  # any heading, that stays
    assert last.heading_deviation > 1.0


def test_a_field_that_is_disturbed_is_not_believed() -> None:
    seen = sensed(40.0)
    seen["mag"][3000:3300] += [0.2, 0.1, -0.2]
    last, found = ran(made("after", magnetometer_delay=0.0), seen)
    before, _ = ran(made("after", magnetometer_delay=0.0), {k: v[:3290] for k, v in seen.items()})
    assert before.field_belief < 0.3
    assert last.field_belief > 0.8
    off = degrees(found["R"], seen["R"][:-1])
    assert off[3000:3400].max() < off[2500:3000].max() + 2.0


def test_a_magnet_that_turns_with_the_body_is_learnt() -> None:
    seen = sensed(90.0, speed=4.0)
    seen["mag"] = seen["mag"] + [0.06, -0.03, 0.04]
    last, found = ran(made("after", magnetometer_delay=0.0), seen)
    np.testing.assert_allclose(last.iron, [0.06, -0.03, 0.04], atol=0.015)
    assert degrees(found["R"], seen["R"][:-1])[-1000:].max() < 1.5


def test_a_late_magnetometer_is_corrected() -> None:
    seen = sensed(60.0, speed=4.0)
    seen["mag"] = np.concatenate([seen["mag"][:1], seen["mag"][:1], seen["mag"][:-2]])
    late, corrected = (
        degrees(ran(made("after", magnetometer_delay=delay), seen)[1]["R"], seen["R"][:-1])
        for delay in (0.0, 0.02)
    )
    assert np.sqrt(np.mean(corrected[2000:] ** 2)) < 0.5 * np.sqrt(np.mean(late[2000:] ** 2))


@pytest.mark.parametrize(
    ("up", "north"),
    [
        ((0, 0, 1), (0, 1, 0)),
        ((0, 0, -1), (1, 0, 0)),
        ((0, 0, 1), (1, 0, 0)),
        ((0, 1, 0), (0, 0, 1)),
    ],
)
def test_the_references_say_what_the_inertial_frame_is(up: Any, north: Any) -> None:
    """The references of NED, NWU and any other frame only turn the estimates."""
    seen = sensed(5.0, rest=2.0)
    up, north = np.array(up, float), np.array(north, float)
    frame = np.stack([np.cross(north, up), north, up])  # to east, north, up
    _, expected = ran(made(), seen)
    _, found = ran(made(), seen, (9.81 * up, north - 3 * up))
    np.testing.assert_allclose(frame @ found["R"][1:], expected["R"][1:], atol=1e-9)


def test_one_direction_or_an_unknown_number_is_refused() -> None:
    filter = made()
    with pytest.raises(ArgumentError, match="vectors: 1 of them; allowed: two"):
        filter.start(initial_state(np.eye(3), np.zeros(3)), Sensors(1, 0))
    with pytest.raises(ArgumentError, match="gamma: not a number of this filter"):
        filter.with_values({"gamma": jnp.zeros(())})
    changed = filter.with_values({"heading": jnp.asarray(3.0)})
    assert changed == replace(filter, numbers=filter.numbers._replace(heading=jnp.asarray(3.0)))


def test_upside_down_is_a_start_like_any_other() -> None:
    seen = sensed(6.0, rest=6.0, bias=(0.0, 0.0, 0.0))
    flipped = {name: value.copy() for name, value in seen.items()}
    flipped["acc"][:] = -GRAVITY
    flipped["mag"][:] = [0.0, -0.4, 0.6]
    _, found = ran(made(), flipped)
    np.testing.assert_allclose(found["R"][-1], np.diag([1.0, -1.0, -1.0]), atol=0.02)


def test_a_first_field_that_is_too_short_is_replaced_after_a_second() -> None:
    seen = sensed(20.0)
    seen["mag"][0] = 0.01 * seen["mag"][0, ::-1]
    _, found = ran(made(), seen)
    assert degrees(found["R"], seen["R"][: len(found["R"])])[-500:].max() < 1.5


def test_after_a_pause_the_attitude_is_found_anew_and_said_to_be_uncertain() -> None:
    steps = np.full(3000, 0.01)
    steps[1500] = 3.0
    seen = sensed(33.0, steps=steps)
    state, _ = ran(made(), {name: a[:1501] for name, a in seen.items()})
    assert np.degrees(state.heading_deviation) > 45
    _, found = ran(made(), seen)
    error = degrees(found["R"], seen["R"][: len(found["R"])])
    assert error[1490:1500].max() < 1.0
    assert error[-300:].max() < 2.0


def test_a_strong_magnet_for_seconds_does_not_take_the_place_of_a_known_field() -> None:
    seen = sensed(40.0)
    seen["mag"][2000:2300] = 12.0 * seen["mag"][2000:2300, ::-1]
    seen["mag"][2600:2720] = np.nan
    seen["mag"][2720] *= 15.0
    _, found = ran(made(), seen)
    assert degrees(found["R"], seen["R"][: len(found["R"])])[2000:].max() < 2.0


def reversed_at_first(name: str, samples: int, factor: float = -1.0) -> dict[str, np.ndarray]:
    """Half a minute of motion, one of its sensors wrong at first."""
    seen = sensed(30.0)
    seen[name][:samples] *= factor
    return seen


@pytest.mark.parametrize(
    "seen",
    [
        reversed_at_first("acc", 1),
        reversed_at_first("acc", 60),
        reversed_at_first("acc", 100, 0.01),
        reversed_at_first("mag", 100),
        reversed_at_first("mag", 1, 1e4),
        reversed_at_first("mag", 200, 9.0),
    ],
)
def test_a_start_with_a_sensor_that_is_wrong_at_first_is_mended(seen: dict[str, Any]) -> None:
    _, found = ran(made(), seen)
    assert degrees(found["R"], seen["R"][: len(found["R"])])[-500:].max() < 2.5


def test_the_first_field_may_come_late_whatever_the_heading_until_then() -> None:
    """Velocity and covariance turn with the heading."""
    seen = sensed(12.0)
    seen["mag"][:500] = np.nan
    _, found = ran(made("after"), seen)
    _, turned = ran(made("after"), seen, start=Rotation.from_rotvec([0, 0, 2.5]).as_matrix())
    assert degrees(found["R"], turned["R"])[490] > 90
    np.testing.assert_allclose(turned["R"][501:], found["R"][501:], atol=1e-9)


def test_a_faulty_gyroscope_leaves_no_lasting_damage() -> None:
    seen = sensed(60.0)
    seen["gyr"][1000:2000] = [577.0, -577.0, 577.0]
    seen["mag"][np.arange(len(seen["mag"])) % 10 != 0] = np.nan
    last, found = ran(made(), seen)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(last))
    assert degrees(found["R"], seen["R"][: len(found["R"])])[-500:].max() < 3.0


def test_a_heading_that_is_lost_for_seconds_is_found_anew() -> None:
    """The gyroscope misses a turn; the covariance knows nothing of that."""
    seen = sensed(40.0)
    seen["gyr"][1500:1600] -= 1.5 * seen["R"][1500:1600, 2]  # about up
    _, found = ran(made(), seen)
    error = degrees(found["R"], seen["R"][: len(found["R"])])
    assert error[1600:1610].min() > 45
    assert error[-1000:].max() < 2.5


def test_the_bias_stays_within_what_gyroscopes_have() -> None:
    seen = sensed(20.0)
    seen["acc"][500:900] = [60.0, -50.0, 40.0]
    _, found = ran(made(), seen)
    assert np.abs(found["b"]).max() <= np.deg2rad(6) + 1e-12


def test_a_large_weight_of_a_field_does_not_overshoot() -> None:
    seen = sensed(20.0, bias=(0.0, 0.0, 0.0))
    vectors = np.stack([seen["acc"], seen["mag"]], axis=1)
    measurements = Measurements.from_arrays(
        time_step=seen["steps"],
        angular_velocity=seen["gyr"],
        velocity=np.zeros_like(seen["gyr"]),
        vectors=vectors,
        vector_references=(GRAVITY, [0.0, 1.0, 0.0]),
        vector_weights=[1.0, 1e6],
        dtype=np.float64,
    )
    filter = made()
    state = filter.start(initial_state(np.eye(3), np.zeros(3)), Sensors(2, 0))
    last, _, _ = run(lambda *_: ((), ()), filter, samples_of(filter, measurements), state)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(last))
    np.testing.assert_allclose(np.hypot(*last.parts), np.linalg.norm(FIELD), rtol=0.2)
