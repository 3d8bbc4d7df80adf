"""Recordings as a batch for a search, of any lengths and rates.

Shorter recordings are padded with samples that measure nothing and don't count in the cost. Sensors
that a recording lacks have the weight 0. Each recording's own mask says which samples count.

A search can use simulated scenarios too. Each then counts like a recording, with the root mean
square of its errors.
"""

from collections.abc import Sequence
from functools import cache
from itertools import chain
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from posegsa import config
from posegsa.config import shipped
from posegsa.config.schedule_config import AlsoTuned
from posegsa.errors import ConfigError, RecordingError
from posegsa.filters.base import Sensors, samples_of
from posegsa.model.cost import CostWeights, RecordedCost
from posegsa.model.estimate import FilterState
from posegsa.model.measurements import Measurements
from posegsa.model.se3 import rotate, rows
from posegsa.recordings.data_check import found_noises
from posegsa.recordings.recording import Recording
from posegsa.recordings.running import as_seen, state_of
from posegsa.search import memory
from posegsa.search.configured_filters import OwnFilter, filter_of
from posegsa.search.drawn_scenarios import all_scenarios
from posegsa.search.population import ScenarioBatch
from posegsa.search.problem import TuningProblem
from posegsa.search.schedule_spaces import LOWEST_GAIN
from posegsa.search.search_spaces import own_space, search_space
from posegsa.words import counted

DEGREES_PER_METRE = 100.0
"""Default weight of the position RMSE relative to the attitude RMSE: 1 cm counts as 1 deg."""
ITERATIONS = 10
"""Iterations of the default search, which has only three numbers to find."""
MORE_NOISE, LINEAR_WALKS = 10.0, (1e-5, 1.0)
"""Upper bound of a velocity's noise as a multiple of the found one; bounds of walks
[m/s/sqrt(s)]."""
LEAST_IMPROVEMENT = 0.05
"""Share by which the search must lower the cost. On flights with white noise it lowers the cost by
up to 3 % on the flights that it is given, and raises it by up to 20 % on others; where the filter's
model is wrong it lowers both, by 7 to 23 %."""
_EYE = np.eye(3)


def recorded_problem(
    experiment: config.Experiment,
    recordings: Sequence[Recording],
    position_weight: float,
    *,
    own: OwnFilter | None = None,
    strict: bool = True,
) -> TuningProblem:
    """A search of an experiment's filter on recordings.

    Args:
        experiment: Gives the filter, signal, fuzzy inference, boxes, objective and optimiser. Its
            scenario gives the weights of vectors and landmarks, in order. If its
            `objective.simulated_share` is above 0, its scenarios are used too.
        recordings: At least one, each with a truth.
        position_weight: Weight of the position's RMSE [deg/m].
        own: The user's own filter, where the experiment has one.
        strict: Refuse a number to be tuned that has no effect; else it is left out.

    Raises:
        ConfigError: The experiment's signal is "pose", or it tunes a number that has no effect
            here, or its scenarios are used too and have other sensors.
        MemoryLimitError: It would need more memory than is free.
        RecordingError: A recording has no judged sample, or starts are off the truth where it is
            not known.
    """
    if experiment.gain.signal == "pose":
        raise ConfigError(
            'gain.signal = "pose" looks at the true pose; allowed on recordings: "measured"'
        )
    most = most_sensors(recordings)
    experiment = with_effect_on(experiment, *most, strict=strict)
    recordings = with_starts_off(recordings, experiment.objective.starts_off)
    longest = max(one.samples for one in recordings)
    memory.check([experiment], recorded=memory.RecordedSize(len(recordings), longest, *most))
    problem = TuningProblem(
        experiment=experiment,
        scenarios=None,
        training=recorded_batch(experiment, recordings, position_weight, own),
        space=search_space(experiment, own_space(experiment, LOWEST_GAIN)),
        own=own,
    )
    if not experiment.objective.simulated_share:
        return problem
    _check_same_sensors(experiment, recordings)
    drawn = all_scenarios(experiment, filter_of(experiment, own))
    every = as_recordings(drawn, position_weight)
    beside = every.select(slice(experiment.run.training_scenarios))
    return problem._replace(scenarios=every, beside=beside)


def with_starts_off(
    recordings: Sequence[Recording], starts: Sequence[tuple[float, float]]
) -> list[Recording]:
    """Recordings with their own starts, then with starts off the truth by so many [deg, m].

    A filter that is tuned from good starts alone learns nothing of others: its gain at a large
    error is as good as random, and from there it may be lost.

    Raises:
        RecordingError: The truth of a recording is not known at its first sample.
    """
    each = [(one, start) for one in recordings for start in starts]
    try:
        off = [one.off(*start, seed=seed) for seed, (one, start) in enumerate(each)]
    except RecordingError as error:
        raise RecordingError(
            f"{error}, which objective.starts_off needs; allowed: a recording from where it is "
            "known on (a window), or starts_off = []"
        ) from None
    return [*recordings, *off]


def default_experiment(recordings: Sequence[Recording]) -> config.Experiment:
    """What is tuned on recordings where no configuration is given.

    It is a Kalman filter with the noises that the recordings show (`found_noises`). Where the
    recordings violate its model (a wrong scale, correlated noise), larger noises of the velocities
    compensate: these and the walk of the velocity's bias are searched, and kept if the cost falls
    by enough.
    On recordings of inertial sensors without a velocity it is the attitude filter.
    """
    if all(one.attitude_only and "accelerometer" in one.sensors for one in recordings):
        return config.load("imu")
    noises = found_noises(recordings)
    stated = {
        f"filter.{key}": value if isinstance(value, tuple) else float(f"{value:.3g}")
        for key, value in noises.items()
    }
    kalman = config.load("kalman").replace(**stated, **{"search.iterations": ITERATIONS})
    boxes = {}
    for key in ("angular_velocity", "velocity"):
        found = config.number_at(kalman, f"filter.{key}")
        boxes[key] = (found, MORE_NOISE * found)
    boxes["linear_walk"] = LINEAR_WALKS
    also = [
        {"key": f"filter.{key}", "lower": low, "upper": high, "scale": "logarithmic"}
        for key, (low, high) in boxes.items()
    ]
    return kalman.replace(**{"parameters.also": also, "objective.least_gain": LEAST_IMPROVEMENT})


def _check_same_sensors(experiment: config.Experiment, recordings: Sequence[Recording]) -> None:
    """Raise a ConfigError unless recordings have the same sensors as the scenarios."""
    share = experiment.objective.simulated_share
    needed = len(experiment.scenario.vectors), len(experiment.scenario.landmarks)
    for one in recordings:
        found = most_sensors([one])
        has = f"{counted(found[0], 'vector')} and {counted(found[1], 'landmark')}"
        if one.attitude_only:
            has = "no position (attitude only)"
        if one.attitude_only or found != needed:
            raise ConfigError(
                f"objective.simulated_share = {share}: {one.name} has {has}; allowed with "
                f"simulated scenarios: a position, {counted(needed[0], 'vector')} and "
                f"{counted(needed[1], 'landmark')}, as [scenario] has"
            )


def as_recordings(batch: ScenarioBatch, position_weight: float) -> ScenarioBatch:
    """Simulated scenarios with the cost of recordings, root mean square errors.

    The weight of a sample is the sum of the weights of the [cost] windows that contain it.
    """
    time, truth = batch.samples.time, batch.samples.truth
    assert truth is not None
    weights = batch.weights
    if batch.begin is not None or batch.end is not None:
        weights = jax.vmap(batch.weights.between)(time, batch.begin, batch.end)
    weight = jnp.broadcast_to(weights.transient + weights.steady, time.shape)
    total = jnp.sum(weight, axis=-1, keepdims=True)
    weight = jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), 0.0)
    return batch._replace(
        begin=None,
        end=None,
        recorded=RecordedCost(
            weight=weight,
            position=rotate(rows(truth.attitude), truth.origin),
            position_weight=jnp.full(time.shape[0], position_weight, batch.dtype),
        ),
    )


def with_effect_on(
    experiment: config.Experiment, vectors: int, landmarks: int, *, strict: bool = True
) -> config.Experiment:
    """An experiment that tunes only what has an effect with these numbers of sensors.

    Raises:
        ConfigError: A number that the user chose has no effect, and `strict` is true.
    """
    kept = []
    for one in experiment.also:
        if experiment.filter.kind in ("own", "imu") or _has_effect(one.key, vectors, landmarks):
            kept.append(one.model_dump(mode="json"))
        elif strict and one not in _come_with_posegsa():
            raise ConfigError(
                f"parameters.also: {one.key!r} has no effect on these recordings, with "
                f"{counted(vectors, 'vector')} and {counted(landmarks, 'landmark')}; allowed: a "
                "list without it"
            )
    return experiment.replace(**{"parameters.also": kept})


@cache
def _come_with_posegsa() -> tuple[AlsoTuned, ...]:
    """The numbers that are tuned by default, and by the configurations that come with posegsa."""
    configured = (config.load(name).parameters.also or () for name in shipped.names())
    return tuple(chain(*(kind.also for kind in config.FILTERS.values()), *configured))


_OF_POSITION = (
    "length",
    "length_growth",
    "velocity",
    "linear_walk",
    "landmark",
    "initial_position",
    "linear_lead",
)
"""Numbers of [filter] that have an effect only where landmarks are seen."""


def _has_effect(key: str, vectors: int, landmarks: int) -> bool:
    match key.split("."):
        case ["gain", "position_weight"]:
            return landmarks > 0 and vectors > 0
        case ["scenario", "vectors", index, _]:
            return int(index) < vectors
        case ["scenario", "landmarks", index, _]:
            return int(index) < landmarks
        case ["filter", "cross_vector_weight"]:
            return vectors >= 2
        case ["filter", name] if name.startswith(("vector", "excitation", "initial_vector")):
            return vectors > 0
        case ["filter", "gamma" | "bias_bound", "1"] | ["filter", "initial_linear_bias"]:
            return landmarks > 0
        case ["filter", name] if name in _OF_POSITION:
            return landmarks > 0
    return True


def recorded_batch(
    experiment: config.Experiment,
    recordings: Sequence[Recording],
    position_weight: float,
    own: OwnFilter | None = None,
) -> ScenarioBatch:
    """Recordings as S scenarios, at an experiment's dtype, for its filter, or the user's own."""
    dtype = jnp.dtype(experiment.run.dtype)
    most = most_sensors(recordings)
    filter = filter_of(experiment, own, Sensors(*most))
    recordings = [as_seen(filter, one) for one in recordings]
    length = max(one.samples for one in recordings)
    padded = [_padded(one, length, *most, position_weight) for one in recordings]
    together: dict[str, Any] = jax.tree.map(
        lambda *leaves: jnp.asarray(np.stack(leaves), dtype), *padded
    )
    samples = _prepared(
        filter, together["measurements"], together["rotation"], together["position"]
    )
    starts: list[FilterState] = [state_of(one.initial()) for one in recordings]
    initial = jax.tree.map(lambda *leaves: jnp.stack(leaves).astype(dtype), *starts)
    count, zero = len(recordings), jnp.zeros((), dtype)
    return ScenarioBatch(
        samples=samples,
        initial=initial,
        bias=jnp.zeros((count, 6), dtype),
        vector_bias=jnp.zeros((count, most[0], 3), dtype),
        begin=None,
        end=None,
        weights=CostWeights(transient=zero, steady=zero, window=zero > 0, position=zero),
        filter=filter,
        recorded=together["cost"],
    )


_prepared = jax.jit(jax.vmap(samples_of, in_axes=(None, 0, 0, 0)))


def most_sensors(recordings: Sequence[Recording]) -> tuple[int, int]:
    """The largest number of vectors, and of landmarks, in a recording."""
    vectors = max(np.shape(one.measurements.vectors)[1] for one in recordings)
    return vectors, max(np.shape(one.measurements.landmarks)[1] for one in recordings)


def _padded(
    recording: Recording, length: int, vectors: int, landmarks: int, position_weight: float
) -> dict[str, Any]:
    """A recording's arrays, padded to `length` samples and the given sensors, and its cost."""
    judged, truth = recording.masks()["judged"], recording.truth
    assert truth is not None
    if not judged.any():
        raise RecordingError(f"{recording.name}: no sample is judged where the truth is known")
    more = length - recording.samples

    def longer(a: Any, sensors: int | None = None) -> np.ndarray:
        """An array padded with its last sample, and with sensors of weight 0."""
        array = np.asarray(a)
        if sensors is not None:
            lacking = sensors - array.shape[1]
            array = np.pad(array, [(0, 0), (0, lacking), *[(0, 0)] * (array.ndim - 2)])
        return np.concatenate([array, np.repeat(array[-1:], more, axis=0)])

    m = recording.measurements._asdict()
    counts = {"vector": vectors, "landmark": landmarks}
    for name, array in m.items():
        sensors = next((n for kind, n in counts.items() if name.startswith(kind)), None)
        m[name] = longer(array, sensors)
        if name.endswith("_weights"):
            m[name][recording.samples :] = 0.0
    P = np.zeros((recording.samples, 3)) if truth.position is None else truth.position
    weight = longer(judged / judged.sum())
    weight[recording.samples :] = 0.0
    known = longer(truth.known)
    R = np.where(known[:, None, None], longer(truth.rotation), _EYE)
    P = np.where(known[:, None], longer(P), 0.0)
    cost: dict[str, Any] = {
        "weight": weight,
        "position": tuple(P.T),
        "position_weight": np.float64(0.0 if truth.position is None else position_weight),
    }
    return {
        "measurements": Measurements(**m),
        "rotation": R,
        "position": P,
        "cost": RecordedCost(**cost),
    }
