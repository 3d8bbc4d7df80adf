"""Checks of time stamps, and policies for bridging missing samples.

A recording is refused if its time stamps do not increase, if it has a gap, or if velocities are
NaN, unless a policy says what to do:

    "refuse"        bridge nothing
    "keep"          leave gaps as they are, one long time step, and drop samples without velocities
    "hold"          fill gaps, and hold the last velocities
    "interpolate"   fill gaps, and interpolate velocities linearly

All but "refuse" drop samples whose time stamp is not later than all before it. Gaps are filled with
samples at the median time step that have velocities only. Notes count what was dropped or filled,
and the length of gaps is limited.

No sensor has seen the motion in a gap. The attitude filter finds the attitude anew after a pause,
so "keep" is right for it, and the default for an inertial sensor, whose stamps must still increase.
The observer and the Kalman filter have no such rule: they refuse a gap that was kept.
"""

from typing import NamedTuple, get_args

import numpy as np
from jax.typing import ArrayLike

from posegsa.errors import RecordingError
from posegsa.model.measurements import finite_array, finite_rows
from posegsa.recordings.policies import LONGEST_GAP, Policy
from posegsa.words import counted

GAP = 5.0
"""Time steps longer than this many median ones are gaps."""
LONGEST_STEP = 3600.0
"""Upper limit of `longest_gap` [s]: longer gaps suggest time stamps in another unit."""
ALLOWED = 'allowed: bridge = "hold" or "interpolate", of an inertial sensor also "keep" (--bridge)'
MAX_MEDIAN_STEP, MIN_MEDIAN_STEP = 1.0, 1e-5
"""Range of the median time step of inertial sensors [s]; outside it, the stamps have another
unit."""


class Bridged(NamedTuple):
    """The samples of a recording that are used, with samples filled in."""

    time: np.ndarray
    """(N,) from the first sample [s], ascending."""
    source: np.ndarray
    """(N,) the index of each sample in the recording; -1 for one that was filled in."""
    notes: tuple[str, ...]
    """What was done, with counts."""
    begin: float
    """Time from the recording's first sample to the first of these [s]."""

    def spread(self, values: np.ndarray, missing: float | bool) -> np.ndarray:
        """Values (K, ...) of the recording as (N, ...), `missing` for samples filled in."""
        if len(values) == len(self.source) and (np.diff(self.source, prepend=-1) == 1).all():
            return values
        taken = values[self.source]  # at -1 the last value, which is replaced below
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.where((self.source >= 0).reshape(shape), taken, missing)


def stamps(time: ArrayLike | None, time_step: ArrayLike | None, samples: int) -> np.ndarray:
    """Time (K,) since the first sample [s], float64, of a rate that an inertial sensor has.

    Args:
        time: (K,) time stamps: integers in ns, floats in s; None if there is a time step.
        time_step: scalar or (K,) [s], to the next sample.
        samples: K.

    Raises:
        RecordingError: not exactly one of the two is given, it has the wrong shape or is not
            finite, or no inertial sensor has this rate.
    """
    found = _stamps(time, time_step, samples)
    step = float(np.median(np.diff(found)))
    if step > MAX_MEDIAN_STEP or 0 < step < MIN_MEDIAN_STEP:
        name = "time_step" if time is None else "time"
        raise RecordingError(
            f"{name}: a median step of {step:.3g} s, {1 / step:.3g} samples a second; allowed: "
            f"{MIN_MEDIAN_STEP:g} to {MAX_MEDIAN_STEP:g} s. Are the time stamps in another unit? "
            "Then state it: "
            'the line time_unit = "ms" (or "us", "ns") in FILE.csv.toml beside FILE.csv, in Python '
            "from_csv(..., time_unit=); in arrays, floats are in s and integers in ns"
        )
    return found


def _stamps(time: ArrayLike | None, time_step: ArrayLike | None, samples: int) -> np.ndarray:
    """The same for any rate."""
    if samples < 2:
        raise RecordingError(f"a recording has {counted(samples, 'sample')}; allowed: 2 or more")
    if (time is None) == (time_step is None):
        raise RecordingError("time, time_step: give one of the two")
    if time is None:
        assert time_step is not None
        steps = np.full(samples, time_step) if np.ndim(time_step) == 0 else time_step
        steps = finite_array("time_step", steps, (samples,))
        if (steps <= 0).any():
            k = int(np.argmax(steps <= 0))
            raise RecordingError(f"time_step: must be positive, got {steps[k]:g} s at sample {k}")
        return np.concatenate([[0.0], np.cumsum(steps[:-1])])
    given = np.asarray(time)
    if given.dtype.kind in "iu":
        if given.shape != (samples,):
            raise RecordingError(f"time: must have the shape ({samples},), got {given.shape}")
        if given.max() > 2**62 or given.min() < -(2**62):
            raise RecordingError(f"time: {given.max()} ns is no time stamp; allowed: up to 2^62 ns")
        # Subtract as integers first: float64 cannot hold all digits of ns since 1970.
        return (given.astype(np.int64) - np.int64(given[0])) / 1e9
    seconds = finite_array("time", given, (samples,))
    return seconds - seconds[0]


def stamp_after(stamp: int | float, seconds: float) -> int | float:
    """A time stamp some time after another, both integers in ns or floats in s."""
    return stamp + round(1e9 * seconds) if isinstance(stamp, int) else stamp + seconds


def first_stamp(time: ArrayLike | None, origin: int | float = 0.0) -> int | float:
    """The first of checked time stamps, in ns as an integer or in s as a float.

    Args:
        time: (K,) time stamps: integers in ns, floats in s; None if there are time steps.
        origin: the stamp that these count from.
    """
    if time is None:
        return origin
    first = np.asarray(time)[0].item()
    if isinstance(origin, float) and origin == 0:
        return first
    return stamp_after(origin, first / 1e9 if isinstance(first, int) else first)


def gaps_in(time: np.ndarray) -> tuple[np.ndarray, str]:
    """The gaps of ascending times (K,) [s], as the indices before them, and in words."""
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    if not gaps.size:
        return gaps, ""
    most = int(gaps[np.argmax(steps[gaps])])
    where = f"the longest {steps[most]:.4g} s after {time[most]:.6g} s"
    return gaps, f"{counted(gaps.size, 'gap')} longer than {GAP:g} median steps, {where}"


def refuse_gaps(name: str, time: np.ndarray) -> None:
    """Raise a RecordingError if a recording has a gap, for a filter that has no rule for one."""
    if words := gaps_in(time)[1]:
        raise RecordingError(
            f'{name}: time: {words}; allowed for this filter: bridge = "hold" or "interpolate" '
            "(--bridge)"
        )


def bridged_samples(
    time: np.ndarray,
    velocities: np.ndarray,
    policy: Policy | None,
    longest: float | None,
    *,
    inertial: bool = False,
) -> Bridged:
    """The samples to use according to a policy.

    Args:
        time: (K,) since the first sample [s].
        velocities: (K, d) needed at each sample; NaN where unknown.
        policy: what to do where samples or velocities are missing; None for "refuse", of an
            inertial sensor "keep" with stamps that increase.
        longest: maximum length of a gap [s]; None for that of the policy, LONGEST_GAP or, if gaps
            are kept, LONGEST_STEP.
        inertial: whether these are the samples of an inertial sensor.

    Raises:
        RecordingError: something is missing that the policy does not bridge.
    """
    drops = policy not in (None, "refuse")
    policy = policy or ("keep" if inertial else "refuse")
    if policy not in get_args(Policy):
        allowed = ", ".join(f'"{each}"' for each in get_args(Policy))
        raise RecordingError(f"bridge = {policy!r}; allowed: {allowed}")
    if longest is None:
        longest = LONGEST_STEP if policy == "keep" else LONGEST_GAP
    if not 0 <= longest <= LONGEST_STEP:
        raise RecordingError(f"longest_gap = {longest!r}; allowed: 0 to {LONGEST_STEP:g} s")
    notes = []
    kept = advancing(time)
    if dropped := int(np.count_nonzero(~kept)):
        k = int(np.argmin(kept))
        where = f"first at sample {k}, {time[k]:.9g} s after {time[k - 1]:.9g} s"
        if not drops:
            raise RecordingError(
                f"time: {counted(dropped, 'stamp')} not after the one before ({where}); {ALLOWED}, "
                "which drops them"
            )
        notes.append(f"{counted(dropped, 'sample')} dropped: stamps that do not increase, {where}")
    source = np.flatnonzero(kept)
    if len(source) < 2:
        raise RecordingError("time: no two stamps ascend")
    lost, words_of_lost = ~finite_rows(velocities)[source], []
    if lost.any():
        words = f"{counted(int(lost.sum()), 'sample')} without velocities"
        words = f"{words} (NaN), the first at {int(source[np.argmax(lost)])}"
        if policy == "refuse":
            raise RecordingError(f"angular_velocity, velocity: {words}; {ALLOWED}")
        _refuse_long_runs(time[source], lost, longest)
        done = "dropped" if policy == "keep" else f"bridged ({policy})"
        words_of_lost = [f"{words}: {done}"]
        if policy == "keep":
            source = source[~lost]
            if len(source) < 2:
                raise RecordingError("angular_velocity, velocity: only one sample has them")
    found = time[source]
    gaps, words = gaps_in(found)
    steps = np.diff(found)
    if gaps.size and (policy == "refuse" or steps[gaps].max() > longest):
        raise RecordingError(
            f"time: {words}; {ALLOWED}, with gaps of up to longest_gap = {longest:g} s, or a "
            "recording without them"
        )
    if gaps.size and policy != "keep":
        found, source = _filled(found, source, gaps, float(np.median(steps)))
        notes.append(f"{words}: bridged by {counted(int((source < 0).sum()), 'sample')} ({policy})")
        _refuse_long_runs(found, (source < 0) | ~finite_rows(velocities)[source], longest)
    notes += words_of_lost
    return Bridged(found - found[0], source, tuple(notes), float(found[0]))


def known_everywhere(bridged: Bridged, values: np.ndarray, policy: Policy | None) -> np.ndarray:
    """Velocities (N, d) at the bridged samples from the recorded ones (K, d)."""
    spread = bridged.spread(values, np.nan)
    missing = ~finite_rows(spread)
    if not missing.any():
        return spread
    known = np.flatnonzero(~missing)
    if policy == "hold":
        before = known[np.maximum(np.searchsorted(known, np.flatnonzero(missing)) - 1, 0)]
        spread[missing] = spread[before]
        return spread
    for column in spread.T:
        column[missing] = np.interp(bridged.time[missing], bridged.time[known], column[known])
    return spread


def advancing(time: np.ndarray) -> np.ndarray:
    """Whether each stamp (K,) comes after all before it."""
    latest = np.maximum.accumulate(time)
    return np.concatenate([[True], time[1:] > latest[:-1]])


def _filled(
    time: np.ndarray, source: np.ndarray, gaps: np.ndarray, usual: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times and sources with the gaps filled by samples about `usual` [s] apart."""
    times, where = [], []
    for k in gaps:
        parts = max(2, round(float(time[k + 1] - time[k]) / usual))
        times.append(np.linspace(time[k], time[k + 1], parts + 1)[1:-1])
        where.append(np.full(parts - 1, k + 1))
    between, at = np.concatenate(times), np.concatenate(where)
    return np.insert(time, at, between), np.insert(source, at, -1)


def _refuse_long_runs(time: np.ndarray, unknown: np.ndarray, longest: float) -> None:
    """Raise a RecordingError if velocities are unknown for too long, or everywhere."""
    known = np.flatnonzero(~unknown)
    if known.size == 0:
        raise RecordingError(
            f"angular_velocity, velocity: all {len(time)} samples are NaN; allowed: some that are "
            "not"
        )
    # Include the times before the first known sample and after the last one.
    ends = np.concatenate([time[:1], time[known], time[-1:]])
    runs = np.diff(ends)
    inner = np.concatenate([[known[0] > 0], np.diff(known) > 1, [known[-1] < len(time) - 1]])
    runs = np.where(inner, runs, 0.0)
    if runs.max() > longest:
        k = int(np.argmax(runs))
        raise RecordingError(
            f"angular_velocity, velocity: missing for {runs[k]:.4g} s after {ends[k]:.6g} s; "
            f"allowed: up to longest_gap = {longest:g} s"
        )
