"""The invariant Kalman filter on recordings: its noises tuned on some, its estimates of others.

It reads the same recordings as the observer, but each measurement with the same weight: what it
needs to know of a sensor's rate it learns by when it is told.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from posegsa import config
from posegsa.judging.evaluation import Description
from posegsa.judging.kalman import named_noise, noise_names, noise_of, search_noises
from posegsa.model.cost import RecordedCost
from posegsa.model.ekf import ekf_recorded_cost, run_ekf
from posegsa.model.filter import FilterState
from posegsa.model.rollout import Estimates, Samples
from posegsa.recordings.recording import Recording
from posegsa.recordings.start import with_numpy_arrays
from posegsa.search.population import ScenarioBatch, over_scenarios
from posegsa.search.recorded import recorded_batch


def tune_recorded_kalman(
    experiment: config.Experiment, recordings: Sequence[Recording], position_weight: float
) -> Description:
    """The noises of lowest cost on recordings, by the experiment's objective and seed."""
    training = _batch(experiment, recordings, position_weight)
    names = tuple(noise_names(vector_biases=False))
    objective = _Objective(experiment.objective, names)
    return search_noises(objective, training, names, experiment.run.seed)


def recorded_kalman_estimates(
    found: Description, experiment: config.Experiment, recordings: Sequence[Recording]
) -> list[Estimates]:
    """What a filter with such noises makes of each recording; NumPy arrays."""
    batch = _batch(experiment, recordings, 0.0)
    noise, every = noise_of(found, batch.dtype), []
    for i, recording in enumerate(recordings):
        samples, initial = jax.tree.map(lambda a, i=i: a[i], (batch.samples, batch.initial))
        # All are as long as the longest, so that the filter is compiled once.
        estimates = jax.device_get(run_ekf(samples, initial, noise))
        own = jax.tree.map(lambda a, n=recording.samples: a[:n], estimates)
        if recording.attitude_only:
            own = own._replace(position=np.full_like(own.position, np.nan))
        every.append(own)
    return every


class _Objective(NamedTuple):
    """What is minimised, for programs that are compiled for it."""

    objective: config.ObjectiveConfig
    names: tuple[str, ...]

    def __call__(self, training: ScenarioBatch):
        """As a function of the noises' logarithms (A, d)."""
        return partial(_costs, self, training)


def _costs(of: _Objective, training: ScenarioBatch, vectors: Array) -> Array:
    def on_recording(one: tuple[Samples, FilterState, RecordedCost]) -> Array:
        def agent(vector: Array) -> Array:
            noise = named_noise(dict(zip(of.names, jnp.exp(vector), strict=True)))
            return ekf_recorded_cost(*one, noise)

        return jax.vmap(agent)(vectors)

    batch = training.samples, training.initial, training.recorded
    return over_scenarios(lax.map(on_recording, batch), of.objective)


def _batch(
    experiment: config.Experiment, recordings: Sequence[Recording], position_weight: float
) -> ScenarioBatch:
    """Recordings as the Kalman filter reads them: vectors as measured, every weight 1."""
    each_vector = config.override(experiment, ["filter.vector_bias=estimated"])
    batch = recorded_batch(each_vector, list(map(_unweighted, recordings)), position_weight)
    return batch._replace(initial=batch.initial._replace(vector_biases=(), turning=()))


def _unweighted(recording: Recording) -> Recording:
    m = {
        name: (np.asarray(a) > 0).astype(float) if name.endswith("_weights") else a
        for name, a in recording.measurements._asdict().items()
    }
    return replace(recording, measurements=with_numpy_arrays(m))
