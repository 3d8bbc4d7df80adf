"""A result on recordings, streamed, exported and saved: the same filter everywhere."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from helpers.compiled_c import Build, Layout, needs_cc, run_c
from helpers.compiled_c import build as build
from helpers.messages import assert_states
from helpers.recordings import motion

import posegsa
from posegsa import config
from posegsa.cli.command import main
from posegsa.errors import ArgumentError, PosegsaError, PosegsaWarning
from posegsa.export import FORMATS, export
from posegsa.judging.evaluation import CONSTANT
from posegsa.judging.result import FoundBy, Result
from posegsa.model.schedules import FuzzyGain, SmoothGain
from posegsa.optimisers import History
from posegsa.recordings.recording import Recording

pytestmark = pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")

CHOSEN = config.from_dict(
    {
        "run": {"dtype": "float64"},
        "filter": {"vector_bias": "estimated", "cross_vector": True, "length": 3.0},
        "gain": {"smoothing": 0.1, "error_scale": 0.2},
        "parameters": {"also": []},
    }
)
N = 150


def seen(**changes: Any) -> Recording:
    """A recording with noisy vectors, one of them slow, and slow landmarks with other weights."""
    given = motion(N, **changes)
    rng = np.random.default_rng(0)
    given["phases"] = {}
    for name in {"vectors", "landmarks"} & set(given):
        given[name] = given[name] + 0.02 * rng.normal(size=given[name].shape)
    given["vectors"][np.arange(N) % 2 != 0, 1] = np.nan
    if "landmarks" in given:
        given["landmarks"][np.arange(N) % 5 != 0] = np.nan
        given |= {"landmark_weights": [0.1, 0.05, 0.2]}
    return Recording.from_arrays(name="bench", **given).off(40, 0.5)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return seen()


@pytest.fixture(scope="module")
def fuzzy(recording: Recording) -> Result:
    with jax.enable_x64(True):
        space = posegsa.parameter_space(CHOSEN)
        controller = space.controller(0.3 * space.lower + 0.7 * space.upper)
        return posegsa.configured(CHOSEN, schedule=FuzzyGain(controller), recordings=[recording])


@pytest.fixture(scope="module")
def attitude() -> tuple[Result, Recording]:
    """A result for attitude only, with a gain that is not a controller's."""
    given = seen(velocity=None, landmarks=None, landmark_references=None, truth_position=None)
    with jax.enable_x64(True):
        gain = SmoothGain(*(np.float64(a) for a in (2.0, 20.0, 0.1)))  # type: ignore[arg-type]  # NumPy scalars instead of arrays
        return posegsa.configured(CHOSEN, schedule=gain, recordings=[given]), given


def streamed(result: Result, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """R_est and P_est at each sample, of a filter that gets only the measurements."""
    start, m = recording.initial(), recording.measurements
    found = posegsa.PoseFilter(
        result, rotation=start.rotation, position=start.position, bias=start.bias
    )
    poses = [found.pose]
    for k in range(recording.samples):
        vectors, landmarks = (
            np.where(np.asarray(w)[k, :, None] > 0, np.asarray(a)[k], np.nan)
            for a, w in ((m.vectors, m.vector_weights), (m.landmarks, m.landmark_weights))
        )
        velocity = {} if recording.attitude_only else {"velocity": m.velocity[k]}
        poses.append(
            found.update(
                time_step=float(m.time_step[k]),
                angular_velocity=m.angular_velocity[k],
                vectors=vectors,
                landmarks=landmarks,
                **velocity,
            )
        )
    return np.array([p.rotation for p in poses[:-1]]), np.array([p.position for p in poses[:-1]])


def test_a_stream_is_the_estimate(
    fuzzy: Result, recording: Recording, attitude: tuple[Result, Recording]
) -> None:
    estimates = fuzzy.estimate(recording)
    R, P = streamed(fuzzy, recording)
    np.testing.assert_allclose(R, estimates.rotation, atol=1e-12)
    np.testing.assert_allclose(P, estimates.position, atol=1e-12)
    assert np.ptp(estimates.gain) > 1
    result, given = attitude
    R, _ = streamed(result, given)
    np.testing.assert_allclose(R, result.estimate(given).rotation, atol=1e-12)
    known = result.known_sensors
    assert (known.vector_weights, known.landmarks) == ([1.0, 2.0], [])
    assert fuzzy.known_sensors.landmark_weights == pytest.approx([0.5, 0.25, 1.0])


def rows_of(recording: Recording) -> np.ndarray:
    """Measurements (N, numbers) as the C filter takes them: weights of 1 and 0."""
    m = {name: np.asarray(a) for name, a in recording.measurements._asdict().items()}
    columns = [m["time_step"][:, None], m["angular_velocity"]]
    if not recording.attitude_only:
        columns.append(m["velocity"])
    for kind in ("vector", "landmark"):
        if m[f"{kind}s"].shape[1]:
            columns += [m[f"{kind}s"].reshape(N, -1), (m[f"{kind}_weights"] > 0).astype(float)]
    return np.concatenate(columns, axis=1)


@needs_cc
def test_the_c_is_the_estimate(
    fuzzy: Result,
    recording: Recording,
    attitude: tuple[Result, Recording],
    build: Build,
) -> None:
    for result, given, layout, options in (
        (fuzzy, recording, Layout(2, 3, learns=True), ()),
        (*attitude, Layout(2, 0, learns=True), ("-DATTITUDE_ONLY",)),
    ):
        text = export(result, "c")
        assert_states(text, "Root mean square errors", "recordings")
        start, estimates = given.initial(), result.estimate(given)
        q = posegsa.tum_text([0.0], start.rotation[None]).split()[4:]
        begin = np.array([*q[-1:], *q[:-1]], float)
        begin /= np.linalg.norm(begin)
        if not given.attitude_only:
            begin = np.concatenate([begin, start.position])
        found = run_c(build(text, *options), layout, begin, rows_of(given))
        assert (found.code == 0).all()
        np.testing.assert_allclose(found.rotation, estimates.rotation, atol=1e-9)
        if not given.attitude_only:
            np.testing.assert_allclose(found.position, estimates.position, atol=1e-9)


def test_every_format_is_written_or_refused_by_what_the_gain_is(
    fuzzy: Result,
    attitude: tuple[Result, Recording],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    texts = {name: export(fuzzy, name) for name in FORMATS}
    (tmp_path / "gain.fis").write_text(texts["fis"])
    read = posegsa.load_controller(tmp_path / "gain.fis")
    with jax.enable_x64(True):
        expected, own = (float(c(error=0.3, rate=0.1)) for c in (fuzzy.controller, read))
    assert own == pytest.approx(expected, rel=1e-6)
    for name in ("c-gain", "fis"):
        assert "p_3 = (1.0, -3.0, 0.5) m, weight 1.0" in texts[name]
        assert "v_3 = v_1 x v_2, weight 0.5" in texts[name]
    assert texts["csv"].startswith("error,rate,gain_1_s")
    smooth, _ = attitude
    with pytest.raises(PosegsaError, match=r"format = 'fis' of a smooth gain.*json, c, or"):
        export(smooth, "fis")
    with pytest.raises(ArgumentError, match="smooth gain"):
        posegsa.export_fis(smooth)
    posegsa.save(fuzzy, tmp_path / "run")
    again = posegsa.load(tmp_path / "run")
    assert isinstance(again, Result)
    assert again.known_sensors == fuzzy.known_sensors
    for name in ("c", "c-gain"):
        assert main(["export", str(tmp_path / "run"), "--format", name, "--name", "own"]) == 0
        assert "own_" in capsys.readouterr().out


def test_a_filter_of_the_attitude_alone_says_whether_that_is_observable(
    attitude: tuple[Result, Recording],
) -> None:
    found = posegsa.PoseFilter(attitude[0], rotation=np.eye(3), position=np.zeros(3))
    assert_states(found.why_unobservable, "no vectors")
    known = np.array(attitude[0].known_sensors.vectors)
    found.update(time_step=0.01, angular_velocity=np.zeros(3), vectors=known)
    assert found.observable
    for _ in range(2):  # of two seconds, in which one vector is measured
        found.update(time_step=1.0, angular_velocity=np.zeros(3), vectors=[known[0], None])
    assert_states(found.why_unobservable, "1 vector")


def test_the_controller_is_made_once(fuzzy: Result) -> None:
    """As for a result on scenarios: a loop may read this property at each sample."""
    assert fuzzy.controller is fuzzy.controller
    assert fuzzy.schedule is fuzzy.candidate.schedule


def test_warnings_of_a_result_are_in_its_exports(fuzzy: Result) -> None:
    """It also says so if constant gains are better on all judged recordings."""
    assert fuzzy.on_recordings is not None
    (score,) = fuzzy.on_recordings.held_out
    found = score.errors["judged"]
    assert found.position is not None

    def beside(total: float, position: float) -> Result:
        errors = found._replace(total=total * found.total, position=position * found.position)
        other = score._replace(errors={"judged": errors})
        on = dataclasses.replace(fuzzy.on_recordings, baselines={CONSTANT: [other]})
        return dataclasses.replace(fuzzy, on_recordings=on)

    assert not beside(2.0, 0.5).warnings()
    history = History(np.zeros(1), np.zeros(1), np.zeros(1), np.full(1, 3))  # type: ignore[arg-type]  # NumPy arrays will do
    found_by = FoundBy(
        tuned_on="recordings",
        cost="configured",
        position_weight=100.0,
        best_cost=1.0,
        non_finite=3,
        compile_seconds=0.0,
        search_seconds=0.0,
        history=history,
    )
    behind = dataclasses.replace(beside(0.5, 0.5), search=found_by)
    worse, few = behind.warnings()
    assert_states(few, "3 agents", "no finite cost")
    assert_states(worse, "held out", "best constant gains")
    assert json.loads(export(behind, "json"))["warnings"] == [worse, few]
    for name in ("c", "c-gain", "fll"):
        head = " ".join(re.sub(r"(?m)^( \*|#)", " ", export(behind, name)).split())
        assert f"WARNING: {few}." in head
        assert f"WARNING: {worse}." in head
    with pytest.warns(PosegsaWarning, match="3 agents"):
        posegsa.PoseFilter(behind, rotation=np.eye(3), position=np.zeros(3))


def test_sensors_that_recordings_have_not_in_common_are_not_guessed(
    recording: Recording, fuzzy: Result
) -> None:
    moved = motion()["landmark_references"] + 1.0
    other = seen(landmark_references=moved)
    result = posegsa.configured(CHOSEN, schedule=fuzzy.schedule)
    assert len(result.known_sensors.landmarks) == len(CHOSEN.scenario.landmarks)
    differing = posegsa.configured(CHOSEN, schedule=fuzzy.schedule, recordings=[recording, other])
    on = differing.on_recordings
    assert on is not None
    assert on.sensors is None
    tuned = dataclasses.replace(
        differing, on_recordings=dataclasses.replace(on, training=on.held_out)
    )
    for each in (differing, tuned):
        with pytest.raises(ArgumentError, match=r"references differ.*--recording FILE"):
            export(each, "c")
        chosen = each.with_sensors_of(other).known_sensors
        np.testing.assert_array_equal(chosen.landmarks, moved)
    with pytest.raises(ArgumentError, match="references differ"):
        posegsa.PoseFilter(tuned, rotation=np.eye(3), position=np.zeros(3))
    assert_states(export(tuned, "c-gain"), "vectors and landmarks")
    own = posegsa.PoseFilter(
        tuned,
        rotation=np.eye(3),
        position=np.zeros(3),
        vector_references=np.eye(3)[:2],
        landmark_references=moved,
    )
    assert own.pose.position.shape == (3,)
