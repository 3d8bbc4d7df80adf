"""The events of a scenario, compared with its measurements and its true motion."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import reference

from posegsa import config
from posegsa.config.shipped import find
from posegsa.model.events import events_of
from posegsa.model.family import draw_scenario
from posegsa.model.scenario import integrate, measure
from posegsa.search.drawn_scenarios import family, scenario

pytestmark = pytest.mark.usefixtures("x64")

EVERYTHING = (
    "run.dtype=float64",
    "scenario.duration=20.0",
    "cost.steady_window=[400, 1900]",
    "scenario.landmark_period=1",
    "family.bursts={rate=0.3, duration=[0.5, 2], size=[0.3, 1.5], each=true}",
    "family.landmark_bursts={rate=0.3, duration=[0.5, 2], size=[0.5, 3.0]}",
    "family.noise_jumps={rate=0.5}",
    "family.jumps={rate=0.3, angle=[5, 90], distance=[0.1, 3]}",
)
"""Many events of all kinds."""


@pytest.fixture(scope="module")
def drawn():
    """A scenario of disturbed sensors with many events, and the list of events."""
    with jax.enable_x64(True):
        experiment = config.override(config.load(find("disturbed")), EVERYTHING)
        one = jax.jit(draw_scenario)(
            scenario(experiment), family(experiment, "float64"), jax.random.key(3)
        )
        return one, jax.tree.map(np.asarray, jax.jit(events_of)(one))


def test_bursts_are_where_the_measurements_are_disturbed(drawn) -> None:
    one, events = drawn
    key = jax.random.key(0)
    calm = replace(
        one,
        bursts=one.bursts._replace(offset=jnp.zeros_like(one.bursts.offset)),
        landmark_bursts=one.landmark_bursts._replace(
            offset=jnp.zeros_like(one.landmark_bursts.offset)
        ),
    )
    truth = jax.jit(integrate)(one)
    disturbed, quiet = (jax.jit(measure)(s, truth, key).measurements for s in (one, calm))
    for name in ("vector", "landmark"):
        off = np.asarray(getattr(disturbed, f"{name}s")) - np.asarray(getattr(quiet, f"{name}s"))
        bursts = getattr(events, f"{name}_bursts")
        np.testing.assert_array_equal(np.abs(off).max(axis=-1) > 1e-9, bursts)
        assert 0.05 < bursts.mean() < 0.6
    weighted = jax.tree.map(np.asarray, events.weighted(disturbed))
    for name in ("vector", "landmark"):
        weights, noise = getattr(weighted, f"{name}_weights"), getattr(events, f"{name}_noise")
        seen = np.asarray(getattr(disturbed, f"{name}_weights")) > 0
        used = seen & ~getattr(events, f"{name}_bursts")
        np.testing.assert_allclose(weights, np.where(used, noise**-2, 0), rtol=1e-12)
        assert not seen.all()


def test_noise_has_the_deviation_that_events_state(drawn) -> None:
    one, events = drawn
    silent = replace(
        one,
        noise_jumps=one.noise_jumps._replace(factor=jnp.zeros_like(one.noise_jumps.factor)),
        angular_noise=jnp.zeros(()),
        linear_noise=jnp.zeros(()),
        vector_noise=jnp.zeros(2),
        landmark_noise=jnp.zeros(3),
    )
    truth = jax.jit(integrate)(one)
    noisy, quiet = (
        jax.jit(measure)(s, truth, jax.random.key(0)).measurements for s in (one, silent)
    )
    for sensor, stated in {
        "angular_velocity": events.angular_noise[:, None],
        "velocity": events.linear_noise[:, None],
        "vectors": events.vector_noise[:, :, None],
        "landmarks": events.landmark_noise[:, :, None],
    }.items():
        z = (np.asarray(getattr(noisy, sensor)) - np.asarray(getattr(quiet, sensor))) / stated
        # Of unit variance at each level of the noise.
        for level in np.unique(stated):
            some = z[np.broadcast_to(stated == level, z.shape)]
            assert np.mean(some**2) == pytest.approx(1, abs=6 * np.sqrt(2 / some.size)), sensor
        assert len(np.unique(stated)) > 2


def test_jumps_are_what_the_velocities_do_not_explain(drawn) -> None:
    one, events = drawn
    truth = jax.tree.map(np.asarray, jax.jit(integrate)(one))
    poses = np.tile(np.eye(4), (len(truth.time), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = truth.rotation, truth.position
    happened = np.flatnonzero(np.abs(events.jumps).max(axis=1) > 0)
    assert 2 <= len(happened) <= 20
    for k in range(len(poses) - 1):
        step = np.concatenate([truth.angular_velocity[k], truth.velocity[k]]) * 0.01
        wanted = poses[k] @ reference.se3_exp(step) @ reference.se3_exp(events.jumps[k])
        np.testing.assert_allclose(poses[k + 1], wanted, atol=1e-12)
