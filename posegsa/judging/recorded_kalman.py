"""The invariant Kalman filter on recordings: noises tuned on some, estimates on others.

It reads the same recordings as the observer, but all measurements have the weight 1. Its covariance
already accounts for the time between measurements.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from posegsa import config
from posegsa.filters.rollout import Estimates, simulate
from posegsa.judging.evaluation import Description
from posegsa.judging.kalman import candidate_of_noises, search_noises, untuned
from posegsa.recordings.recording import Recording
from posegsa.recordings.start import with_numpy_arrays
from posegsa.search.population import ScenarioBatch
from posegsa.search.recorded import recorded_batch


def tune_recorded_kalman(
    experiment: config.Experiment, recordings: Sequence[Recording], position_weight: float
) -> Description:
    """The noises of lowest cost on recordings, with the experiment's objective and seed."""
    return search_noises(experiment, _batch(experiment, recordings, position_weight))


def recorded_kalman_estimates(
    found: Description, experiment: config.Experiment, recordings: Sequence[Recording]
) -> list[Estimates]:
    """Estimates of a filter with these noises on each recording; NumPy arrays."""
    batch = _batch(experiment, recordings, 0.0)
    filter, every = candidate_of_noises(found, batch.dtype).applied(batch.filter), []
    for i, recording in enumerate(recordings):
        samples, initial = jax.tree.map(lambda a, i=i: a[i], (batch.samples, batch.initial))
        # All are padded to the longest, so the filter compiles once.
        estimates = jax.device_get(simulate(filter, samples, initial))
        own = jax.tree.map(lambda a, n=recording.samples: a[:n], estimates)
        if recording.attitude_only:
            own = own._replace(position=np.full_like(own.position, np.nan))
        every.append(own)
    return every


def _batch(
    experiment: config.Experiment, recordings: Sequence[Recording], position_weight: float
) -> ScenarioBatch:
    """Recordings for the Kalman filter: vectors as measured, every weight 1."""
    filter = untuned(vector_biases=False, dtype=jnp.dtype(experiment.run.dtype))
    return recorded_batch(experiment, list(map(_unweighted, recordings)), position_weight, filter)


def _unweighted(recording: Recording) -> Recording:
    m = {
        name: (np.asarray(a) > 0).astype(float) if name.endswith("_weights") else a
        for name, a in recording.measurements._asdict().items()
    }
    return replace(recording, measurements=with_numpy_arrays(m))
