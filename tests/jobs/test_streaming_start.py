"""A stream without a pose: it starts at the first sample that shows one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.streams import START, N, at_once, fed, learning_filter, stream

import posegsa
from posegsa.errors import ArgumentError
from posegsa.model.first_pose import first_pose

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def result() -> posegsa.Result:
    return learning_filter()


def unseen_before(samples: dict, sample: int) -> dict:
    """The same samples, but for the landmarks before one and an exact pose at it."""
    landmarks = np.where(np.arange(N)[:, None, None] < sample, np.nan, samples["landmarks"])
    return samples | {"landmarks": landmarks}


def test_without_a_pose_it_starts_at_the_first_sample_that_shows_one(result):
    """As `first_pose` finds it, and from there on as a filter that is given this pose."""
    steps, samples, references = stream(result)
    samples = unseen_before(samples, 4)
    with jax.enable_x64(True):
        found = first_pose(at_once(steps, samples, references, "float64"))
    begin = int(found.sample)
    assert begin >= 4
    one = posegsa.PoseFilter(result)
    for pose in fed(one, steps, samples, slice(begin)):
        assert np.isnan(pose.rotation).all()
        assert np.isnan(pose.position).all()
    assert one.waiting
    assert one.time == pytest.approx(steps[:begin].sum())
    other = posegsa.PoseFilter(result, rotation=found.rotation, position=found.position)
    rest = slice(begin, N)
    expected = fed(other, steps, samples, rest)
    for got, want in zip(fed(one, steps, samples, rest), expected, strict=True):
        np.testing.assert_allclose(got.rotation, want.rotation, atol=1e-12)
        np.testing.assert_allclose(got.position, want.position, atol=1e-12)
    assert not one.waiting
    one.reset()
    assert one.waiting


def test_a_waiting_filter_is_kept_and_resumed(result):
    steps, samples, _ = stream(result)
    samples = unseen_before(samples, 12)
    one, other = posegsa.PoseFilter(result), posegsa.PoseFilter(result)
    fed(one, steps, samples, slice(6))
    assert one.waiting
    other.restore(one.checkpoint())
    assert other.waiting
    for each in (one, other):
        fed(each, steps, samples, slice(6, N))
        assert not each.waiting
    np.testing.assert_array_equal(one.pose.position, other.pose.position)
    one.reset()
    fed(one, steps, samples, slice(6))
    with pytest.raises(ArgumentError, match="record holds NaN"):  # it does not wait
        posegsa.PoseFilter(result, **START).restore(one.checkpoint())


def test_while_it_waits_it_says_so(result):
    one = posegsa.PoseFilter(result)
    assert "waiting" in repr(one)
    assert not one.observable
    assert one.why_unobservable.startswith("waiting: no sample has shown a pose")
    assert "waiting" not in repr(posegsa.PoseFilter(result, **START))


def test_the_bias_of_the_start_is_kept(result):
    """Neither a change of the caller's array nor another filter's bias gets in."""
    steps, samples, _ = stream(result)
    bias = np.full(6, 0.5)
    one, other = posegsa.PoseFilter(result, bias=bias), posegsa.PoseFilter(result)
    bias[:] = 9.0
    other.restore(one.checkpoint())
    for each in (one, other):
        fed(each, steps, samples)
    np.testing.assert_array_equal(one.bias, other.bias)
    plain = posegsa.PoseFilter(result)
    fed(plain, steps, samples)
    assert np.abs(one.bias - plain.bias).max() > 0.1


def test_a_sensor_without_weight_does_not_decide_the_start(result, x64):
    """In the observer's settings, or as a factor."""
    filter = result.filter_for(2, 1)
    none = tuple(jnp.asarray(weight) for weight in (1.0, 0.0))
    vectors = dataclasses.replace(filter.settings.vectors, weights=none)
    settings = dataclasses.replace(filter.settings, vectors=vectors)
    _, _, references = stream(result)
    with pytest.raises(ArgumentError, match="never show a pose"):
        posegsa.PoseFilter(dataclasses.replace(filter, settings=settings), **references)
    with pytest.raises(ArgumentError, match="never show a pose"):
        posegsa.PoseFilter(result, vector_weights=[1.0, 0.0])


def test_at_the_first_sample_only_a_start_is_restored(result):
    one = posegsa.PoseFilter(result)
    one.reset(START["rotation"], START["position"])
    wrong = one.checkpoint()
    wrong["record"][:] = np.inf
    with pytest.raises(ArgumentError, match="record holds NaN or infinity"):
        posegsa.PoseFilter(result).restore(wrong)


def test_sensors_that_never_show_a_pose_are_refused(result):
    """One vector and one landmark in a sample: the heading about the vector stays open."""
    with pytest.raises(ArgumentError, match="1 vector and 1 landmark never show a pose"):
        posegsa.PoseFilter(
            posegsa.KalmanFilter(posegsa.KalmanNoise(*jnp.full(12, 0.1))),
            vector_references=[[0, 0, 1]],
            landmark_references=[[1, 2, 3]],
        )
