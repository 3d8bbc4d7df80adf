"""The invariant Kalman filter on recordings: its noises tuned on some, its estimates of others.

It reads the same recordings as the observer, but each measurement with the same weight: what it
needs to know of a sensor's rate it learns by when it is told.
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
    """The noises of lowest cost on recordings, by the experiment's objective and seed."""
    return search_noises(experiment, _batch(experiment, recordings, position_weight))


def recorded_kalman_estimates(
    found: Description, experiment: config.Experiment, recordings: Sequence[Recording]
) -> list[Estimates]:
    """What a filter with such noises makes of each recording; NumPy arrays."""
    batch = _batch(experiment, recordings, 0.0)
    filter, every = candidate_of_noises(found, batch.dtype).applied(batch.filter), []
    for i, recording in enumerate(recordings):
        samples, initial = jax.tree.map(lambda a, i=i: a[i], (batch.samples, batch.initial))
        # All are as long as the longest, so that the filter is compiled once.
        estimates = jax.device_get(simulate(filter, samples, initial))
        own = jax.tree.map(lambda a, n=recording.samples: a[:n], estimates)
        if recording.attitude_only:
            own = own._replace(position=np.full_like(own.position, np.nan))
        every.append(own)
    return every


def _batch(
    experiment: config.Experiment, recordings: Sequence[Recording], position_weight: float
) -> ScenarioBatch:
    """Recordings as the Kalman filter reads them: vectors as measured, every weight 1."""
    filter = untuned(vector_biases=False, dtype=jnp.dtype(experiment.run.dtype))
    return recorded_batch(experiment, list(map(_unweighted, recordings)), position_weight, filter)


def _unweighted(recording: Recording) -> Recording:
    m = {
        name: (np.asarray(a) > 0).astype(float) if name.endswith("_weights") else a
        for name, a in recording.measurements._asdict().items()
    }
    return replace(recording, measurements=with_numpy_arrays(m))
